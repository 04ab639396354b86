"""Hard scenes, one after another: python workflows/stability.py [--docs] [--only TEXT: only scenes with TEXT in their names, again]

The scenes are coarse (300 to 600 points), so that all of them take minutes. Rows in the table are not computed again, except those
that fail; a stopped study thus continues. `verify.check`, independent of the checks of the program, judges each result.
"""

import tempfile
import time as clock
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import verify
from pages import drawing, markdown, options, versions, write_parts
from study_table import WORKFLOWS, Row, column, study

from coupler import Result, Scene, run
from coupler.errors import ColdsprayError, SceneError
from coupler.files.inputs import read_toml
from coupler.impact.exchange import Impact
from coupler.progress import Progress

Table = dict[str, Any]
POINTS = 400
USUAL: Table = {
    "material": "Ni", "diameter": "25 um", "velocity": "500 m/s", "angle": "0 deg", "offset": ["0 um", "0 um"], "shape": "sphere",
}  # fmt: skip
SLIDE, STEEP = 4.0, 60.0  # distance, in diameters, that a particle slides if its angle (degrees) is larger than STEEP
PATIENCE = 240.0  # s of processor time for one scene
Judged = tuple[str, Table, list[str]]  # verdict, figures for the row, reasons

CHECKS = f"""A scene passes if an independent check of its files (`workflows/verify.py`) finds no fault:

- no NaN, inverted element, falling plastic strain, or von Mises stress above the flow stress;
- energy error below {verify.LEDGER:.0%} of the initial kinetic energy, momentum error below {verify.MOMENTUM:.0e};
- kinetic energy of the fields within {verify.KINETIC:.1%} of the history, elastic {verify.ELASTIC:.0%}, heat {verify.HEAT:.0%};
- volume of a body within {verify.VOLUME:.1%} of that by its pressure, of a splat {verify.JOINED:.0%} of that by its mass;
- at most {verify.SUNK:.0%} of the surface deeper than one spacing in the target;
- no cooling by more than {verify.UNDERSHOOT:.1%} of the highest rise of temperature;
- measures of the summary equal to those of the fields.

It is *warned* if a metal exceeds 0.9 of its melting point, numerical dissipation exceeds {verify.DISSIPATION:.0%}, or the summary gives
no value for a measure.
""".replace("%", " %")


class Slow(Exception):
    """A scene has used up its time."""


def scene(particle: Table | list[Table], points: int = POINTS, **more: Any) -> Table:
    """A scene on a target four diameters wide, or wider if a particle slides. particle: changes of USUAL, without effect if there is a
    table [coating]; points: number of points of the largest particle; more: changes of other tables."""
    particles = [USUAL | each for each in (particle if isinstance(particle, list) else [particle])]

    def number(text: str) -> float:
        return float(text.split()[0])

    largest = max(number(p["diameter"]) for p in particles)
    far = max(np.hypot(*map(number, p["offset"])) for p in particles)
    far += number(more["coating"]["radius"]) if "coating" in more else 0.0
    far += max(SLIDE * largest * (number(p["angle"]) > STEEP) for p in particles)
    wide = 2.0 if any(p["shape"] in ("rod", "flake", "oblate", "hollow_sphere") for p in particles) else 1.0
    spacing = (np.pi / 6 * largest**3 / points) ** (1 / 3)
    size = {"diameter": f"{4 * largest * wide + 2 * far:.6g} um", "height": f"{2.5 * largest:.6g} um"}
    return {
        **({} if "coating" in more else {"particle": particles}),
        "substrate": {"material": "SS304", **size, **more.pop("substrate", {})},
        "resolution": {"spacing": f"{spacing:.6g} um", **more.pop("resolution", {})}, **more,
    }  # fmt: skip


def battery() -> dict[str, Table]:
    """Scenes by name."""
    return {name: scene for scenes in kinds().values() for name, scene in scenes.items()}


def kinds() -> dict[str, dict[str, Table]]:
    """Scenes by kind and name, the hardest kinds first."""
    known = read_toml(WORKFLOWS / "hard_scenes.toml")
    own = known.pop("materials")
    return {
        kind: {name: scene(**{"particle": {}, "materials": own, **said}) for name, said in scenes.items()}
        for kind, scenes in known.items()
    }


def play(said: Table, folder: Path) -> Judged:
    """Compute a scene and judge it. Its errors are in the row, not raised."""
    started = clock.process_time()

    def probe(impact: Impact) -> None:
        if clock.process_time() - started > PATIENCE:
            at = f"{impact.time * 1e9:.1f} ns, dt {impact.particle.dt * 1e12:.2f} ps"
            raise Slow(f"did not finish within {PATIENCE:.0f} s: at {at}")

    try:
        checked = Scene.from_dict(said, "hard")
        result = run(checked, folder / "run", force=True, progress=Progress(quiet=True), threads=1, probe=probe)
    except SceneError as error:
        return "refused", {}, [str(error)]
    except ColdsprayError as error:
        return "gives up", {}, [str(error)]
    except Exception as error:
        return "fails", {}, [f"{type(error).__name__}: {error}"]
    return judged(result)


def judged(result: Result) -> Judged:
    """Verdict, row and reasons of a finished run."""
    found = verify.check(result)
    verdict = "fails" if found.faults else "undecided" if found.undecided else "warned" if found.warned else "passes"
    summary, figures = result.summary, found.figures
    impacts, history = summary["impacts"], result.history()
    flattening = verify.value(impacts[-1], "flattening_ratio")
    named = {"depth": "depth", "eps_p max": "eps_p", "T max over T_m": "melting"}
    retries = summary["run"].get("retries") or []
    row = {
        "points": impacts[0]["points"], "steps": sum(i["steps"] for i in impacts), "end ns": f"{history['time'][-1] * 1e9:.1f}",
        "flattening": "" if flattening is None else f"{flattening:.3f}", "rescues": len(retries),
        "stretch": f"{history['stretch_min'].min():.2f}",
        **{name: f"{figures[name]:.2%}" for name in ("drift", "dissipated", "volume", "heat") if name in figures},
        **{name: f"{figures[key]:.2f}" for name, key in named.items() if key in figures},
        **({"momentum": f"{figures['momentum']:.0e}"} if "momentum" in figures else {}),
    }  # fmt: skip
    reasons = found.faults or [*filter(None, [found.undecided]), *found.warned]
    return verdict, row, [*reasons, *dict.fromkeys(f"rescued: {retry['reason']}" for retry in retries)]


def page_part(rows: list[Row]) -> list[str]:
    """Checks, and counts by kind of scene."""
    by_name = {row["scene"]: row for row in rows}
    groups = {kind: [name for name in scenes if name in by_name] for kind, scenes in kinds().items()}
    ends = {"passes": "passes", "warned": "warned", "refused": "a message", "gives up": "a message"}
    shown = list(dict.fromkeys([*ends.values(), *(row["verdict"] for row in rows if row["verdict"] not in ends)]))

    def line(kind: str, own: list[Row]) -> list[object]:
        count = Counter(ends.get(row["verdict"], row["verdict"]) for row in own)
        again = sum(row["rescues"] not in ("", "0") for row in own)
        worst = 100.0 * max(share(row, "dissipated") for row in own)
        return [kind, len(own), *(count[v] for v in shown), again, f"{worst:.0f} %"]

    table = [line(kind, [by_name[name] for name in names]) for kind, names in groups.items()]
    head = ["kind of scene", "scenes", *shown, "computed again", "dissipated, at most"]
    error = f"The energy error is at most {100.0 * max(share(row, 'drift') for row in rows):.1f} %. {versions(rows)}"
    return [CHECKS, *markdown(head, [*table, line("**all**", rows)]), "", error]


def share(row: Row, name: str) -> float:
    """A value that the table gives in percent, as a share; 0 if the cell is empty."""
    text = row[name]
    return abs(float(text[:-1])) / 100.0 if text.endswith("%") else abs(float(text or 0.0))


def draw(rows: list[Row]) -> None:
    """Draw numerical dissipation against the largest plastic strain, by verdict and number of attempts."""
    found = [row for row in rows if row["dissipated"]]
    again = "computed again", [row for row in found if row["rescues"] != "0"]
    groups = [
        *((verdict, [row for row in found if row["verdict"] == verdict]) for verdict in ("passes", "warned")),
        again,
    ]
    styles = (("#0072b2", "#0072b2", "o", 20), ("#d55e00", "#d55e00", "^", 20), ("none", "k", "s", 60))
    with drawing("stability", 6.0, 3.6) as figure:
        axes = figure.add_axes((0.11, 0.14, 0.86, 0.83))
        for (words, own), (colour, edge, mark, size) in zip(groups, styles, strict=True):
            x, y = column(own, "eps_p max"), [100.0 * share(row, "dissipated") for row in own]
            axes.scatter(x, y, s=size, marker=mark, facecolors=colour, edgecolors=edge, label=words)
        axes.axhline(100.0 * verify.DISSIPATION, color="k", ls="--", lw=1)
        axes.set(xscale="log", xlabel="largest plastic strain", ylabel="numerical dissipation (% of kinetic energy)")
        axes.legend(loc="upper left")


if __name__ == "__main__":
    a = options(__doc__, "docs", only="")
    scenes = battery()
    table = study("stability", ("scene",), remake="make stability")
    kept = {row["scene"] for row in table.rows if row["verdict"] != "fails"} if not a.only else set()
    for name in scenes if not a.docs else ():
        if a.only not in name or name in kept:
            continue
        started = clock.process_time()
        with tempfile.TemporaryDirectory() as folder:
            verdict, row, reasons = play(scenes[name], Path(folder))
        why = "; ".join(reasons).replace("\n", " ")
        spent = f"{clock.process_time() - started:.0f}"
        new = table.add({"scene": name, "verdict": verdict, **row, "cpu s": spent, "why": why})
        print(*filter(None, new.values()), sep=" | ", flush=True)
    rows = sorted(table.rows, key=lambda row: list(scenes).index(row["scene"]))
    draw(rows)
    write_parts("stability", {"table": page_part(rows)})
    print(Counter(row["verdict"] for row in rows))

"""Hard scenes, one after another: python workflows/stability.py [--docs] [--only TEXT: scenes with it in their names, computed again]

Coarse (300 to 600 points), so that all of them take minutes. Rows in the table are not computed again, but for those that fail, so
that the battery goes on where it was stopped. The judge of each result is `verify.check`, independent of the program's own.
"""

import tempfile
import time as clock
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import verify
from pages import EVIDENCE, column, markdown, options, study_table, versions, write_parts

from coupler import Result, Scene, run
from coupler.errors import ColdsprayError, SceneError
from coupler.impact.exchange import Impact
from coupler.progress import Progress
from coupler.report.picture import blank, save
from coupler.studies.table import Row

POINTS = 400
ALIAS = {"Cu": "OFHC_Cu"}
SLIDE, STEEP = 4.0, 60.0  # diameters that a particle slides beyond an angle, degrees
PATIENCE = 240.0  # s of processor time for one scene
COLUMNS = (
    "scene", "verdict", "points", "steps", "end ns", "flattening", "drift", "momentum", "dissipated", "volume", "heat", "depth",
    "stretch", "eps_p max", "T max over T_m", "rescues", "cpu s", "why",
)  # fmt: skip
Table = dict[str, object]
Judged = tuple[str, Table, list[str]]  # verdict, figures for the row, reasons

CHECKS = f"""A scene passes if an independent check of its files (`workflows/verify.py`) finds no fault:

- no NaN, inverted element, falling plastic strain, or von Mises stress above the flow stress;
- energy error below {verify.LEDGER:.0%} of the initial kinetic energy, momentum error below {verify.MOMENTUM:.0e};
- kinetic energy of the fields within {verify.KINETIC:.1%} of the history, elastic {verify.ELASTIC:.0%}, heat {verify.HEAT:.0%};
- volume of a body within {verify.VOLUME:.1%} of that by its pressure, of a splat {verify.JOINED:.0%} of that by its mass;
- at most {verify.SUNK:.0%} of the surface deeper than one spacing in the target;
- no cooling by more than {verify.UNDERSHOOT:.1%} of the highest rise of temperature;
- measures of the summary equal to those of the fields.

It is *warned* if the run leaves the range of its models: melting, fitted strain rates, numerical dissipation above
{verify.DISSIPATION:.0%}.
""".replace("%", " %")


class Slow(Exception):
    """A scene has used up its time."""


def deadline(patience: float = PATIENCE) -> Callable[[Impact], None]:
    """A probe of an `Impact` that raises Slow after so many seconds of processor time."""
    started = clock.process_time()

    def probe(impact: Impact) -> None:
        if clock.process_time() - started > patience:
            at = f"{impact.time * 1e9:.1f} ns, dt {impact.particle.dt * 1e12:.2f} ps"
            raise Slow(f"did not finish within {patience:.0f} s: at {at}")

    return probe


def particle(
    material: str = "Ni", diameter: float = 25.0, velocity: float = 500.0, *, T: float = 300.0, angle: float = 0.0,
    offset: tuple[float, float] = (0.0, 0.0), shape: str = "sphere", tilt: float = 0.0,
) -> dict[str, object]:  # fmt: skip
    """A table [particle]; um, m/s, K, degrees."""
    return {
        "material": ALIAS.get(material, material), "diameter": f"{diameter} um", "velocity": f"{velocity} m/s",
        "temperature": f"{T} K",
        "angle": f"{angle} deg", "offset": [f"{offset[0]} um", f"{offset[1]} um"], "shape": shape, "tilt": f"{tilt} deg",
    }  # fmt: skip


def scene(
    *particles: dict[str, object], on: str = "SS304", points: int = POINTS, **more: dict[str, object]
) -> dict[str, object]:
    """A scene with so many points in its largest particle, on a target four diameters wide, and wider where one slides."""
    largest = max(float(p["diameter"].split()[0]) for p in particles)
    far = max(np.hypot(*(float(x.split()[0]) for x in p["offset"])) for p in particles)
    far += max(SLIDE * largest * (float(p["angle"].split()[0]) > STEEP) for p in particles)
    wide = 2.0 if any(p["shape"] in ("rod", "flake", "oblate", "hollow_sphere") for p in particles) else 1.0
    spacing = (np.pi / 6 * largest**3 / points) ** (1 / 3)
    substrate = {
        "material": ALIAS.get(on, on),
        "diameter": f"{4 * largest * wide + 2 * far:.6g} um",
        "height": f"{2.5 * largest:.6g} um",
    }
    return {
        "particle": list(particles), "substrate": substrate | more.pop("substrate", {}),
        "resolution": {"spacing": f"{spacing:.6g} um"} | more.pop("resolution", {}), **more,
    }  # fmt: skip


def battery() -> dict[str, Table]:
    """Scenes by name."""
    return {name: scene for scenes in kinds().values() for name, scene in scenes.items()}


def kinds() -> dict[str, dict[str, Table]]:
    """Scenes by kind and name, the hardest kinds first."""
    return of_particles() | of_targets()


def of_particles() -> dict[str, dict[str, Table]]:
    """Scenes that are hard for their particle: metals, angle, temperature and shape."""
    p, groups = particle, dict[str, dict[str, Table]]()
    materials = {
        "materials": {
            "Soft": {"base": "Al", "A": "10 MPa"}, "Softest": {"base": "Al", "A": "10 MPa", "B": "10 MPa"},
            "Hard": {"base": "42CrMo4", "A": "3 GPa"},
        }
    }  # fmt: skip
    cases = groups["made-up hard and soft metals"] = {}
    for material, on, velocity in (
        ("Hard", "Soft", 1200), ("Hard", "Soft", 500), ("Hard", "Soft", 200), ("Soft", "Hard", 500), ("Soft", "Hard", 1250),
        ("Soft", "Soft", 500), ("Hard", "Hard", 1250), ("Softest", "Hard", 300), ("Hard", "Softest", 300),
    ):  # fmt: skip
        cases[f"{material} on {on}, {velocity} m/s"] = scene(p(material, velocity=velocity), on=on, **materials)
    cases["Soft on Hard at 80 degrees, 800 m/s"] = scene(p("Soft", velocity=800, angle=80), on="Hard", **materials)
    cases = groups["metals on metals, 500 to 2000 m/s"] = {}
    for material, on, velocity in (
        ("Cu", "Cu", 2000), ("Cu", "SS304", 1500), ("Al", "42CrMo4", 1250), ("42CrMo4", "Al", 1250), ("Cu", "Ti", 1250),
        ("Ti", "Cu", 1250), ("Ni", "Al", 1250), ("Al", "Cu", 1250), ("SS304", "Cu", 1250), ("Al", "Al", 1250), ("Cu", "SS304", 1250),
        ("42CrMo4", "Ti", 1250), ("Ti", "Al", 1250), ("Ti", "SS304", 1000), ("Al", "SS304", 1000), ("SS304", "Al", 1000),
        ("Ni", "SS304", 500), ("Ni", "Al", 500), ("Ti", "SS304", 500), ("Cu", "Al", 500), ("Al", "SS304", 500), ("SS304", "Ti", 500),
    ):  # fmt: skip
        cases[f"{material} on {on}, {velocity} m/s"] = scene(p(material, velocity=velocity), on=on)
    cases = groups["oblique, 15 to 80 degrees"] = {}
    cases["Ni at 80 degrees, gap of 25 um"] = scene(p(angle=80) | {"gap": "25 um"})
    for angle in (15, 45, 60, 75, 80):
        cases[f"Ni at {angle} degrees"] = scene(p(angle=angle))
    cases["Cu 800 m/s at 75 degrees"] = scene(p("Cu", velocity=800, angle=75))
    cases["Al 1250 m/s at 80 degrees"] = scene(p("Al", velocity=1250, angle=80))
    cases["Ti at 45 degrees on Al"] = scene(p("Ti", angle=45), on="Al")
    cases = groups["hot, up to 0.95 of melting"] = {}
    for material, T, on, T_on, velocity in (
        ("Al", 812, "SS304", 300, 800), ("Ni", 1639, "SS304", 300, 500), ("Ti", 1826, "Al", 300, 500), ("Cu", 1288, "Al", 812, 500),
        ("42CrMo4", 1722, "SS304", 1710, 800), ("Al", 800, "SS304", 300, 500), ("Cu", 1250, "Al", 780, 500),
        ("Ni", 1000, "SS304", 900, 800),
        ("Ti", 1000, "Al", 300, 500), ("Ni", 600, "SS304", 300, 500), ("Ni", 1000, "SS304", 300, 500),
    ):  # fmt: skip
        cases[f"{material} at {T} K on {on} at {T_on} K, {velocity} m/s"] = scene(
            p(material, velocity=velocity, T=T), on=on, substrate={"temperature": f"{T_on} K"}
        )
    cases = groups["rods, flakes, hollow and angular particles"] = {}
    for material, shape, tilt, on, velocity in (
        ("Ni", "hollow_sphere", 0, "SS304", 500), ("Al", "hollow_sphere", 0, "42CrMo4", 1250), ("Ni", "rod", 90, "SS304", 500),
        ("Ni", "rod", 0, "SS304", 500), ("Ni", "rod", 45, "SS304", 500), ("Al", "rod", 90, "42CrMo4", 1000),
        ("Ni", "flake", 90, "SS304", 500), ("Ni", "flake", 0, "SS304", 500), ("Cu", "flake", 90, "SS304", 1000),
        ("Ni", "oblate", 90, "SS304", 500), ("Ni", "angular", 35, "SS304", 500), ("Ni", "angular", 35, "SS304", 900),
    ):  # fmt: skip
        points = {"flake": 1200, "hollow_sphere": 600}.get(shape, POINTS)
        name = f"{material} {shape.replace('_', ' ')}, tilt {tilt}, on {on}, {velocity} m/s"
        cases[name] = scene(p(material, shape=shape, tilt=tilt, velocity=velocity), on=on, points=points)
    return groups


def of_targets() -> dict[str, dict[str, Table]]:
    """Scenes that are hard for contact or target, and extremes of size, velocity and resolution."""
    p, groups = particle, dict[str, dict[str, Table]]()
    cases = groups["friction of 0 to 2"] = {}
    for friction, velocity, angle in ((0, 500, 0), (0, 1000, 0), (1, 800, 60), (2, 500, 0), (2, 1000, 75)):
        name, contact = f"Ni friction {friction}, {velocity} m/s, {angle} degrees", {"friction": float(friction)}
        cases[name] = scene(p(velocity=velocity, angle=angle), contact=contact)
    cases = groups["thin substrates"] = {}
    thin = {"height": "50 um", "bottom": "free", "sides": "free"}
    cases["Ni on a thin free substrate, 800 m/s"] = scene(p(velocity=800), substrate=thin)
    thinner, fixed = thin | {"height": "30 um"}, thin | {"bottom": "fixed", "sides": "fixed"}
    cases["Ni on a thinner free substrate of Al, 800 m/s"] = scene(p(velocity=800), on="Al", substrate=thinner)
    cases["Ni on a thin fixed substrate of Al"] = scene(p(), on="Al", substrate=fixed)
    cases = groups["on and beside splats"] = {}
    cases["Ni on the rim of a Ni splat"] = scene(p(), p(offset=(15, 0)))
    cases["Ni between two Ni splats"] = scene(p(offset=(-17, 0)), p(offset=(17, 0)), p())
    cases["Ni on a Ti splat that is not bonded"] = scene(p("Ti"), p(), adhesion={"kind": "none"})
    cases["Al on a Ni splat, 700 m/s"] = scene(p(), p("Al", velocity=700))
    titanium, copper = p("Ti", velocity=700, offset=(12, 8)), p("Cu", velocity=700, angle=45, offset=(-20, 5))
    cases["Ti on the rim of an Al splat on Ti, 700 m/s"] = scene(p("Al"), titanium, on="Ti")
    cases["Cu at 45 degrees on the rim of a Ni splat, 700 m/s"] = scene(p(), copper)
    cases["Cu 15 um on a Ni splat of 25 um"] = scene(p(), p("Cu", diameter=15.5), points=900)
    cases = groups["diameters of 1 to 60 µm"] = {}
    for diameter in (1, 3, 10, 40, 60):
        cases[f"Ni {diameter} um"] = scene(p(diameter=diameter))
    cases["Al 1 um on SS304, 1250 m/s"] = scene(p("Al", diameter=1, velocity=1250))
    cases["Cu 60 um on Al, 1000 m/s"] = scene(p("Cu", diameter=60, velocity=1000), on="Al")
    cases = groups["nickel, 50 to 1500 m/s"] = {}
    for velocity in (50, 150, 300, 750, 1000, 1500):
        cases[f"Ni {velocity} m/s"] = scene(p(velocity=velocity))
    cases = groups["extreme resolution and duration"] = {}
    cases["Ni coarsest, 1000 m/s"] = scene(p(velocity=1000), points=210)
    cases["Ni elements four times the spacing"] = scene(p(), points=2000, resolution={"element_size": "6.2 um"})
    cases["Ni elements smaller than the spacing"] = scene(p(), resolution={"element_size": "2 um"})
    cases["Ni elements that grow at once"] = scene(p(), resolution={"growth": 1.0})
    cases["Ni followed for 1 us"] = scene(p(), end={"time": "1000 ns"}, output={"every": "50 ns"})
    return groups


def play(said: Table, folder: Path) -> Judged:
    """Compute a scene and judge it. Its errors are in the row, not raised."""
    try:
        checked = Scene.from_dict(said, "hard")
        result = run(checked, folder / "run", force=True, progress=Progress(quiet=True), threads=1, probe=deadline())
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
    """A share that the table has in percent, 0 where it has none."""
    text = row[name]
    return abs(float(text[:-1])) / 100.0 if text.endswith("%") else abs(float(text or 0.0))


def draw(rows: list[Row]) -> None:
    """Numerical dissipation over the largest plastic strain, by verdict and number of attempts."""
    figure = blank(6.0, 3.6, 110)
    axes = figure.add_axes((0.11, 0.14, 0.86, 0.83))
    found = [row for row in rows if row["dissipated"]]
    for words, colour, mark, choose in (
        ("passes", "#0072b2", "o", lambda row: row["verdict"] == "passes"),
        ("warned", "#d55e00", "^", lambda row: row["verdict"] == "warned"),
        ("computed again", "none", "s", lambda row: row["rescues"] != "0"),
    ):
        own = [row for row in found if choose(row)]
        x, y = column(own, "eps_p max"), [100.0 * share(row, "dissipated") for row in own]
        size, edge = (60, "k") if colour == "none" else (20, colour)
        axes.scatter(x, y, s=size, marker=mark, facecolors=colour, edgecolors=edge, label=words)
    axes.axhline(100.0 * verify.DISSIPATION, color="k", ls="--", lw=1)
    axes.set(xscale="log", xlabel="largest plastic strain", ylabel="numerical dissipation (% of kinetic energy)")
    axes.legend(loc="upper left")
    save(figure, EVIDENCE / "stability.png")


def main() -> None:
    """Compute the scenes that the table lacks, and those that fail."""
    a = options(__doc__, "docs", only="")
    scenes = battery()
    table = study_table("stability", COLUMNS, ("scene",), "make stability")
    kept = {row["scene"] for row in table.rows if row["verdict"] != "fails"} if not a.only else set()
    for name in scenes if not a.docs else ():
        if a.only not in name or name in kept:
            continue
        started = clock.process_time()
        with tempfile.TemporaryDirectory() as folder:
            verdict, row, reasons = play(scenes[name], Path(folder))
        why = "; ".join(reasons).replace("\n", " ")
        spent = f"{clock.process_time() - started:.0f}"
        new = table.add({**row, "scene": name, "verdict": verdict, "cpu s": spent, "why": why})
        print(*filter(None, new.values()), sep=" | ", flush=True)
    rows = sorted(table.rows, key=lambda row: list(scenes).index(row["scene"]))
    draw(rows)
    write_parts("stability", {"table": page_part(rows)})
    print(Counter(row["verdict"] for row in rows))


if __name__ == "__main__":
    main()

"""How well `coldspray check` predicts time: twenty scenes that nothing was fitted on, and the fits themselves.

    python workflows/pace.py            # the scenes, each run in one thread: docs/tables/pace.csv
    python workflows/pace.py --fit      # runs nothing: fits the constants of coupler/plan/cost.py to docs/tables and prints them

The machine is timed again before every TIMED-th scene, as other work on it comes and goes. Times are of the processor, without the
start of the program and the loading of compiled kernels. Rows in the table are not computed again.
"""

import math
import tempfile
from pathlib import Path

import numpy as np
import stability
from pages import ROOT, column, options, study_table, table_rows
from scipy.optimize import least_squares

from coupler import run
from coupler.physics.materials import Material, material
from coupler.physics.shapes import sphere_volume
from coupler.plan import cost
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.studies import ladder_runs, pace, timing

TIMED = 4
LADDERS = {"single_ni": "ni500", "single_ti": "ti500", "fast_ni": "ni1000"}  # scene of workflows/: its accuracy table
COLUMNS = (
    "round", "scene", "points", "steps_said", "steps", "said_s", "took_s", "off_percent", "pace_steps", "pace_points",
)  # fmt: skip
Table = dict[str, object]


def scene(particles: list[Table], on: str, preset: str = "draft", **more: object) -> Table:
    """A scene as nested dicts; diameters um, velocities m/s, temperatures K, angles deg."""
    units = {"diameter": "um", "velocity": "m/s", "temperature": "K", "angle": "deg", "tilt": "deg"}
    tables = [{k: f"{v} {units[k]}" if k in units else v for k, v in p.items()} for p in particles]
    wide = max(float(str(p["diameter"])) for p in particles)
    base = {"material": on, "diameter": f"{8 * wide} um", "height": f"{4 * wide} um"}
    return {"particle": tables, "substrate": base, "preset": preset, **more}


def p(material: str, diameter: float, velocity: float, **more: object) -> Table:
    return {"material": material, "diameter": diameter, "velocity": velocity, **more}


FIRST = {
    "Cu 20 um on SS304, 450 m/s": scene([p("OFHC_Cu", 20, 450)], "SS304"),
    "Al 35 um on Cu, 650 m/s": scene([p("Al", 35, 650)], "OFHC_Cu"),
    "SS304 15 um at 500 K on Ti, 800 m/s": scene([p("SS304", 15, 800, temperature=500)], "Ti"),
    "Ti 45 um on Al, 350 m/s": scene([p("Ti", 45, 350)], "Al"),
    "Ni 30 um on Cu at 25 degrees, 600 m/s": scene([p("Ni", 30, 600, angle=25)], "OFHC_Cu"),
    "42CrMo4 25 um on SS304, 700 m/s": scene([p("42CrMo4", 25, 700)], "SS304"),
    "Ti 25 um on Ti, 650 m/s, standard": scene([p("Ti", 25, 650)], "Ti", "standard"),
    "Ni 25 um on Ti to greatest deformation": scene([p("Ni", 25, 550)], "Ti", end={"at": "greatest"}),
    "Ti 30 um flake on SS304, 400 m/s": scene([p("Ti", 30, 400, shape="flake")], "SS304"),
    "Ti 25 um on a splat of Ti, 500 m/s": scene([p("Ti", 25, 500), p("Ti", 25, 500)], "SS304"),
}
SECOND = {
    "Cu 30 um on Al, 400 m/s": scene([p("OFHC_Cu", 30, 400)], "Al"),
    "Al 25 um on Al, 600 m/s": scene([p("Al", 25, 600)], "Al"),
    "SS304 40 um on SS304, 650 m/s": scene([p("SS304", 40, 650)], "SS304"),
    "Ti 20 um at 600 K on SS304, 600 m/s": scene([p("Ti", 20, 600, temperature=600)], "SS304"),
    "Ni 15 um on Al, 700 m/s": scene([p("Ni", 15, 700)], "Al"),
    "42CrMo4 30 um on Al, 450 m/s": scene([p("42CrMo4", 30, 450)], "Al"),
    "Ni 40 um on Cu, 400 m/s": scene([p("Ni", 40, 400)], "OFHC_Cu"),
    "Ti 35 um on SS304 to greatest deformation, 600 m/s": scene([p("Ti", 35, 600)], "SS304", end={"at": "greatest"}),
    "Ni 25 um oblate on SS304, 550 m/s": scene([p("Ni", 25, 550, shape="oblate")], "SS304"),
    "Ti 30 um on Ti at 15 degrees, 500 m/s": scene([p("Ti", 30, 500, angle=15)], "Ti"),
}
SCENES = {**FIRST, **SECOND}


def judge(name: str, here: pace.Pace) -> Table:
    """Estimate, run, compare."""
    checked = Scene.from_dict({**SCENES[name], "name": "pace"})
    planned = plan(checked)
    with tempfile.TemporaryDirectory() as folder:
        before = ladder_runs.spent()
        result = run(checked, Path(folder) / "run", threads=1)
        took = ladder_runs.spent() - before
    estimate = here.seconds(planned)
    values = (
        1 if name in FIRST else 2, name, checked.derived.points, planned.steps_estimate, result.steps, round(estimate, 2),
        round(took, 2), round(100 * (estimate / took - 1), 1), round(here.steps, 3), round(here.points, 3),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def terms(
    first: Material, base: Material, T: float, T_base: float, v: float, D: float, points: float, angle: float
) -> list[float]:
    d = cost.damage_numbers((first, base), (T, T_base), v, D)
    return [1.0, math.log(d[0]), math.log(d[1]), math.log(points / 1000.0), math.sin(angle) ** 2]


def impacts() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Terms (n, 5), ln(time to rest v / height) (n,), ln(c dt / spacing) (n,) of the single impacts in docs/tables."""
    data = []
    battery = stability.battery()
    for row in table_rows("stability"):
        if row["scene"] not in battery or row["rescues"] != "0" or row["verdict"] != "passes":
            continue
        checked = Scene.from_dict(battery[row["scene"]], "battery")
        p = checked.particle
        odd = "friction" in row["scene"] or "elements" in row["scene"] or p.shape != "sphere"
        if odd or len(checked.particles) > 1 or checked.end.time:
            continue
        first, base = (checked.derived.material(name) for name in (p.material, checked.substrate.material))
        end, points = float(row["end ns"]) * 1e-9, p.volume / checked.derived.spacing**3
        T = checked.substrate.temperature
        row_terms = terms(first, base, p.temperature, T, p.velocity, p.diameter, points, p.angle)
        cfl = end / int(row["steps"]) * first.wave_speed / checked.derived.spacing
        data.append((row_terms, math.log(end * p.velocity / p.diameter), math.log(cfl)))
    singles = [
        (r["material"], r["diameter_um"], r["speed_m_s"], r["temperature_K"], r["points"], r["steps"], r["dt_ps"])
        for name in ("validation", "validation_trends") for r in table_rows(name)
        if r["impact"] == "1" and r["steps"] and r["engine"] == "enriched" and "shape" not in r["run"]
    ]  # fmt: skip
    for name in LADDERS:
        p = Scene.load(ROOT / "workflows" / f"{name}.toml").particle
        at = (p.material, p.diameter * 1e6, p.velocity, p.temperature)
        rows = [
            r
            for r in table_rows(f"accuracy_{LADDERS[name]}")
            if r["axis"] in ("points", "reference") and not r["failed"]
        ]
        singles += [(*at, r["points_used"], r["steps"], 1e12 * float(r["dt_mean_s"])) for r in rows]
    for name, *numbers in singles:
        D, v, T, points, steps, dt = map(float, numbers)
        first, time = material(name), steps * dt * 1e-12
        spacing = cost.spacing(sphere_volume(D * 1e-6), int(points))
        row_terms = terms(first, material("SS304"), T, 300.0, v, D * 1e-6, points, 0.0)
        cfl = dt * 1e-12 * first.wave_speed / spacing
        data.append((row_terms, math.log(time * v / (D * 1e-6)), math.log(cfl)))
    F, rest, courant = zip(*data, strict=True)
    return np.array(F), np.array(rest), np.array(courant)


def fit() -> None:
    """Print the constants for coupler/plan/cost.py."""
    F, rest, cfl = impacts()
    k = np.linalg.lstsq(F, rest, rcond=None)[0]
    print(f"{len(F)} impacts\nREST_FIT = {tuple(float(round(x, 3)) for x in k)}  # rms {np.std(rest - F @ k):.1%}")

    def model(k: np.ndarray) -> np.ndarray:
        return -np.log(1.0 / cost.CFL["enriched"][0] + np.exp(np.clip(F @ k, -20.0, 20.0)))

    start = np.array([0.0, 0.5, 0.0, 0.0, 0.0])
    # soft_l1: a few impacts defy any such law
    best = least_squares(lambda k: model(k) - cfl, start, loss="soft_l1", f_scale=0.1).x
    off = np.abs(cfl - model(best))
    print(f"CFL, of enriched = {tuple(float(round(x, 3)) for x in best)}  # half within {np.median(off):.1%}, 9 of 10 within "
          f"{np.percentile(off, 90):.1%}")  # fmt: skip
    rows = [row for name in LADDERS.values() for row in table_rows(f"accuracy_{name}") if not row["failed"]]
    N, E, n, loop, whole = (column(rows, c) for c in ("points_used", "elements", "steps", "cpu_loop_s", "cpu_s"))
    A = np.stack([N, E, np.ones_like(N)], axis=1)
    weight = n / loop  # relative errors
    seconds = np.linalg.lstsq(A * weight[:, None], np.ones_like(N), rcond=None)[0]
    print("SECONDS_PER_POINT, _ELEMENT, _STEP =", seconds, f"rms {np.std(A @ seconds * weight):.1%}")
    rest_of = np.linalg.lstsq(np.stack([np.ones_like(E), E], axis=1), whole - loop, rcond=None)[0]
    print("a run but its loop, s: constant, per element =", rest_of)


def main() -> None:
    """Judge the ten scenes, or fit."""
    if options(__doc__, "fit").fit:
        fit()
        return
    table = study_table("pace", COLUMNS, ("scene",), "python workflows/pace.py")
    here = None
    for number, name in enumerate(name for name in SCENES if (name,) not in table):
        if here is None or number % TIMED == 0:
            here = pace.Pace(*timing.measure(), "")
        print(table.add(judge(name, here)), flush=True)
    for number in ("1", "2"):
        off = [abs(float(row["off_percent"])) for row in table.rows if row["round"] == number]
        print(f"round {number}: {sum(x <= 30 for x in off)} of {len(off)} within 30 %")


if __name__ == "__main__":
    main()

"""How well `coldspray check` predicts steps and time: scenes that nothing was fitted on, and the fit itself.

    python workflows/pace.py            # the scenes, each run in one thread: docs/tables/pace.csv
    python workflows/pace.py --sample   # impacts drawn at random, for the fit: docs/tables/pace_sample.csv
    python workflows/pace.py --fit      # runs nothing: fits the constants of coupler/plan/cost.py to docs/tables and prints them

The machine is timed again before every TIMED-th scene, as other work on it comes and goes. Times are of the processor, without the
start of the program. Rows in the tables are not computed again.
"""

import itertools
import math
import tempfile
from pathlib import Path

import numpy as np
import stability
from pages import options, study_table, table_rows
from scipy.optimize import least_squares

from coupler import run
from coupler.physics.materials import Material, material
from coupler.physics.shapes import sphere_volume
from coupler.plan import cost
from coupler.plan.forecast import forecast
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.studies import ladder, pace, timing
from coupler.studies.table import cell

TIMED = 4
COLUMNS = ("scene", "points", "steps_said", "steps", "said_s", "took_s", "off_percent", "retries", "pace")
DRAWN = ("particle", "target", "diameter_um", "velocity_m_s", "temperature_K", "target_K", "angle_deg")
METALS = ("Al", "Al7075", "OFHC_Cu", "Ni", "Ti", "SS304", "SS316L", "42CrMo4", "IN718")
SAMPLE = 75
SAMPLED = ("draft", "standard")  # presets
SCATTER = 0.15  # of the logarithms of the fit: what is farther off counts less
Table = dict[str, object]


def scene(metal: str, diameter: float, velocity: float, on: str, preset: str = "draft", T: float = 300.0,
          T_target: float = 300.0, angle: float = 0.0) -> Table:  # fmt: skip
    """A scene as nested dicts; diameter um, velocity m/s, temperatures K, angle deg."""
    particle = {"material": metal, "diameter": f"{diameter} um", "velocity": f"{velocity} m/s", "temperature": f"{T} K"}
    size = {"diameter": f"{8 * diameter} um", "height": f"{4 * diameter} um"}
    base = {"material": on, **size, "temperature": f"{T_target} K"}
    return {"particle": [particle | {"angle": f"{angle} deg"}], "substrate": base, "preset": preset}


SCENES = {
    "Al 25 um on SS304, 620 m/s": scene("Al", 25, 620, "SS304"),
    "Al 25 um on SS304, 620 m/s, standard": scene("Al", 25, 620, "SS304", "standard"),
    "Cu 20 um on SS304, 450 m/s": scene("OFHC_Cu", 20, 450, "SS304"),
    "Cu 25 um on Cu, 575 m/s": scene("OFHC_Cu", 25, 575, "OFHC_Cu"),
    "Cu 20 um at 700 K on 42CrMo4, 400 m/s": scene("OFHC_Cu", 20, 400, "42CrMo4", T=700),
    "Al 35 um on Cu, 650 m/s": scene("Al", 35, 650, "OFHC_Cu"),
    "Ti 25 um at 800 K on Ti at 500 K, 650 m/s": scene("Ti", 25, 650, "Ti", T=800, T_target=500),
    "Ni 30 um on Cu at 25 degrees, 600 m/s": scene("Ni", 30, 600, "OFHC_Cu", angle=25),
    "SS316L 25 um on SS316L, 750 m/s": scene("SS316L", 25, 750, "SS316L"),
    "IN718 30 um at 600 K on Al, 500 m/s": scene("IN718", 30, 500, "Al", T=600),
    "Ti 25 um on Ti, 650 m/s, standard": scene("Ti", 25, 650, "Ti", "standard"),
    "Ni 25 um on SS304, 500 m/s, fine": scene("Ni", 25, 500, "SS304", "fine"),
}


def draw() -> list[Table]:
    """Impacts by the columns DRAWN, drawn from one seed."""
    rng, drawn = np.random.default_rng(1), []
    for _ in range(SAMPLE):
        metal, on = (str(rng.choice(METALS)) for _ in range(2))
        diameter, velocity = round(float(rng.uniform(12, 45)), 1), round(float(rng.uniform(250, 900)))
        T = 300 if rng.random() < 0.6 else round(float(rng.uniform(350, 0.6 * material(metal).T_m)))
        T_target = 300 if rng.random() < 0.7 else round(float(rng.uniform(350, 700)))
        angle = 0 if rng.random() < 0.75 else round(float(rng.uniform(5, 45)))
        drawn.append(dict(zip(DRAWN, (metal, on, diameter, velocity, T, T_target, angle), strict=True)))
    return drawn


def computed(made: Table, **more: object) -> tuple[dict[str, object], float]:
    """The summary of a scene's impact, run in one thread, with its `retries`, and the processor time, s. more: keys of the scene."""
    with tempfile.TemporaryDirectory() as folder:
        before = ladder.spent()
        result = run(Scene.from_dict({**made, "name": "pace", **more}), Path(folder) / "run", threads=1, quiet=True)
        return {**result.impacts[0], "retries": len(result.summary["run"]["retries"])}, ladder.spent() - before


def judge(name: str, here: pace.Pace) -> Table:
    """Estimate, run, compare."""
    planned = plan(Scene.from_dict({**SCENES[name], "name": "pace"}))
    computed(SCENES[name], end={"time": f"{0.2e9 * planned.impact.expected:.3g} ns"})  # compiles the kernels
    estimate, (impact, took) = here.seconds(planned), computed(SCENES[name])
    values = (
        name, planned.impact.points, sum(forecast(planned).steps), impact["steps"], round(estimate, 2), round(took, 2),
        round(100 * (estimate / took - 1)), impact["retries"], round(here.factor, 3),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def sample() -> None:
    """Run the impacts that are drawn."""
    columns, key = (*DRAWN, "preset", "steps", "time_ns", "retries"), (*DRAWN, "preset")
    table = study_table("pace_sample", columns, key, "python workflows/pace.py --sample")
    for preset, drawn in itertools.product(SAMPLED, draw()):
        if (*(cell(value) for value in drawn.values()), preset) not in table:
            metal, on, diameter, velocity, T, T_target, angle = drawn.values()
            impact, _ = computed(scene(metal, diameter, velocity, on, preset, T, T_target, angle))  # type: ignore[arg-type]
            found = {"steps": impact["steps"], "time_ns": 1e9 * impact["end"]["time_s"], "retries": impact["retries"]}  # type: ignore[operator]
            print(table.add({**drawn, "preset": preset, **found}), flush=True)


def impacts() -> tuple[np.ndarray, ...]:
    """Damage numbers d_p, d_t, points N, angle (rad), ln(time to rest v / D), ln(spacing / (c dt)), each (n,), of the single impacts in
    docs/tables that nothing has rescued and that are no coarser than `draft`."""
    singles: list[tuple[Material, Material, float, float, float, float, float, float, float, float]] = []
    steel = material("SS304")
    battery = stability.battery()
    for row in table_rows("stability"):
        if row["scene"] not in battery or row["rescues"] != "0" or not row["steps"]:
            continue
        made = Scene.from_dict(battery[row["scene"]], "battery")
        p, d = made.particle, made.derived
        odd = "friction" in row["scene"] or "elements" in row["scene"] or p.shape != "sphere" or len(made.particles) > 1
        if odd or made.end.time or made.resolution.engine != "enriched":
            continue
        pair = d.material(p.material), d.material(made.substrate.material)
        hot = p.temperature, made.substrate.temperature
        N, steps, time = p.volume / d.spacing**3, float(row["steps"]), 1e-9 * float(row["end ns"])
        singles.append((*pair, p.diameter, p.velocity, *hot, p.angle, N, steps, time))
    for row in (r for name in ("validation", "validation_trends") for r in table_rows(name)):
        if row["impact"] == "1" and row["steps"] and row["engine"] == "enriched" and "shape" not in row["run"]:
            D, v, T, N, steps, dt = (
                float(row[c]) for c in ("diameter_um", "speed_m_s", "temperature_K", "points", "steps", "dt_ps")
            )
            singles.append((material(row["material"]), steel, 1e-6 * D, v, T, 300.0, 0.0, N, steps, 1e-12 * steps * dt))
    for row in table_rows("pace_sample"):
        if row["retries"] == "0":
            D, v, T, T_t, angle, steps, time = (float(row[c]) for c in (*DRAWN[2:], "steps", "time_ns"))
            pair = material(row["particle"]), material(row["target"])
            points = cost.PRESETS[row["preset"]]
            singles.append((*pair, 1e-6 * D, v, T, T_t, math.radians(angle), points, steps, 1e-9 * time))
    data = []
    for first, base, D, v, T, T_t, angle, N, steps, time in singles:
        inverse = steps * cost.spacing(sphere_volume(D), round(N)) / (first.wave_speed * time)
        data.append((*cost.loads((first, base), (T, T_t), v, D), N, angle, math.log(time * v / D), math.log(inverse)))
    return tuple(np.array([row for row in data if row[2] > 0.9 * cost.PRESETS["draft"]]).T)


def fit() -> None:
    """Print the constants for coupler/plan/cost.py."""
    w_p, w_t, N, angle, rest, inverse = impacts()

    def crossings(k: np.ndarray) -> np.ndarray:
        return np.log(np.exp(k[0]) * w_p ** k[1] + np.exp(k[2]) * w_t ** k[3]) + k[4] * np.sin(angle) ** 2

    def steps(k: np.ndarray) -> np.ndarray:
        pressed, alone = np.cos(angle) * (np.cos(angle) + k[6] * np.sin(angle)), ((w_p - w_t) / (w_p + w_t)) ** 2
        excess = np.exp(k[0]) * (pressed * w_p) ** k[1] * (1.0 + w_p) ** (k[4] * alone)
        excess += np.exp(k[2]) * (pressed * w_t) ** k[3]
        return np.log(1.0 / cost.CFL["enriched"] + excess * (N / 1000.0) ** (k[5] * alone))

    print(len(rest), "impacts; a, b of the particle, a, b of the target, and the last ones")
    parts = []
    for name, model, wanted, start in (("REST_FIT", crossings, rest, [-1, 0.3, -1, 0.5, 1]),
                                       ("STEP_FIT, SHEARED", steps, inverse, [-1, 1, -1, 0.6, 0.5, 0.5, 1.5])):  # fmt: skip
        k = least_squares(lambda k, f=model, y=wanted: f(k) - y, start, loss="soft_l1", f_scale=SCATTER).x
        parts.append(model(k) - wanted)
        print(name, [round(float(x), 3) for x in (math.exp(k[0]), k[1], math.exp(k[2]), *k[3:])])
    off = np.abs(parts[0] + parts[1])
    print(f"steps: half within {np.median(off):.0%}, {np.mean(off < math.log(1.3)):.0%} within 30 %")


def main() -> None:
    """Judge the scenes, draw the sample, or fit."""
    chosen = options(__doc__, "fit", "sample")
    if chosen.fit or chosen.sample:
        return fit() if chosen.fit else sample()
    table = study_table("pace", COLUMNS, ("scene",), "python workflows/pace.py")
    here = None
    for number, name in enumerate(name for name in SCENES if (name,) not in table):
        if here is None or number % TIMED == 0:
            here = pace.Pace(timing.measure(), "")
        print(table.add(judge(name, here)), flush=True)
    off = [abs(float(row["off_percent"])) for row in table.rows]
    print(f"{sum(x <= 30 for x in off)} of {len(off)} within 30 %")
    return None


if __name__ == "__main__":
    main()

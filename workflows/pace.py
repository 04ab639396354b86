"""The fit of what `coldspray check` predicts: steps and time to rest of single impacts: python workflows/pace.py

    python workflows/pace.py            # impacts drawn at random, each run in one thread: docs/tables/pace_sample.csv
    python workflows/pace.py --fit      # runs nothing: fits the constants of coupler/plan/cost.py to docs/tables and prints them

Rows in the table are not computed again.
"""

import itertools
import math
from collections.abc import Iterator

import numpy as np
import stability
from pages import computed, impact_tables, options
from scipy.optimize import least_squares
from study_table import study, table_rows

from coupler.physics.materials import Material, material
from coupler.physics.shapes import sphere_volume
from coupler.plan import cost
from coupler.plan.reading import Scene
from coupler.studies.table import cell

DRAWN = ("particle", "target", "diameter_um", "velocity_m_s", "temperature_K", "target_K", "angle_deg")
METALS = ("Al", "Al7075", "OFHC_Cu", "Ni", "Ti", "SS304", "SS316L", "42CrMo4", "IN718")
SAMPLE = 75
SAMPLED = ("draft", "standard")  # presets
SCATTER = 0.15  # of the logarithms about the fit: impacts with a larger deviation count less


def row_of(metal: str, on: str, D: str, v: str, T: str, T_target: str, angle: str, preset: str) -> dict[str, object]:
    """Steps, time to rest and retries of an impact; diameter um, velocity m/s, temperatures K, angle deg."""
    size = 8 * float(D), 4 * float(D)
    tables = impact_tables(metal, float(D), float(v), on, size, temperature=f"{T} K", angle=f"{angle} deg")
    tables["substrate"]["temperature"] = f"{T_target} K"
    scene = Scene.from_dict({**tables, "preset": preset, "name": "pace"})
    with computed(scene) as (result, _):
        impact, retries = result.impacts[0], len(result.summary["run"]["retries"])
    return {"steps": impact["steps"], "time_ns": 1e9 * impact["end"]["time_s"], "retries": retries}


def drawn() -> Iterator[tuple[str, ...]]:
    """Impacts by the columns DRAWN, drawn from one seed."""
    rng = np.random.default_rng(1)
    for _ in range(SAMPLE):
        metal, on = (str(rng.choice(METALS)) for _ in range(2))
        diameter, velocity = round(float(rng.uniform(12, 45)), 1), round(float(rng.uniform(250, 900)))
        T = 300 if rng.random() < 0.6 else round(float(rng.uniform(350, 0.6 * material(metal).T_m)))
        T_target = 300 if rng.random() < 0.7 else round(float(rng.uniform(350, 700)))
        angle = 0 if rng.random() < 0.75 else round(float(rng.uniform(5, 45)))
        yield tuple(map(cell, (metal, on, diameter, velocity, T, T_target, angle)))


def impacts() -> tuple[np.ndarray, ...]:
    """Damage numbers d_p, d_t, points N, angle (rad), ln(time to rest v / D), ln(spacing / (c dt)), each (n,), of the single impacts in
    docs/tables that needed no retry and are not coarser than `draft`."""
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

    print(len(rest), "impacts; constants: a, b of the particle, a, b of the target, then all others")
    parts = []
    for name, model, wanted, start in (("REST_FIT", crossings, rest, [-1, 0.3, -1, 0.5, 1]),
                                       ("STEP_FIT, SHEARED", steps, inverse, [-1, 1, -1, 0.6, 0.5, 0.5, 1.5])):  # fmt: skip
        k = least_squares(lambda k, f=model, y=wanted: f(k) - y, start, loss="soft_l1", f_scale=SCATTER).x
        parts.append(model(k) - wanted)
        print(name, [round(float(x), 3) for x in (math.exp(k[0]), k[1], math.exp(k[2]), *k[3:])])
    off = np.abs(parts[0] + parts[1])
    print(f"steps: half within {np.median(off):.0%}, {np.mean(off < math.log(1.3)):.0%} within 30 %")


if __name__ == "__main__":
    if options(__doc__, "fit").fit:
        fit()
    else:
        keys = ((*each, preset) for preset, each in itertools.product(SAMPLED, list(drawn())))
        study("pace_sample", (*DRAWN, "preset"), keys, row_of)

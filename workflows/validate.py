"""Computes the cases and trends of the paper whose method coldspray follows, and compares them with its numbers.

    python workflows/validate.py                   # computes what the tables lack, then writes the page
    python workflows/validate.py --only cases      # one or more of: cases, pairs, spread, trends, shapes, scatter, figures
    python workflows/validate.py --docs            # runs nothing: the page and its figures from the tables

A row for each impact of each run goes into docs/tables/validation.csv (cases), validation_trends.csv and validation_scatter.csv. Rows
in the tables are not computed again. Runs whose fields the figures show are kept in runs/validation. `validation_page.py` writes the
page from the tables and from paper_values.toml, `validation_figures.py` draws. Nothing is fitted.
"""

from collections.abc import Iterable, Iterator

import numpy as np
import validation_figures as figures
import validation_page as page
from numpy.typing import NDArray
from pages import computed, options, scene_file
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.stats import norm, qmc
from study_table import DOCS, reason, study, write_table

from coupler import Result, Scene
from coupler.errors import ColdsprayError
from coupler.impact.exchange import Impact

RUNS = DOCS.parent / "runs" / "validation"
CASES = {"A": "single_ni", "B": "single_ti", "C": "double_ni_ti", "D": "triple_ni"}
TABLE_OF = {"trends": "validation_trends", "shapes": "validation_trends", "scatter": "validation_scatter"}
SHAPES = ("sphere", "hollow_sphere", "oblate", "angular", "rod", "flake")
# Impact velocities (m/s) of cases A and B: lowest, mean and highest of the measured spread.
SPREAD = {"A": (413, 483, 553), "B": (398, 459, 520)}
DIAMETERS, VELOCITIES = (5, 10, 15, 20, 25, 30, 40, 50, 60), (125, 250, 375, 500, 625, 750, 875, 1000, 1125, 1250)
TEMPERATURES = (300, 350, 400, 450, 500, 550, 600)
# Scatter of case D: number of runs beside that of the mean velocities;
# mean and standard deviation of the first velocity (m/s); ratios of the three; largest offset (um)
SAMPLES, FIRST_VELOCITY, RATIOS, OFFSET = 32, (483.0, 70.0), (1.0, 1.04, 1.10), 6.25
STRAINED = 0.2  # plastic strain: the table has the greatest distance from the axis of an element that reaches it
Case = tuple[str, Scene]  # a run: its key in the tables, its scene
# Column -> record with the value (the impact, its own end, its splat at the end of the run), measure, factor from SI.
MEASURES = {
    "diameter_um": ("impact", "diameter_m", 1e6), "speed_m_s": ("impact", "speed_m_s", 1.0), "points": ("impact", "points", 1),
    "elements": ("impact", "elements", 1), "steps": ("impact", "steps", 1), "dt_ps": ("impact", "dt_mean_s", 1e12),
    "drift": ("impact", "energy_drift", 1.0), "flattening_own": ("own", "flattening_ratio", 1.0),
    "flattening_end": ("end", "flattening_ratio", 1.0), "thickness_um_end": ("end", "thickness_m", 1e6),
    "diameter_um_end": ("end", "splat_diameter_m", 1e6), "crater_um": ("own", "crater_depth_m", 1e6),
    "target_T_max": ("own", "target_T_max_K", 1.0), "von_mises_MPa": ("own", "von_mises_max_Pa", 1e-6),
    "target_von_mises_MPa": ("own", "target_von_mises_max_Pa", 1e-6), "target_eps_p_max": ("own", "target_eps_p_max", 1.0),
    "plastic_radius_um": ("own", "plastic_radius_m", 1e6), "eps_p_mean": ("own", "eps_p_mean", 1.0),
    "eps_p_max": ("own", "eps_p_max", 1.0), "T_p99": ("own", "T_p99_K", 1.0), "T_max": ("own", "T_max_K", 1.0),
}  # fmt: skip


def cases() -> Iterator[Case]:
    """Cases A to D at the preset of the page."""
    yield from ((letter, scene_file(name, preset="standard")) for letter, name in CASES.items())


def pairs() -> Iterator[Case]:
    """Two nickel particles of 25 um, one onto the other, and single ones that stay, for 150 ns: figures 6 and 8 to 10 of the paper."""
    stays = {"kind": "tied", "criterion": "plastic_strain", "threshold": 0.01}
    for v, T in page.PAPER["double_Ni"]["impacts"]:
        name, new = f"{v:.0f}-{T:.0f}K", {"velocity": f"{v:.0f} m/s", "temperature": f"{T:.0f} K"}
        both, end = {"material": "Ni", "diameter": "25 um", **new}, {"at": None, "time": "150 ns"}
        yield f"Ni-Ni-{name}", scene_file("double_ni_ti", preset="standard", particle=both)
        yield f"Ni-{name}", scene_file("single_ni", preset="standard", particle=new, adhesion=stays, end=end)


def scatter() -> Iterator[Case]:
    """Case D over velocities and misalignments of an experiment, coarse. The first run has the mean velocities and no misalignment."""
    mean, spread = FIRST_VELOCITY
    points = qmc.Sobol(4, rng=1).random(SAMPLES)
    samples = [(mean, (0.0, 0.0), (0.0, 0.0))]
    for u in points:
        first = mean + spread * norm.ppf(norm.cdf(-2) + u[0] * (norm.cdf(2) - norm.cdf(-2)))
        second, third = OFFSET * np.sqrt(u[1]), OFFSET * np.sqrt(u[2])  # uniform over the disc
        angle = 2 * np.pi * u[3]  # of the third to the second
        samples.append((first, (second, 0.0), (third * np.cos(angle), third * np.sin(angle))))
    for k, (first, *places) in enumerate(samples):
        particles = [
            {"velocity": f"{first * ratio:.1f} m/s", "offset": [f"{x:.3f} um", f"{y:.3f} um"]}
            for ratio, (x, y) in zip(RATIOS, [(0.0, 0.0), *places], strict=True)
        ]
        yield f"D-scatter-{k}", scene_file("triple_ni", preset="draft", particle=particles)


def spread() -> Iterator[Case]:
    """Cases A and B at the ends and the mean of the measured impact velocities, and A on steel without its rate term, coarse."""
    yield "no-rate", scene_file(CASES["A"], preset="draft", materials={"SS304": {"C": 0.0}})
    for letter, speeds in SPREAD.items():
        for v in speeds:
            yield f"{letter}-{v}", scene_file(CASES[letter], preset="draft", particle={"velocity": f"{v} m/s"})


def trends() -> Iterator[Case]:
    """Single nickel particles over diameter, velocity and temperature."""
    grid = {(d, v, T) for d in DIAMETERS for v, T in ((500, 300), (1000, 300), (500, 600))}
    grid |= {(25, v, 300) for v in VELOCITIES} | {(25, 500, T) for T in TEMPERATURES}
    for d, v, T in sorted(grid):
        particle = {"diameter": f"{d} um", "velocity": f"{v} m/s", "temperature": f"{T} K"}
        # the cylinder of the other runs, 200 x 100 um, is too small for the largest: `check` says so
        size = {"diameter": f"{8 * d} um", "height": f"{4 * d} um"} if d > 50 else {}
        yield f"{d}um-{v}-{T}K", scene_file("single_ni", preset="draft", particle=particle, substrate=size)


def shapes() -> Iterator[Case]:
    """Three impacts of each of the six shapes."""
    for name in SHAPES:
        yield f"shape-{name}", scene_file("morphology", preset="draft", particle={"shape": name})


def widest(points: NDArray) -> float:
    """Largest distance of two points seen from above, m. points (n,3) m."""
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    return float(pdist(outline).max())


def rows_of(name: str, scene: Scene, result: Result) -> list[dict[str, object]]:
    """Rows of the table, one for each impact of a finished run."""
    rows, impacts, target = [], result.impacts, result.fields(-1, "target")
    widths = {len(impacts): widest(result.fields(-1, "surface").points)}  # of splats that have joined the target, too
    for k in np.unique(target.data["impact"][target.data["impact"] > 0]):
        widths.setdefault(int(k), widest(target.points[np.unique(target.cells[target.data["impact"] == k])]))
    strained = target.points[target.cells].mean(axis=1)[target.data["eps_p"] >= STRAINED]
    for k, impact in enumerate(impacts, 1):
        end = impact["end"]
        records = {"impact": impact, "own": end, "end": impact.get("at_end", end)}
        rows.append({
            "run": name, "impact": k, "engine": scene.resolution.engine, "material": impact["material"],
            "temperature_K": scene.particles[0].temperature,
            **{name: of[key] * by for name, (block, key, by) in MEASURES.items() if (of := records[block]) is not None},
            "widest_um_end": widths[k] * 1e6 if k in widths else "",
            "strained_radius_um": float(np.hypot(*strained[:, :2].T).max(initial=0.0)) * 1e6,
        })  # fmt: skip
    return rows


def contact_pressure(force: float, touching: np.ndarray) -> tuple[float, float]:
    """Mean pressure (Pa) and area (m2) of a contact: the force (N) along z over the area that the touching points fill, seen along z.

    touching (k,3): positions in m of the points in contact, two or more rings of them. The area is that of their convex hull, because
    a round contact has no holes. For fewer than three points, or points in a line, pressure and area are 0.
    """
    flat = touching[:, :2]
    if len(flat) < 3 or np.linalg.matrix_rank(flat - flat[0], tol=1e-12) < 2:
        return 0.0, 0.0
    area = float(ConvexHull(flat).volume)
    return force / area, area


class PressureProbe:
    """The mean contact pressure (Pa) at the greatest force of an impact so far (N)."""

    def __init__(self) -> None:
        self.force = self.pressure = 0.0

    def __call__(self, impact: Impact) -> None:
        force = float(impact.force[2])
        if force > self.force:
            touching = impact.surface.contacts(impact.particle.x)[impact.contact.depth > 0]
            self.force, self.pressure = force, contact_pressure(force, touching)[0]


def fill(name: str, cases: Iterable[Case], keep: bool = False) -> None:
    """Compute the runs that a table lacks. keep: also runs that are not in the folder RUNS, where they are then kept."""
    table = study(name, ("run", "impact"), remake="make validate")
    for run, scene in cases:
        folder = RUNS / run if keep else None
        if (run, "1") in table and (folder is None or (folder / "summary.json").is_file()):
            continue
        try:
            probe = PressureProbe()
            with computed(scene, folder, probe=probe) as (result, cpu):
                more = {"contact_pressure_MPa": "", "run_cpu_s": cpu, "failed": ""}
                rows = [row | more for row in rows_of(run, scene, result)]
            rows[-1]["contact_pressure_MPa"] = probe.pressure / 1e6
        except ColdsprayError as problem:
            T = scene.particles[0].temperature
            rows = [{"run": run, "impact": 1, "temperature_K": T, "failed": reason(problem)}]
        shown = ("run", "impact", "flattening_own", "flattening_end", "run_cpu_s", "failed")
        for row in rows:
            new = table.add(row)
            print({column: new[column] for column in shown}, flush=True)


def draw_runs() -> None:
    """Draw the figures that need the fields of cases and pairs."""
    runs = {name: Result(RUNS / name) for name, _ in (*cases(), *pairs())}
    singles = {"A": runs["A"], **{name: runs[f"Ni-{name}"] for name in figures.COLOURS}}
    rows = [row for name, result in singles.items() for row in figures.axis_rows(name, result)]
    write_table(figures.AXIS, rows, "remake: make validate\nat: ns over time, um over depth; SI else")
    figures.draw_cases({words: runs[words[0]] for words in ("A: Ni", "B: Ti", "C: Ni, Ti", "D: Ni, Ni, Ni")})
    figures.draw_pairs({name: runs[f"Ni-Ni-{name}"] for name in figures.COLOURS})


if __name__ == "__main__":
    parts = {"cases": cases, "pairs": pairs, "spread": spread, "trends": trends, "shapes": shapes, "scatter": scatter}
    a = options(__doc__, "docs", only=[*parts, "figures"])
    for part in () if a.docs else a.only:
        if part == "figures":
            draw_runs()
        else:
            fill(TABLE_OF.get(part, "validation"), parts[part](), keep=part in ("cases", "pairs"))
    figures.draw_trends()
    page.write_page()

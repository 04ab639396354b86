"""The cases and trends of the paper whose method this follows, computed, tabled and set beside its numbers.

    python workflows/validate.py                   # what is not in the tables yet, then the page
    python workflows/validate.py --only cases      # of: cases, pairs, spread, trends, shapes, scatter, figures
    python workflows/validate.py --docs            # runs nothing: the page and its figures of the tables

A row for each impact of each run goes into docs/tables/validation.csv (cases), validation_trends.csv and validation_scatter.csv; rows
in the tables are not computed again, nor are those whose fields the figures show, in runs/validation. `validation_page.py` writes the
page from the tables and from paper_values.toml, `validation_figures.py` draws. Nothing is fitted.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import validation_figures as figures
import validation_page as page
from numpy.typing import NDArray
from pages import TABLES, computed, options, reason, study, write_table
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.stats import norm, qmc

from coupler import Result, Scene
from coupler.errors import ColdsprayError
from coupler.impact.exchange import Impact

HERE = Path(__file__).parent
RUNS = HERE.parent / "runs" / "validation"
CASES = {"A": "single_ni", "B": "single_ti", "C": "double_ni_ti", "D": "triple_ni"}
TABLE_OF = {"trends": "validation_trends", "shapes": "validation_trends", "scatter": "validation_scatter"}
SHAPES = ("sphere", "hollow_sphere", "oblate", "angular", "rod", "flake")
# What the measured spread of impact velocities makes of cases A and B (m/s).
SPREAD = {"A": (413, 483, 553), "B": (398, 459, 520)}
DIAMETERS, VELOCITIES = (5, 10, 15, 20, 25, 30, 40, 50, 60), (125, 250, 375, 500, 625, 750, 875, 1000, 1125, 1250)
TEMPERATURES = (300, 350, 400, 450, 500, 550, 600)
# Scatter of case D: number of runs; mean and standard deviation of the first velocity (m/s); ratios of the three; largest offset (um)
SAMPLES, FIRST_VELOCITY, RATIOS, OFFSET = 32, (483.0, 70.0), (1.0, 1.04, 1.10), 6.25
# Column: record that it is from (the impact, its own end, its splat at the end of the run), measure, factor from SI.
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


@dataclass(frozen=True)
class Case:
    """One run. name: its key in the tables; start: temperature of the particle, K."""

    name: str
    scene: Scene
    start: float = 300.0


def scene_of(workflow: str, preset: str = "standard", **tables: object) -> Scene:
    """A scene of this folder at a preset, with changes of its tables."""
    return Scene.load(HERE / f"{workflow}.toml").with_(preset=preset, **tables)


def cases() -> Iterator[Case]:
    """Cases A to D at the preset of the page."""
    yield from (Case(letter, scene_of(name)) for letter, name in CASES.items())


def pairs() -> Iterator[Case]:
    """Two nickel particles of 25 um, one onto the other, and single ones that stay, for 150 ns: figures 6 and 8 to 10 of the paper."""
    stays = {"kind": "tied", "criterion": "plastic_strain", "threshold": 0.01}
    for v, T in page.PAPER["double_Ni"]["impacts"]:
        name, new = f"{v:.0f}-{T:.0f}K", {"velocity": f"{v:.0f} m/s", "temperature": f"{T:.0f} K"}
        yield Case(
            f"Ni-Ni-{name}", scene_of("double_ni_ti", particle={"material": "Ni", "diameter": "25 um", **new}), T
        )
        alone = scene_of("single_ni", particle=new, adhesion=stays, end={"at": None, "time": "150 ns"})
        yield Case(f"Ni-{name}", alone, T)


def scatter() -> Iterator[Case]:
    """Case D over velocities and misalignments of an experiment, coarse; the first run has the velocities alone."""
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
        yield Case(f"D-scatter-{k}", scene_of("triple_ni", "draft", particle=particles))


def spread() -> Iterator[Case]:
    """Cases A and B at the ends and the mean of the measured impact velocities, and A on steel without its rate term, coarse."""
    yield Case("no-rate", scene_of(CASES["A"], "draft", materials={"SS304": {"C": 0.0}}))
    for letter, speeds in SPREAD.items():
        for v in speeds:
            yield Case(f"{letter}-{v}", scene_of(CASES[letter], "draft", particle={"velocity": f"{v} m/s"}))


def trends() -> Iterator[Case]:
    """Single nickel particles over diameter, velocity and temperature."""
    grid = {(d, v, T) for d in DIAMETERS for v, T in ((500, 300), (1000, 300), (500, 600))}
    grid |= {(25, v, 300) for v in VELOCITIES} | {(25, 500, T) for T in TEMPERATURES}
    for d, v, T in sorted(grid):
        particle = {"diameter": f"{d} um", "velocity": f"{v} m/s", "temperature": f"{T} K"}
        # the cylinder of the other runs, 200 x 100 um, is too small for the largest: `check` says so
        size = {"diameter": f"{8 * d} um", "height": f"{4 * d} um"} if d > 50 else {}
        yield Case(f"{d}um-{v}-{T}K", scene_of("single_ni", "draft", particle=particle, substrate=size), T)


def shapes() -> Iterator[Case]:
    """Three impacts of each of the six shapes."""
    yield from (Case(f"shape-{name}", scene_of("morphology", "draft", particle={"shape": name})) for name in SHAPES)


def widest(points: NDArray) -> float:
    """Largest distance of two points seen from above, m. points (n,3) m."""
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    return float(pdist(outline).max())


def widths_of(result: Result) -> dict[int, float]:
    """Largest diameter (m) of each splat that has joined the target, by the number of its impact, from 1."""
    f = result.fields(-1, "target")
    impact = f.data["impact"]
    return {int(k): widest(f.points[np.unique(f.cells[impact == k])]) for k in np.unique(impact[impact > 0])}


def strained_radius(result: Result, least: float = 0.2) -> float:
    """Largest distance (m) from the axis at which an element of the target has a plastic strain of `least`."""
    f = result.fields(-1, "target")
    middle = f.points[f.cells].mean(axis=1)[f.data["eps_p"] >= least]
    return float(np.hypot(middle[:, 0], middle[:, 1]).max()) if len(middle) else 0.0


def rows_of(case: Case, result: Result) -> list[dict[str, object]]:
    """Rows of the table, one for each impact of a finished run."""
    rows, impacts = [], result.impacts
    widths = widths_of(result) | {len(impacts): widest(result.fields(-1, "surface").points)}
    radius = strained_radius(result) * 1e6
    for k, impact in enumerate(impacts, 1):
        end = impact["end"]
        records = {"impact": impact, "own": end, "end": impact.get("at_end", end)}
        row: dict[str, object] = {
            "run": case.name, "impact": k, "engine": case.scene.resolution.engine, "material": impact["material"],
            "temperature_K": case.start,
        }  # fmt: skip
        row |= {
            name: record[key] * by for name, (of, key, by) in MEASURES.items() if (record := records[of]) is not None
        }
        row |= {"widest_um_end": widths[k] * 1e6 if k in widths else "", "strained_radius_um": radius}
        rows.append(row)
    return rows


def contact_pressure(force: float, touching: np.ndarray) -> tuple[float, float]:
    """Mean pressure (Pa) and area (m2) of a contact: the force (N) along z over the area that the touching points fill, seen along z.

    touching (k,3): positions in m of the points in contact, two or more rings of them; their convex hull is taken, as a round
    contact has no holes. Fewer than three points, or points in a line, fill no area: both are 0 then.
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
    """Compute the runs that a table lacks, or RUNS where they are kept."""
    table = study(name, ("run", "impact"), "make validate")
    for case in cases:
        folder = RUNS / case.name if keep else None
        if (case.name, "1") in table and (folder is None or (folder / "summary.json").is_file()):
            continue
        try:
            probe = PressureProbe()
            with computed(case.scene, folder, probe=probe) as (result, cpu):
                rows = [
                    {**row, "contact_pressure_MPa": "", "run_cpu_s": cpu, "failed": ""} for row in rows_of(case, result)
                ]
            rows[-1]["contact_pressure_MPa"] = probe.pressure / 1e6
        except ColdsprayError as problem:
            rows = [{"run": case.name, "impact": 1, "temperature_K": case.start, "failed": reason(problem)}]
        shown = ("run", "impact", "flattening_own", "flattening_end", "run_cpu_s", "failed")
        for row in rows:
            new = table.add(row)
            print({column: new[column] for column in shown}, flush=True)


def draw_runs() -> None:
    """Draw the figures that need the fields of cases and pairs."""
    runs = {case.name: Result(RUNS / case.name) for case in (*cases(), *pairs())}
    singles = {"A": runs["A"], **{name: runs[f"Ni-{name}"] for name in figures.COLOURS}}
    rows = [row for name, result in singles.items() for row in figures.axis_rows(name, result)]
    write_table(TABLES / f"{figures.AXIS}.csv", rows, "remake: make validate\nat: ns over time, um over depth; SI else")
    figures.draw_cases({words: runs[words[0]] for words in ("A: Ni", "B: Ti", "C: Ni, Ti", "D: Ni, Ni, Ni")})
    figures.draw_pairs({name: runs[f"Ni-Ni-{name}"] for name in figures.COLOURS})


def main() -> None:
    """Fill the tables, draw the figures, write the page."""
    parts = {"cases": cases, "pairs": pairs, "spread": spread, "trends": trends, "shapes": shapes, "scatter": scatter}
    a = options(__doc__, "docs", only=[*parts, "figures"])
    for part in () if a.docs else a.only:
        if part == "figures":
            draw_runs()
        else:
            fill(TABLE_OF.get(part, "validation"), parts[part](), keep=part in ("cases", "pairs"))
    figures.draw_trends()
    page.write_page()


if __name__ == "__main__":
    main()

"""A run that was never computed: a splat in a crater, with fields and a ledger that are known."""

from pathlib import Path
from typing import Any

import numpy as np

from coupler.errors import SceneError
from coupler.files.store import Store
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text

UM = 1e-6
SCENE = """name = "made_up"
preset = "standard"
effects = "auto"
[particle]
material = "Ni"
diameter = "25 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
"""
PEAK, END = 30e-9, 40e-9  # s


def block(half: float, depth: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A box below z = 0 in tetrahedra, six for each cube, finer towards the middle."""
    n, m = round(2 * half / step), round(depth / step)
    side = np.linspace(-1, 1, n + 1)
    side = half * np.sign(side) * np.abs(side) ** 1.4
    down = -depth * np.linspace(0, 1, m + 1) ** 1.4
    points = np.stack(np.meshgrid(side, side + 0.3 * step, down, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.arange((n + 1) ** 2 * (m + 1)).reshape(n + 1, n + 1, m + 1)
    unit = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
    cube = np.stack([corner[i : n + i, j : n + j, k : m + k].ravel() for i, j, k in unit], axis=1)
    ways = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    return points, cube[:, ways].reshape(-1, 4)


def ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on a unit sphere and their triangles, turning outwards."""
    from scipy.spatial import ConvexHull

    number = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * number / count), np.pi * (1 + 5**0.5) * number
    points = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    triangles = ConvexHull(points).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles


def flattened(points: np.ndarray, amount: float) -> np.ndarray:
    """A sphere of 25 um at the surface, pressed into a splat with its lower side in the crater."""
    radius = np.hypot(points[:, 0], points[:, 1])
    spread = 12.5 * (1 + 0.35 * amount * (1 - points[:, 2]) / 2)
    z = 12.8 + 12.5 * points[:, 2]
    height = np.abs(points[:, 2])
    x = np.hypot(points[:, 0] * spread, points[:, 1] * spread)
    lower = pressed(x) * np.clip(height / 0.3, 0, 1) ** 0.5
    splat = np.where(points[:, 2] > 0, 11 * height**0.8 * (1 - 0.1 * radius**2), lower)
    return np.column_stack([points[:, 0] * spread, points[:, 1] * spread, z + amount * (splat - z)]) * UM


def pressed(r: np.ndarray) -> np.ndarray:
    """Depth of the crater and its raised rim, um."""
    return -5 * np.exp(-((r / 14) ** 4)) + 1.2 * np.exp(-(((r - 20) / 3.5) ** 2))


def crater(points: np.ndarray, amount: float) -> np.ndarray:
    moved = points.copy()
    moved[:, 2] += amount * pressed(np.hypot(points[:, 0], points[:, 1])) * np.exp(points[:, 2] / 15)
    return moved * UM


def skin(count: int, amount: float) -> tuple[np.ndarray, np.ndarray]:
    """The splat's surface, m, and its triangles."""
    points, triangles = ball(count)
    return flattened(points, amount), triangles


def write(
    folder: Path,
    steps: int = 2,
    points: int = 8000,
    edge: float = 3.0,
    scene: str = SCENE,
    summary: dict[str, Any] | None = None,
    **history: float,
) -> Path:
    """Write a run of some steps, 0 to END; unfinished without a summary. history: further columns, J at the end."""
    rng = np.random.default_rng(0)
    inside = rng.uniform(-1, 1, (points, 3))
    inside = inside[(inside**2).sum(1) < 0.95]
    soil, tets = block(60, 50, edge)
    noise = rng.normal(size=len(tets))
    try:
        planned = plan_text(plan(Scene.from_text(scene)))
    except SceneError:
        planned = ""
    with Store.create(folder, scene, plan_json=planned) as store:
        for amount in np.linspace(0, 1, steps):
            time = amount * END
            heat = amount * np.exp(-(((inside[:, 2] + 0.9) / 0.6) ** 2)) * (0.4 + (inside[:, :2] ** 2).sum(1))
            stress = np.outer(300e6 * amount * (1 + inside[:, 2]), [1.0, 1.0, -0.5, 0.0, 0.0, 0.0])
            data = {"T": 300 + 160 * heat, "eps_p": 0.25 * amount + 1.1 * heat, "stress": stress}
            data["von_mises"] = 450e6 * amount * (1 + inside[:, 2])
            store.write("particle", time, flattened(inside, amount), np.arange(len(inside))[:, None], data)
            store.write("surface", time, *skin(1500, amount))
            middle = soil[tets].mean(1)
            far = np.hypot(np.hypot(middle[:, 0], middle[:, 1]) / 14, (middle[:, 2] + 2) / 9)
            strain = amount * 0.7 * np.exp(-(far**2)) * (1 + 0.1 * noise)
            stress = np.outer(800e6 * strain, [-1.0, -1.0, 0.2, 0.0, 0.0, 0.0])
            data = {"T": 300 + 130 * strain, "eps_p": strain, "von_mises": 960e6 * strain, "stress": stress}
            store.write("target", time, crater(soil, amount), tets, {}, data)
        for amount in np.linspace(0, 1, 41):
            store.record(row(amount, **history))
        if summary is not None:
            store.finish(summary)
    return folder


def row(amount: float, **further: float) -> dict[str, float]:
    """A line of the history: of 10 uJ nine tenths become plastic work, the rest stays, and 0.1 % is lost."""
    lost = -1e-3 * amount
    ledger = {
        "kinetic_particle": 10e-6 * (1 - 0.95 * amount + lost) - amount * sum(further.values()),
        "kinetic_target": 0.05e-6 * amount, "elastic_particle": -0.02e-6 * amount, "elastic_target": 0.07e-6 * amount,
        "plastic_particle": 4e-6 * amount, "plastic_target": 5e-6 * amount, "numerical_particle": 0.3e-6 * amount,
        "numerical_target": 0.05e-6 * amount, "contact": 0.0, "friction": 0.05e-6 * amount, "boundary": 0.0,
    }  # fmt: skip
    ledger |= {name: amount * value for name, value in further.items()}
    kinetic = ledger["kinetic_particle"] + ledger["kinetic_target"]
    shape = {"height": (25 - 14 * amount) * UM, "thickness": (25 - 9 * amount) * UM, "crater_depth": 5 * amount * UM}
    motion = {"velocity_z": -500 + 530 * amount, "contact_force": amount * (1 - amount), "T_max": 300 + 300 * amount}
    return {
        "time": amount * END,
        "dt": 30e-12,
        "step": 1000 * amount,
        **ledger,
        "kinetic": kinetic,
        "drift": lost,
        **shape,
        **motion,
    }


def summary_of(*impacts: dict[str, Any], **run: Any) -> dict[str, Any]:
    """A summary of these records of impacts, with the tables that they lack, and these values of the run."""
    whole = {"greatest": None, "end": {}, "refused": {}, "errors": {}, "undecided": None}
    return {
        "format": 2, "version": "0.3.0", "run": {"warnings": [], "retries": [], "undecided": None, **run},
        "impacts": [whole | impact for impact in impacts], "joins": [],
    }  # fmt: skip


def summary(run: dict[str, Any] | None = None, end: dict[str, Any] | None = None, **impact: Any) -> dict[str, Any]:
    """A summary of one impact in the words of a real one, with further values of the run, of the impact and of its end."""
    peak = {"time_s": PEAK, "flattening_ratio": 0.551, "crater_depth_m": 5.3e-6, "T_max_K": 560.0}
    last = {"time_s": END, "flattening_ratio": 0.5561, "crater_depth_m": 5.02e-6, "T_max_K": 612.0, "T_p99_K": 580.0}
    own = {
        "rebounded": False, "energy_drift": -1e-3, "points": 4012, "elements": 9000, "spacing_m": 1.2e-6, "steps": 1000,
        "dt_limited_by": {"particle": 900, "target": 100, "contact": 0}, "kinetic_energy_0_J": 10e-6, "greatest": peak,
        "end": last | (end or {}),
    }  # fmt: skip
    whole = {
        "element_size_m": 2e-6, "steps": 1000, "sim_time_s": END, "wall_s": 25.0, "wall_loop_s": 20.0,
        "effects": ["thermal_softening", "rate_hardening", "plastic_heating", "temperature_dependent_cp", "friction",
                    "mie_gruneisen", "absorbing_boundaries"],
        "warnings": ["strain rates beyond the fit"],
    }  # fmt: skip
    return summary_of(own | impact, **(whole | (run or {})))

"""The clouds of `splat_battery`: those of real impacts, and hard synthetic ones."""

import json
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from pages import computed, spacing_of
from scipy.spatial import cKDTree
from study_table import measurements

from coupler import Scene
from coupler.deposition.joining import cloud_of
from coupler.impact.exchange import Impact
from coupler.impact.folding import whole_surface
from coupler.particle import packing, shapes
from coupler.particle.carried_surface import CarriedSurface
from coupler.physics.materials import material
from coupler.splat.cloud import Cloud

D = 25e-6
Map = Callable[[np.ndarray], np.ndarray]
Made = dict[str, Any]  # arrays and numbers of a cloud, by the names of `Cloud`


def particle(metal: str, velocity: float, **more: object) -> str:
    """The table of one particle of a scene, as JSON. Its diameter is 25 um, or 30 um for Ti. velocity m/s; more: further keys."""
    diameter = "30 um" if metal == "Ti" else "25 um"
    return json.dumps({"material": metal, "diameter": diameter, "velocity": f"{velocity:g} m/s", **more})


@cache
def played(particles: tuple[str, ...], base: str, spacing: float) -> list[tuple[Cloud, Cloud]]:
    """The clouds of a run's impacts, in their order: of greatest deformation and of the end. spacing: um."""
    scene = {
        "particle": [json.loads(table) for table in particles], "resolution": {"spacing": f"{spacing!r} um"}, "end": {"at": "rest"},
        "adhesion": {"kind": "tied" if len(particles) > 1 else "none"}, "substrate": {"material": base},
    }  # fmt: skip
    seen: dict[int, list[Cloud]] = {}

    def watch(now: Impact) -> None:
        if now.sinking <= 0.0:
            cloud = cloud_of(now.domains)
            seen.setdefault(now.bodies.count, [cloud, cloud])[1] = cloud

    with computed(Scene.from_dict(scene, "battery"), probe=watch):
        return [(greatest, end) for greatest, end in seen.values()]


def impact(
    metal: str, velocity: float, points: int = 1000, onto: bool = False, moment: int = 1, **more: object
) -> Callable[[], Cloud]:
    """The cloud of an impact on SS304, at the end (moment 1) or at greatest deformation (0). onto: after a first impact at 500 m/s."""
    diameter = 30.0 if metal == "Ti" else 25.0
    before = (particle(metal, 500.0),) if onto else ()
    particles = (*before, particle(metal, velocity, **more))
    return lambda: played(particles, "SS304", spacing_of(points, diameter))[-1][moment]


def real() -> dict[str, Callable[[], Cloud]]:
    """The impacts by name."""
    return {name: impact(**row) for name, row in measurements("impact_clouds", "scenes").items()}


def splats() -> dict[str, Callable[[], Cloud]]:
    """Thirty splats of runs of 500 points, by name: four metals, oblique, hot, soft on hard, hard on soft, and sequences."""
    clouds: dict[str, Callable[[], Cloud]] = {}
    for name, row in measurements("splat_clouds", "scenes").items():
        particles = tuple(particle(**each) for each in row["particles"])
        run = partial(played, particles, row["base"], spacing_of(500, 30.0 if name.startswith("Ti") else 25.0))
        for i in range(len(particles)):
            label = f"run_{name}" + (f"_{i + 1}_of_{len(particles)}" if len(particles) > 1 else "")
            clouds[label] = lambda run=run, i=i: run()[i][1]  # type: ignore[misc]
    return clouds


def lens(x: np.ndarray) -> np.ndarray:
    """A splat: flattened, widest near its foot, on the floor of a shallow crater."""
    r, z = np.hypot(x[:, 0], x[:, 1]) / (0.5 * D), x[:, 2] / (0.5 * D)
    wide = 1.3 + 0.35 * np.exp(-(((z + 0.6) / 0.4) ** 2))
    return np.stack([x[:, 0] * wide, x[:, 1] * wide, 0.5 * D * (0.55 * z + 0.12 * (wide * r) ** 2)], axis=1)


def lip(x: np.ndarray, out: float = 1.3) -> np.ndarray:
    """A thin rim drawn out of the foot, turned up."""
    y, z = lens(x), x[:, 2] / (0.5 * D)
    r = np.hypot(x[:, 0], x[:, 1]) / (0.5 * D)
    pull = out * np.clip(r - 0.55, 0.0, None) ** 1.5 * np.exp(-(((z + 0.55) / 0.3) ** 2))
    y[:, :2] *= (1.0 + pull)[:, None]
    y[:, 2] += 0.5 * D * 0.9 * pull * r
    return y


def curled(x: np.ndarray) -> np.ndarray:
    """A bar bent until its ends almost touch."""
    radius = 0.62 * float(np.ptp(x[:, 0])) / (2.0 * np.pi) * 1.75
    angle = x[:, 0] / radius
    r = radius + x[:, 2]
    return np.stack([r * np.sin(angle), x[:, 1], r * np.cos(angle)], axis=1)


def starred(x: np.ndarray) -> np.ndarray:
    """Seven jets out of the rim."""
    y, phi = lens(x), np.arctan2(x[:, 1], x[:, 0])
    r = np.hypot(x[:, 0], x[:, 1]) / (0.5 * D)
    y[:, :2] *= (1.0 + 0.9 * np.clip(np.cos(7.0 * phi), 0.0, None) ** 3 * np.clip(r - 0.4, 0.0, None))[:, None]
    return y


def mapped(body: shapes.Body, motion: Map, carried: bool = True) -> Made:
    """A body moved by a smooth map, with analytic fields; J is the volume ratio of the map."""
    x = motion(body.points)
    step = 1e-4 * D
    moved = [motion(body.points + step * e) - motion(body.points - step * e) for e in np.eye(3)]
    J = np.abs(np.linalg.det(np.stack(moved, -1) / (2.0 * step)))
    cloud = filled(x, body.volume, body.spacing) | {"J": J}
    if carried:
        outer = CarriedSurface(body.points, body.vertices, body.triangles, body.spacing)
        surface = whole_surface(body, outer, np.zeros(3))
        cloud["surface"] = surface.positions(x), surface.triangles
    return cloud


def filled(x: np.ndarray, volume: float, spacing: float) -> Made:
    """A cloud at places x (n,3) with smooth fields."""
    n, u = len(x), x / D
    speed = np.stack([20 * u[:, 1], -20 * u[:, 0] + 5 * np.sin(4 * u[:, 2]), 30 + 10 * u[:, 0]], axis=1)
    return {
        "x": x, "volume": np.full(n, volume), "spacing": spacing, "rho": material("Ni").rho, "velocity": speed,
        "wave_speed": material("Ni").wave_speed, "stress": 1e8 * np.stack([np.cos((i + 2) * u[:, i % 3]) for i in range(6)], axis=1),
        "eps_p": np.exp(-2.0 * u[:, 2]), "T": 300.0 + 400.0 * np.exp(-(((u[:, 2] + 0.2) / 0.3) ** 2)),
        "energy": 1e9 * (1.0 + u[:, 0] ** 2),
    }  # fmt: skip


def ball(n: int) -> shapes.Body:
    return shapes.shape("sphere", D, n)


def joined(*parts: Made) -> Made:
    """Several clouds as one, without surfaces."""
    whole = {k: v for k, v in parts[0].items() if k not in ("surface", "J")}
    return {k: np.concatenate([p[k] for p in parts]) if np.ndim(v) else v for k, v in whole.items()}


def pair(n: int, gap: float) -> Made:
    """Two balls whose outermost points are `gap` spacings apart."""
    left = mapped(ball(n), np.copy, carried=False)
    width = float(np.ptp(left["x"][:, 0])) + gap * left["spacing"]
    return joined(left, left | {"x": left["x"] + [width, 0.0, 0.0]})


def shattered(n: int, sizes: tuple[int, ...], seed: int) -> Made:
    """A splat, and fragments apart from it; sizes: number of points of each fragment."""
    rng = np.random.default_rng(seed)
    whole = mapped(ball(n), lens, carried=False)
    parts = [whole]
    for size in sizes:
        points, volume = packing.sphere(whole["spacing"] * (6.0 / np.pi * max(size, 2)) ** (1.0 / 3.0), max(size, 2))
        away = rng.normal(size=3)
        away *= (1.4 + 0.6 * rng.random()) * D / np.linalg.norm(away)
        parts.append(filled(points[:size] + away, volume, whole["spacing"]))
    return joined(*parts)


def dust(n: int, share: float, seed: int) -> Made:
    """A splat, of which a share of the points lies far from it, each point alone."""
    rng = np.random.default_rng(seed)
    cloud = mapped(ball(n), lens, carried=False)
    off = rng.choice(len(cloud["x"]), round(share * n), replace=False)
    away = rng.normal(size=(len(off), 3))
    cloud["x"][off] = away / np.linalg.norm(away, axis=1)[:, None] * D * (1.5 + rng.random((len(off), 1)))
    return {k: v for k, v in cloud.items() if k != "J"}


def ring(n: int) -> Made:
    points, volume = packing.fill(
        lambda x: (np.hypot(x[:, 0], x[:, 1]) - 0.4 * D) ** 2 + x[:, 2] ** 2 < (0.17 * D) ** 2, (0.6 * D, 0.6 * D, 0.2 * D),
        2.0 * np.pi**2 * 0.4 * D * (0.17 * D) ** 2, n,
    )  # fmt: skip
    return filled(points, volume, volume ** (1.0 / 3.0))


def scattered(n: int, seed: int) -> Made:
    """Points without a lattice, at least 0.8 spacings apart; the cloud has positions but no fields."""
    rng = np.random.default_rng(seed)
    spacing = (np.pi / 6.0 * D**3 / n) ** (1.0 / 3.0)
    x = rng.uniform(-0.5 * D, 0.5 * D, (12 * n, 3))
    x = x[np.einsum("ij,ij->i", x, x) < (0.5 * D - 0.4 * spacing) ** 2]
    near = cKDTree(x).query_pairs(0.8 * spacing, output_type="ndarray")
    taken, barred = [], np.zeros(len(x), bool)
    start = np.searchsorted((near := near[np.lexsort(near.T[::-1])])[:, 0], np.arange(len(x) + 1))
    for i in range(len(x)):
        if not barred[i]:
            taken.append(i)
            barred[near[start[i] : start[i + 1], 1]] = True
    x = lens(x[taken])
    return {"x": x, "volume": np.full(len(x), 0.715 * np.pi / 6.0 * D**3 / len(x)), "spacing": spacing, "rho": 8906.0}


def curved_layer(n: int) -> Made:
    """One layer of points on half a sphere."""
    i = np.arange(2 * n) + 0.5
    z, phi = 1.0 - i / n, np.pi * (1.0 + 5.0**0.5) * i
    x = 0.5 * D * np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=1)[z > 0.0]
    spacing = float(np.sqrt(2.0 * np.pi * (0.5 * D) ** 2 / len(x)))
    return filled(x, spacing**3, spacing)


def synthetic() -> dict[str, Callable[[], Made]]:
    """The synthetic clouds by name."""
    clouds: dict[str, Callable[[], Made]] = {}

    def add(name: str, body: Callable[[], shapes.Body], motion: Map, ways: tuple[bool, ...] = (True,)) -> None:
        for carried in ways:  # with its surface, or its points only
            label = name if carried else f"{name}_points_only"
            clouds[label] = lambda carried=carried: mapped(body(), motion, carried)  # type: ignore[misc]

    for n in (500, 2000, 20000, 89094):
        add(f"lens_{n}", partial(ball, n), lens, (True, False))
    for n in (2000, 20000):
        add(f"lip_{n}", partial(ball, n), lip, (True, False))
    add("long_lip_5000", partial(ball, 5000), partial(lip, out=2.6))
    add("star_5000", partial(ball, 5000), starred)
    add("star_1000", partial(ball, 1000), starred, (False,))
    for shape in ("hollow_sphere", "oblate", "rod", "flake", "angular"):
        add(f"{shape}_3000", partial(shapes.shape, shape, D, 3000), np.copy)
    add("hollow_lens_3000", partial(shapes.shape, "hollow_sphere", D, 3000), lens, (True, False))
    add("curled_rod_3000", partial(shapes.shape, "rod", D, 3000), curled, (True, False))
    add("sheet_2000", partial(ball, 2000), lambda x: x * [2.6, 2.6, 1 / 6.76])
    for gap in (0.6, 1.0, 2.0, 6.0):
        clouds[f"two_balls_gap_{gap:g}"] = partial(pair, 1500, gap)
    clouds["fragments"] = partial(shattered, 3000, (400, 120, 60, 30, 12, 5, 1), 1)
    clouds["dust_1_percent"] = partial(dust, 5000, 0.01, 2)
    clouds["ring_3000"] = partial(ring, 3000)
    clouds["no_lattice_3000"] = partial(scattered, 3000, 3)
    clouds["curved_layer_1500"] = partial(curved_layer, 1500)
    return clouds


def every() -> dict[str, tuple[str, Callable[[], Cloud]]]:
    """All clouds by name, each with its kind: "impact" or "synthetic", the 71 of the battery, or "splat" of a run."""
    made = {name: lambda make=make: Cloud(**make()) for name, make in synthetic().items()}
    kinds: dict[str, dict[str, Callable[[], Cloud]]] = {"impact": real(), "synthetic": made, "splat": splats()}
    return {name: (kind, make) for kind, clouds in kinds.items() for name, make in clouds.items()}

"""State from points to a mesh: exact sums, analytic fields, and no values out of nowhere."""

from dataclasses import replace

import numpy as np
import pytest

from coupler.geometry.tetrahedra import volumes
from coupler.particle import packing
from coupler.physics.materials import material
from coupler.splat.cloud import Cloud
from coupler.splat.convert import convert
from coupler.splat.transfer import Fit, transfer, with_energy, with_momentum, with_sum

D = 25e-6


def squeezed(points: int) -> tuple[np.ndarray, float, float]:
    """Points of a ball squeezed to a lens at equal volume, the volume of each, and the spacing."""
    x, volume = packing.sphere(D, points)
    return x * [1.4, 1.35, 1 / (1.4 * 1.35)], volume, volume ** (1 / 3)


@pytest.fixture(scope="module")
def mesh() -> tuple[Cloud, np.ndarray, np.ndarray]:
    x, volume, dx = squeezed(5000)
    n, u = len(x), x / D
    cloud = Cloud(
        x, np.full(n, volume), dx, 8906.0, velocity=speed(u), stress=1e8 * tension(u), eps_p=strain(u), T=heat(u),
        J=1.0 + 0.02 * np.sin(3 * u[:, 0]), energy=1e9 * (1 + u[:, 2] ** 2),
    )  # fmt: skip
    (body,) = convert(cloud, 1.7 * dx, "density").bodies
    return cloud, body.points, body.tets


def speed(u: np.ndarray) -> np.ndarray:
    return np.stack([30 * np.sin(4 * u[:, 0]) + 5 * u[:, 1], 40 * u[:, 1] * u[:, 2] + 10, -40 * u[:, 2]], axis=1)


def heat(u: np.ndarray) -> np.ndarray:
    return 300.0 + 500.0 * np.exp(-(((u[:, 2] + 0.25) / 0.2) ** 2)) * (1.0 + 0.3 * u[:, 0])


def strain(u: np.ndarray) -> np.ndarray:
    return 2.0 * np.exp(-(u[:, 2] + 0.3) / 0.2) * np.exp(-(u[:, 0] ** 2 + u[:, 1] ** 2) / 0.3)


def tension(u: np.ndarray) -> np.ndarray:
    return np.stack([np.cos((i + 1) * u[:, i % 3] + i) for i in range(6)], axis=1)


def off(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.sum((a - b) ** 2) / np.sum(b**2)))


def test_analytic_fields_come_over_within_three_per_cent(mesh) -> None:
    cloud, points, tets = mesh
    made, _ = transfer(cloud, points, tets)
    at_elements, at_nodes = points[tets].mean(axis=1) / D, points / D
    assert off(made["velocity"], speed(at_nodes)) < 0.03
    assert off(made["stress"], 1e8 * tension(at_elements)) < 0.03
    assert off(made["T"] - 300.0, heat(at_elements) - 300.0) < 0.03
    assert off(made["eps_p"], strain(at_elements)) < 0.03
    assert off(made["energy"], 1e9 * (1 + at_nodes[:, 2] ** 2)) < 0.03


def test_no_temperature_falls_below_the_coldest_point(mesh) -> None:
    """A hot layer on cold metal: neither the overshoot of the fit nor the shift that keeps the heat cools the rest."""
    cloud, points, tets = mesh
    cloud = replace(cloud, T=np.where(cloud.x[:, 2] < np.median(cloud.x[:, 2]), 900.0, 300.0))
    made, errors = transfer(cloud, points, tets)
    assert made["T"].min() >= 300.0
    assert abs(errors["T"]) < 1e-12


def masses(cloud: Cloud, points: np.ndarray, tets: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Of the elements, those of the points in all."""
    reference = volumes(points, tets) / J
    return cloud.mass.sum() * reference / reference.sum()


def test_momenta_are_exact(mesh) -> None:
    cloud, points, tets = mesh
    made, _ = transfer(cloud, points, tets)
    element = masses(cloud, points, tets, made["J"])
    node = np.bincount(tets.ravel(), np.repeat(element / 4, 4), len(points))
    P, L = cloud.mass @ cloud.velocity, cloud.mass @ np.cross(cloud.x, cloud.velocity)
    assert np.linalg.norm(node @ made["velocity"] - P) < 1e-12 * np.linalg.norm(P)
    assert np.linalg.norm(node @ np.cross(points, made["velocity"]) - L) < 1e-12 * np.linalg.norm(L)
    kinetic = 0.5 * cloud.mass @ np.sum(cloud.velocity**2, axis=1)
    assert 0.5 * node @ np.sum(made["velocity"] ** 2, axis=1) == pytest.approx(kinetic, rel=1e-9)


def test_heat_strain_and_energy_keep_their_sums_and_strain_is_never_negative(mesh) -> None:
    cloud, points, tets = mesh
    made, _ = transfer(cloud, points, tets)
    element = masses(cloud, points, tets, made["J"])
    nickel = material("Ni")
    heat_of = lambda m, T: float(m @ np.array([nickel.cp_at(float(t)) * t for t in T]))  # noqa: E731
    assert heat_of(element, made["T"]) == pytest.approx(heat_of(cloud.mass, cloud.T), rel=5e-3)
    assert element @ made["T"] == pytest.approx(cloud.mass @ cloud.T, rel=1e-12)
    assert element @ made["eps_p"] == pytest.approx(cloud.mass @ cloud.eps_p, rel=1e-12)
    assert made["eps_p"].min() >= 0.0
    reference = np.bincount(tets.ravel(), np.repeat(element / cloud.rho / 4, 4), len(points))
    assert reference @ made["energy"] == pytest.approx(cloud.volume @ cloud.energy, rel=1e-12)


def test_a_linear_field_comes_over_as_it_is_inside_and_at_the_surface(mesh) -> None:
    cloud, points, _ = mesh
    line = lambda x: 3.0 + x @ [2.0, -1.0, 4.0] / D  # noqa: E731
    assert Fit(cloud.x, points, cloud.spacing)(line(cloud.x)) == pytest.approx(line(points), rel=2e-3)
    assert Fit(cloud.x, points, cloud.spacing)(np.full(len(cloud.x), 7.0)) == pytest.approx(np.full(len(points), 7.0))


def test_no_value_leaves_the_range_of_its_sources_far(mesh, rng) -> None:
    cloud, points, _ = mesh
    noise = rng.choice([0.0, 1.0], len(cloud.x))
    made = Fit(cloud.x, points, cloud.spacing)(noise)
    assert made.min() >= -0.3
    assert made.max() <= 1.3


def test_a_flat_patch_of_points_gives_means_and_not_infinity(rng) -> None:
    x = np.concatenate([rng.uniform(-1, 1, (200, 2)), np.zeros((200, 1))], axis=1)
    y = np.array([[0.0, 0.0, 0.1], [0.3, 0.2, -0.2]])
    made = Fit(x, y, 0.15)(2.0 + x[:, 0])
    assert made == pytest.approx(2.0 + y[:, 0], abs=0.02)


def test_momentum_of_any_motion_is_made_what_it_should_be(rng) -> None:
    x, v, m = rng.normal(size=(50, 3)), rng.normal(size=(50, 3)), rng.uniform(1, 2, 50)
    P, L = np.array([1.0, -2.0, 3.0]), np.array([0.5, 4.0, -1.0])
    made = with_momentum(v, x, m, P, L)
    assert m @ made == pytest.approx(P, abs=1e-12)
    assert m @ np.cross(x, made) == pytest.approx(L, abs=1e-11)
    already = with_momentum(made, x, m, P, L)
    assert already == pytest.approx(made, abs=1e-12)


def test_kinetic_energy_is_reached_within_limits_and_momentum_kept(rng) -> None:
    x, v, m = rng.normal(size=(50, 3)), rng.normal(size=(50, 3)) + np.array([3.0, 0, 0]), rng.uniform(1, 2, 50)
    energy = lambda w: 0.5 * float(m @ np.sum(w**2, axis=1))  # noqa: E731
    for factor, reached in ((1.01, True), (0.99, True), (2.0, False)):
        made = with_energy(v, x, m, factor * energy(v))
        assert m @ made == pytest.approx(m @ v)
        assert m @ np.cross(x, made) == pytest.approx(m @ np.cross(x, v))
        assert (energy(made) == pytest.approx(factor * energy(v), rel=1e-12)) is reached


def test_a_sum_is_reached_above_a_floor_or_all_lie_on_it(rng) -> None:
    values, weights = rng.uniform(0.0, 1.0, 40), rng.uniform(0.5, 1.0, 40)
    for total in (1.0, 10.0, 50.0):
        made = with_sum(values, weights, total, floor=0.0)
        assert made.min() >= 0.0
        assert weights @ made == pytest.approx(total, rel=1e-12)
    assert not with_sum(values, weights, 0.0, floor=0.0).any()

"""Blocks made by hand, whose effective stiffness and conductivity are known in closed form or bounded."""

from dataclasses import replace

import numpy as np
import pytest
from layers import UM, box, stack

from coupler.geometry.tetrahedra import boundary_faces, volumes
from coupler.properties.block import Block, Joints, extract_block
from coupler.properties.homogenise import conducting, elastic
from coupler.properties.measure import moduli

E, NU, K_HEAT = 207e9, 0.31, 91.0  # nickel: Pa, W/mK
LAME, SHEAR = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
KINDS = ("kinematic", "mixed", "static")


def isotropic(lame: float, shear: float) -> np.ndarray:
    C = np.diag([2 * shear] * 3 + [shear] * 3)
    C[:3, :3] += lame
    return C


def stiffness(block: Block, kind: str, factor: np.ndarray | float = 1.0, strain: float = -1.0) -> np.ndarray:
    whole = np.ones(len(block.tets)) * factor
    return getattr(elastic(block, LAME * whole, SHEAR * whole, strain), kind)()


def conductivity(block: Block, kind: str, factor: np.ndarray | float = 1.0, conductance: float = 1.0) -> np.ndarray:
    return getattr(conducting(block, K_HEAT * np.ones(len(block.tets)) * factor, conductance), kind)()


@pytest.fixture(scope="module")
def sample() -> Block:
    """A block out of one body by planes that pass between its nodes."""
    rng = np.random.default_rng(1)
    points, tets = box((5, 5, 5), np.zeros(3), np.full(3, 10 * UM))
    moved = points + rng.uniform(-0.25, 0.25, points.shape) * UM
    low, high = np.array([1.3, 2.1, 1.7]) * UM, np.array([8.6, 7.9, 8.2]) * UM
    body = np.zeros(len(tets), int)
    return extract_block(moved, tets, body, np.zeros((len(points), 2)), low, high, 2 * UM)


def test_a_block_keeps_the_mesh_whole(sample: Block) -> None:
    """Without a pore the metal fills the block, but for slivers that are left out, and all free faces lie on its own."""
    assert sample.solid == pytest.approx(1.0, abs=1e-5)
    assert len(boundary_faces(sample.tets)[0]) == len(sample.walls)
    assert volumes(sample.points, sample.tets).min() > 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_one_body_has_the_constants_of_its_metal(sample: Block, kind: str) -> None:
    """Linear fields solve it under each condition, whatever the mesh; 1e-6 is ten times the tolerance of the solver."""
    whole = sample.solid
    np.testing.assert_allclose(stiffness(sample, kind) / whole, isotropic(LAME, SHEAR), rtol=1e-6, atol=1e-6 * LAME)
    np.testing.assert_allclose(conductivity(sample, kind) / whole, K_HEAT * np.eye(3), rtol=1e-6, atol=1e-6 * K_HEAT)


@pytest.mark.parametrize("kind", KINDS)
def test_bodies_that_are_bonded_everywhere_are_one(kind: str) -> None:
    """A block divided into three bodies: what leads a node may itself be led."""
    block = stack([2.5 * UM, 5 * UM, 2.5 * UM])
    assert len(block.joints.nodes) == 2 * 25
    np.testing.assert_allclose(stiffness(block, kind), isotropic(LAME, SHEAR), rtol=1e-6, atol=1e-6 * LAME)
    np.testing.assert_allclose(conductivity(block, kind), K_HEAT * np.eye(3), rtol=1e-6, atol=1e-6 * K_HEAT)


def test_a_laminate_of_two_metals() -> None:
    """Backus (1962), J. Geophys. Res. 67, 4427: fields are linear in each layer, and meet the mixed conditions. Parallel to the layers
    the means are arithmetic (Voigt), across them harmonic (Reuss)."""
    block, soft = stack([2.5 * UM, 5 * UM, 2.5 * UM]), 0.25
    factor = np.where(block.body == 1, soft, 1.0)
    C, k = stiffness(block, "mixed", factor), conductivity(block, "mixed", factor)
    voigt, reuss = 0.5 * (1 + soft), 2 / (1 + 1 / soft)
    C_33 = LAME + 2 * SHEAR
    assert C[2, 2] == pytest.approx(reuss * C_33, rel=1e-6)
    assert C[0, 0] == pytest.approx(voigt * (C_33 - LAME**2 / C_33) + (LAME / C_33) ** 2 * reuss * C_33, rel=1e-6)
    assert [C[5, 5], C[3, 3]] == pytest.approx([voigt * SHEAR, reuss * SHEAR], rel=1e-6)
    assert [k[0, 0], k[2, 2]] == pytest.approx([voigt * K_HEAT, reuss * K_HEAT], rel=1e-6)
    assert stiffness(block, "kinematic", factor)[2, 2] > 1.01 * C[2, 2]


@pytest.mark.parametrize("contrast", [0.0, 4.0])
def test_a_sphere_in_a_metal(contrast: float) -> None:
    """Hashin & Shtrikman (1962), J. Appl. Phys. 33, 3125, and (1963), J. Mech. Phys. Solids 11, 127: with a share c of spheres the
    bound on the side of the matrix is also what few spheres have. In a cube under mixed conditions all faces are planes of
    symmetry: the sphere is one of a cubic array. Linear elements are too stiff, and this sphere is rough: within 15 % of its effect."""
    n = 12
    points, tets = box((n, n, n), np.full(3, -5 * UM), np.full(3, 5 * UM))
    inside = np.linalg.norm(points[tets].mean(axis=1), axis=1) < 2.6 * UM
    c, half = inside.mean(), np.full(3, 5 * UM)
    kept = ~inside if contrast == 0.0 else np.ones(len(tets), bool)
    number = inside[kept].astype(int)  # kept as the body of each element; bodies share nodes here, so that none touches
    block = extract_block(points, tets[kept], number, np.zeros((len(points), 2)), -half, half, 1e-9)
    factor = np.where(block.body == 1, contrast, 1.0)
    K = LAME + 2 / 3 * SHEAR
    step = 1 / (contrast - 1)
    bulk = 1 + c / (step + (1 - c) * K / (K + 4 / 3 * SHEAR))
    heat = 1 + c / (step + (1 - c) / 3)
    C = stiffness(block, "mixed", factor)
    found = (C[0, 0] + C[0, 1] + C[0, 2]) / 3 / K, conductivity(block, "mixed", factor)[2, 2] / K_HEAT
    for value, bound in zip(found, (bulk, heat), strict=True):
        assert value - bound == pytest.approx(0.0, abs=0.15 * abs(bound - 1))
        assert value > bound if contrast else value < 1.0


def test_a_spot_that_conducts_between_two_halves() -> None:
    """Holm: a round spot of radius a between two half-spaces has the resistance 1 / (2 a k); in a tube of radius b it is less by
    (1 - a / b)^1.5 (Cooper, Mikic & Yovanovich (1969), Int. J. Heat Mass Transfer 12, 279). The bonded nodes stand for their own cells,
    so that the radius is known to a quarter of a cell: 10 %."""
    side, n = 20 * UM, 20
    half = stack([side / 2, side / 2], n=n, side=side, radius=4.01 * UM)
    a = np.sqrt(len(half.joints.nodes) * (side / n) ** 2 / np.pi)
    extra = side * (1 / conductivity(half, "mixed")[2, 2] - 1 / K_HEAT) / side**2
    b = side / np.sqrt(np.pi)
    assert extra == pytest.approx((1 - a / b) ** 1.5 / (2 * a * K_HEAT), rel=0.1)


def test_what_touches_bears_pressure_and_slides() -> None:
    """Two halves that touch all over: across the facets the stiffness is whole, but for the springs of the contact; shear passes by the
    held faces alone. Heat meets 1 / h in series."""
    block, h = stack([5 * UM, 5 * UM], joint="touching"), 5e6
    C = stiffness(block, "mixed")
    assert C[2, 2] == pytest.approx(LAME + 2 * SHEAR, rel=1e-2)
    assert moduli(C)["G_across"] < 0.9 * SHEAR
    assert conductivity(block, "mixed", conductance=h)[2, 2] == pytest.approx(
        1 / (1 / K_HEAT + 1 / (h * 10 * UM)), rel=1e-6
    )


def test_layers_that_only_touch_are_loose_where_they_are_stretched() -> None:
    """Pressed, layers without a bond have the stiffness of the metal across; stretched, none. Along them, layers that are free to
    contract have that of plane stress, E / (1 - nu2). The middle layer is loose then."""
    block = stack([2.5 * UM, 5 * UM, 2.5 * UM], joint="touching")
    pressed, stretched = (stiffness(block, "mixed", strain=strain) for strain in (-1.0, 1.0))
    assert pressed[2, 2] == pytest.approx(LAME + 2 * SHEAR, rel=2e-2)
    assert stretched[2, 2] < 1e-6 * E
    assert stretched[0, 0] == pytest.approx(E / (1 - NU**2), rel=1e-6)
    assert stiffness(block, "static", strain=1.0) is None


def test_surfaces_that_touch_across_a_gap_bear_no_more_than_metal() -> None:
    """Halves that overlap by 2 % of the height: on the faces both sides are held at unequal heights. In the affine field the overlap
    bears as metal does, so that the upper bound is less than 1.02 of the metal's value."""
    block, gap = stack([5 * UM, 5 * UM], joint="touching"), 0.2 * UM
    points = block.points.copy()
    points[np.unique(block.tets[block.body == 1]), 2] -= gap
    block = replace(block, points=points, joints=replace(block.joints, gap=np.full(len(block.joints.nodes), -gap)))
    assert conductivity(block, "kinematic", conductance=1e15)[2, 2] < 1.02 * K_HEAT
    assert stiffness(block, "kinematic")[2, 2] < 1.02 * (LAME + 2 * SHEAR)


def test_halves_that_are_bonded_in_part_open_beside_the_bond() -> None:
    """What touches around a spot closes under pressure and opens in tension, as a pore; each state has its own bounds."""
    whole, spot = stack([5 * UM, 5 * UM], joint="touching"), stack([5 * UM, 5 * UM], radius=3 * UM)
    bonded = np.isin(whole.joints.nodes, spot.joints.nodes)
    block = replace(whole, joints=replace(whole.joints, bonded=bonded))
    pressed, stretched = ([moduli(stiffness(block, kind, strain=s)) for kind in KINDS] for s in (-1.0, 1.0))
    assert pressed[1]["E_across"] == pytest.approx(E, rel=2e-2)
    assert stretched[1]["E_across"] == pytest.approx(moduli(stiffness(spot, "mixed"))["E_across"], rel=1e-5)
    for most, between, least in (pressed, stretched):
        assert all(1.00001 * most[name] > between[name] > 0.99999 * least[name] for name in most)


def test_the_bounds_enclose_and_the_tensors_are_symmetric() -> None:
    """Hill (1963): kinematic >= mixed >= static, as quadratic forms, of halves that are bonded in part; all are positive."""
    block = stack([5 * UM, 5 * UM], n=6, radius=3 * UM)
    problems = [
        elastic(block, *(np.full(len(block.tets), v) for v in (LAME, SHEAR))),
        conducting(block, np.full(len(block.tets), K_HEAT), 1.0),
    ]
    for problem in problems:
        most, between, least = problem.kinematic(), problem.mixed(), problem.static()
        assert least is not None
        for C in (most, between, least):
            np.testing.assert_allclose(C, C.T, rtol=1e-9, atol=1e-5 * abs(C).max())
            assert np.linalg.eigvalsh(C).min() > 0.0
        for larger, smaller in ((most, between), (between, least)):
            assert np.linalg.eigvalsh(larger - smaller).min() > -1e-5 * abs(most).max()


@pytest.mark.parametrize("shape", ["step", "mushroom"])
def test_the_bounds_enclose_where_pores_cut_the_faces(shape: str) -> None:
    """Opposite faces with unequal metal: their tractions balance each other, so that no force inside unloads what lies between."""
    points, tets = box((6, 6, 6), np.full(3, -5 * UM), np.full(3, 5 * UM))
    x, y, z = points[tets].mean(axis=1).T / UM
    kept = ~((z > 1.6) & (x > 0.0)) if shape == "step" else (z < -1.6) | (np.maximum(abs(x), abs(y)) < 1.7)
    none = np.zeros((len(points), 2))
    block = extract_block(
        points, tets[kept], np.zeros(kept.sum(), int), none, np.full(3, -5 * UM), np.full(3, 5 * UM), 1e-9
    )
    most, between, least = (moduli(stiffness(block, kind)) for kind in KINDS)
    heat = np.stack([conductivity(block, kind).diagonal() for kind in KINDS])
    assert all(most[name] > 0.999999 * between[name] > 0.999998 * least[name] > 0.0 for name in most)
    assert (np.diff(heat, axis=0) < 1e-6 * K_HEAT).all()
    assert between["E_across"] < 0.95 * most["E_across"]


def test_a_part_that_hangs_loose_has_no_static_bound() -> None:
    """A half that is bonded along a line aside of its middle turns about it under traction: without limit.
    Driven by its faces it is held."""
    block = stack([5 * UM, 5 * UM], radius=-1.0)
    assert len(block.joints.nodes) == 0
    assert stiffness(block, "mixed")[2, 2] < 1e-6 * E
    assert stiffness(block, "static") is None  # neither half joins the faces below and above
    assert conductivity(block, "static") is None
    line = replace(block, joints=_hinge(block))
    assert stiffness(line, "static") is None
    assert 0.0 < stiffness(line, "mixed")[2, 2] < LAME


def _hinge(block: Block) -> Joints:
    """Nodes of the upper half on the line y = 2.5 um, bonded to the nodes of the lower half there."""
    at = np.flatnonzero((abs(block.points[:, 1] - 2.5 * UM) < 1e-9) & (abs(block.points[:, 2] - 5 * UM) < 1e-9))
    below = np.isin(at, block.tets[block.body == 0])
    upper, lower = at[~below], at[below]
    n = len(upper)
    weights, normal = np.tile([1.0, 0.0, 0.0], (n, 1)), np.tile([0.0, 0.0, 1.0], (n, 1))
    return Joints(
        upper,
        np.repeat(lower[:, None], 3, axis=1),
        weights,
        normal,
        np.zeros(n),
        np.ones(n),
        np.ones(n, bool),
        np.zeros((n, 0)),
    )

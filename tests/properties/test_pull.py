"""Blocks pulled apart whose strength is known."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from layers import UM, stack

from coupler.errors import SolverError, StoreError
from coupler.physics.constitutive import law_record, yield_stresses
from coupler.physics.materials import material
from coupler.properties.block import Block
from coupler.properties.pull import RATE_TIME, STRAIN, Machine, Pull, pull, strengths

CU = material("OFHC_Cu")
LAWS = np.concatenate([law_record(CU, None, RATE_TIME)] * 2)
N = 100e6  # Pa: of the bonds, so low that copper stays elastic


@pytest.fixture(autouse=True)
def _until_all_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coupler.properties.pull.MOST", 0.0081)


def pulled(
    block: Block, strength: float = N, energy: float = 0.0, film: float | None = 1.0, direction: str = "across"
) -> Pull:
    """The block of cold-worked copper with equal bonds, as strong in shear."""
    law = np.tile([strength, strength, energy, energy], (len(block.joints.nodes), 1))
    m, bonded = len(block.tets), replace(block, joints=replace(block.joints, law=law))
    return pull(bonded, LAWS, np.full(m, 0.5), np.full(m, 300.0), np.zeros((m, 3)), direction, film)


def share(block: Block) -> float:
    """Bonded area over that of the block."""
    side = block.high[0] - block.low[0]
    return float(block.joints.area @ block.joints.bonded / side**2)


def test_one_body_yields_at_the_flow_stress_of_its_metal() -> None:
    """Johnson and Cook's numbers at the strain of the start and the rate of a tensile test; hardening and thinning change it by less
    than 2 % until 0.8 % of strain. First it has Young's modulus; a row is the mean of 50 steps."""
    found = pulled(stack([10 * UM], n=1))
    flow = yield_stresses(LAWS[:1], np.zeros(1, np.int32), np.array([0.5]), np.array([300.0]), np.zeros((1, 3)))[0]
    stress = {round(row["strain"], 6): row["stress_Pa"] for row in found.rows}
    assert stress[0.008] == pytest.approx(flow, rel=0.02)
    assert stress[0.001] == pytest.approx(CU.E * (0.001 - 25 * STRAIN), rel=0.02)
    assert not found.has_parted
    assert found.brittle == 0.0
    assert found.energy_error < 1e-3


def test_a_bonded_share_bears_its_strength_where_bonds_are_tough() -> None:
    """Bonds that open by 2 G / N = 60 nm, more than the metal does, all reach N before one of them parts: the strength is the share
    times N, within what is elastic and bends (5 %). Brittle ones part from the edge of the patch: less. All work is accounted for."""
    block = stack([5 * UM, 5 * UM], n=4, radius=3 * UM)
    tough, brittle = pulled(block, energy=3.0), pulled(block)
    limit = share(block) * N
    assert 0.95 * limit < tough.strength_Pa < 1.01 * limit
    assert brittle.strength_Pa < 0.97 * tough.strength_Pa
    for found, error in ((tough, 1e-3), (brittle, 0.06)):  # a brittle bond breaks within a step
        assert found.has_parted
        assert found.at_substrate == 1.0  # the lower body
        assert (found.opened[2]["damage"][found.opened[2]["was_bonded"]] > 0.5).all()
        assert found.brittle > 0.99
        assert found.energy_error < error
    assert tough.rows[-1]["bonds_J"] == pytest.approx(3.0 * share(block) * (10 * UM) ** 2, rel=0.05)


def test_a_thicker_film_makes_tougher_bonds() -> None:
    """The energy of a bond grows with strength times thickness of the film, and with it what the block bears."""
    block = stack([5 * UM, 5 * UM], n=4, radius=3 * UM)
    thin, thick = (pulled(block, energy=0.5, film=film) for film in (0.4, 2.0))
    assert thin.strength_Pa < 0.99 * thick.strength_Pa
    assert thick.rows[-1]["bonds_J"] > 3.0 * thin.rows[-1]["bonds_J"]


@pytest.mark.parametrize(("last", "known"), [(2.0, True), (4.0, False)])
def test_what_inverts_after_the_peak_leaves_the_strength(
    monkeypatch: pytest.MonkeyPatch, last: float, known: bool
) -> None:
    """A neck can invert an element: the greatest force is known if the force has fallen from it."""
    stress = iter((1.0, 3.0, last))

    def row(machine: Machine) -> dict[str, float]:
        if (value := next(stress, None)) is None:
            raise SolverError("inverted")
        return {"stress_Pa": value, "work_J": 1.0} | dict.fromkeys(
            ("strain", "bonds_J", "plastic_J", "stored_or_spent_J"), 0.0
        )

    monkeypatch.setattr(Machine, "row", row)
    block = stack([10 * UM], n=1)
    if known:
        found = pulled(block)
        assert (found.strength_Pa, found.has_parted) == (3.0, False)
    else:
        with pytest.raises(SolverError):
            pulled(block)


def test_what_touches_bears_pressure_alone() -> None:
    """Halves that touch part without force after the first waves. Pressed on each other they have the stiffness of one
    body in series with springs of 4 K over the edge of an element (`contact.bond.penalty`)."""
    halves = stack([5 * UM, 5 * UM], n=2, joint="touching")
    found = pulled(halves)
    assert abs(found.rows[-1]["stress_Pa"]) < 1e-3 * N
    assert found.at_substrate == 0.0  # nothing was bonded
    whole, parted = (_pressed(block) for block in (stack([10 * UM], n=2), halves))
    assert whole < 0.0
    edge = np.cbrt(6.0 * np.sqrt(2.0) * (5 * UM) ** 3 / 6.0)
    assert parted == pytest.approx(whole / (1.0 + CU.E * edge / (4.0 * CU.K * 10 * UM)), rel=0.02)


def _pressed(block: Block) -> float:
    """Force on the faces of a block that move towards each other by 0.02 % of its height."""
    m, law = len(block.tets), np.zeros((len(block.joints.nodes), 4))
    block = replace(block, joints=replace(block.joints, law=law))
    machine = Machine(block, LAWS, np.full(m, 0.5), np.full(m, 300.0), np.zeros((m, 3)), 2, 1.0)
    machine.drift *= -1.0
    machine.t.nodes.v[:] = machine.drift
    return np.mean([machine.step() for _ in range(100)][-40:])


def test_a_run_that_does_not_say_what_its_bonds_bear_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Older files of cohesive bonds have no strengths: these bonds are not tied."""
    plan, splats = (
        SimpleNamespace(adhesion=SimpleNamespace(kind="cohesive", criterion="exposure")),
        SimpleNamespace(mesh=SimpleNamespace(data={})),
    )
    monkeypatch.setattr("coupler.properties.pull.cold_coating", lambda result: (plan, splats, []))
    with pytest.raises(StoreError, match=r"runs/old: cold.vtkhdf has no strength of bonds: run the scene again"):
        strengths(cast(Any, SimpleNamespace(directory="runs/old")))

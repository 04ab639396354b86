"""What the files of a run say about the joints between bodies."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from blocks import cubes

from coupler.impact.recorder import Recorder, joint_fields


def test_nodes_have_the_law_of_their_bonds_before_damage() -> None:
    """A bond that is half damaged and one that is broken, among others; tied bonds have no strength that a file can hold."""
    pair = cubes(2e-6)
    bond = pair.tie(strength=1e8, energy=0.5, shear_strength=4e7, shear_energy=0.2)
    bond.damage[:2] = 0.5, 1.0
    bodies = cast(Any, SimpleNamespace(target=pair.target, bond=bond, contact=None))
    fields = joint_fields(bodies, True)
    whole = np.delete(bond.nodes, 1)
    assert set(np.flatnonzero(fields["bonded"])) == set(whole)
    assert fields["bonded"][bond.nodes[0]] == 0.5
    np.testing.assert_allclose(fields["bond_strength"][whole], np.tile([1e8, 4e7], (len(whole), 1)))
    np.testing.assert_allclose(fields["bond_energy"][whole], np.tile([0.5, 0.2], (len(whole), 1)))
    assert not fields["bond_strength"][bond.nodes[1]].any()
    bond.strength[2:4], bond.energy[2:4] = np.inf, np.inf  # tied, as layers and cores are
    tied = joint_fields(bodies, True)
    assert not tied["bond_strength"][bond.nodes[2:4]].any()
    assert tied["bond_strength"][bond.nodes[4], 0] == 1e8
    bodies.bond = pair.tie()
    assert set(joint_fields(bodies, False)) == {"bonded", "touching"}


def test_the_rim_is_that_of_the_target_not_of_the_refined_part() -> None:
    """A particle beyond the rim, whose offset is the centre of the refined elements."""
    plan = SimpleNamespace(target=SimpleNamespace(centre=(75e-6, 0.0), diameter=200e-6), impacts=[])
    recorder = Recorder.__new__(Recorder)
    recorder.plan = cast(Any, plan)
    at = lambda x: cast(Any, SimpleNamespace(particle=SimpleNamespace(x=np.array([[x, 0.0, 0.0], [x, 2e-6, 0.0]]))))  # noqa: E731
    assert recorder.is_above(at(95e-6))
    assert not recorder.is_above(at(105e-6))

"""What the files of a run say about the joints between bodies."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from blocks import cubes

from coupler.impact.recorder import joint_fields


def test_nodes_have_the_law_of_their_bonds_before_damage() -> None:
    """A bond that is half damaged and one that is broken, among others; tied bonds have no strength that a file can hold."""
    pair = cubes(2e-6)
    bond = pair.tie(strength=1e8, energy=0.5, shear_strength=4e7, shear_energy=0.2)
    bond.damage[:2] = 0.5, 1.0
    bodies = cast(Any, SimpleNamespace(target=pair.target, bond=bond, contact=None))
    fields = joint_fields(bodies)
    whole = np.delete(bond.nodes, 1)
    assert set(np.flatnonzero(fields["bonded"])) == set(whole)
    assert fields["bonded"][bond.nodes[0]] == 0.5
    np.testing.assert_allclose(fields["bond_strength"][whole], np.tile([1e8, 4e7], (len(whole), 1)))
    np.testing.assert_allclose(fields["bond_energy"][whole], np.tile([0.5, 0.2], (len(whole), 1)))
    assert not fields["bond_strength"][bond.nodes[1]].any()
    bodies.bond = pair.tie()
    assert set(joint_fields(bodies)) == {"bonded", "touching"}

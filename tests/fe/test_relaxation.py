"""Coming to rest between impacts: equilibrium, at a cost that small elements do not dictate."""

import numpy as np
import pytest
from blocks import Blocks, pinched

from coupler.contact.bond import Bond, penalty
from coupler.contact.surfaces import interface
from coupler.core.records import copied, put
from coupler.deposition.summary import unsettled
from coupler.errors import SolverError
from coupler.fe import mesh as meshes
from coupler.fe.coarse import FREQUENCY, CoarseGrid
from coupler.fe.explicit import Target
from coupler.fe.relaxed import Relaxation
from coupler.fe.stability import HighestFrequency, masses_for
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.target import equilibrium as relaxation
from coupler.target.bodies import Bodies
from coupler.target.equilibrium import BALANCED, COOLED, RELAX_STEPS, RELAXED, SEARCH_EVERY, settle

KINETIC = 1e-7  # J
STRICT = 1e-6 * KINETIC


def substrate(pinch: float = 0.0, track_wave: bool = False, size: float = 6e-6) -> Bodies:
    """A block of steel on a fixed floor, 60 x 60 x 40 um. pinch: of a tetrahedron's height that is taken away; size: of elements, m."""
    points, tets = mesher.box((60e-6, 60e-6, 40e-6), size)
    mesh = meshes.prepare(points - np.array([30e-6, 30e-6, 40e-6]), tets)
    mesh = pinched(mesh, pinch) if pinch else mesh
    target = Target(mesh, law_record(material("SS304"), rate_filter=1e-9), 300.0, track_wave=track_wave)
    return Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), (), 0.3)


def press(bodies: Bodies, share: float = 1e-3) -> float:
    """Fill the block with heat until it has a pressure (Pa) of that share of the bulk modulus, which is returned."""
    t = bodies.target
    law = t.laws[0]
    t.nodes.energy[:] = share * law["K"] / law["Gamma0"]
    t.nodes.p[:] = share * law["K"]
    return float(share * law["K"])


def slices(bodies: Bodies) -> np.ndarray:
    """Mean sigma_zz (Pa) in four layers."""
    t = bodies.target
    z, szz = t.nodes.x[t.mesh.conn].mean(axis=1)[:, 2], t.stress()[:, 2]
    layer = np.clip(((z + 40e-6) / 10e-6).astype(int), 0, 3)
    return np.bincount(layer, szz * t.elements.volume) / np.bincount(layer, t.elements.volume)


def test_no_cut_through_a_body_without_load_carries_a_mean_stress() -> None:
    """The slowest motion of the whole block has come to its end too: equilibrium asks for no sigma_zz in the mean of any cut."""
    bodies = substrate()
    pressure = press(bodies)
    report = settle(bodies, 0.1 * KINETIC)
    assert report["taken_J"] > 0.0
    assert np.abs(slices(bodies)).max() < 0.01 * pressure
    t = bodies.target
    held = np.unique(t.mesh.facets[t.mesh.sets["bottom"]])
    t.advance(1e-15)
    assert abs(float(t.nodes.f[held, 2].sum())) < 0.01 * pressure * (60e-6) ** 2  # what the floor holds up is nothing
    assert (
        np.ptp(t.stress()[:, 0]) > 0.1 * pressure
    )  # while stresses that balance themselves stay: the floor does not give way


def test_an_equilibrium_goes_on_from_what_one_before_has_found(monkeypatch: pytest.MonkeyPatch) -> None:
    grids: list[int] = []

    def counted(*arguments: object) -> CoarseGrid:
        grids.append(1)
        return CoarseGrid(*arguments)

    monkeypatch.setattr(relaxation, "CoarseGrid", counted)
    places, made = [], []
    for known in (relaxation.Known(), None):
        bodies = substrate()
        press(bodies)
        settle(bodies, 0.1 * KINETIC, known=known)
        bodies.target.nodes.energy[:] *= 1.5
        grids.clear()
        assert settle(bodies, 0.1 * KINETIC, known=known)["left_J"] <= RELAXED * 0.1 * KINETIC
        places.append(bodies.target.nodes.x.copy())
        made.append(len(grids))
    assert made == [0, 1]
    moved = np.abs(places[1] - bodies.target.mesh.points).max()
    assert np.abs(places[0] - places[1]).max() < 0.01 * moved


def test_what_is_left_is_what_was_asked_for_and_is_not_set_free() -> None:
    bodies = substrate()
    press(bodies)
    report = settle(bodies, STRICT)
    assert report["left_J"] <= RELAXED * STRICT
    assert report["released"] < 10 * RELAXED
    again = settle(bodies, STRICT)
    assert again["taken_J"] < 0.01 * report["taken_J"]
    assert again["settle_steps"] == 2 * SEARCH_EVERY + 1 < 0.6 * report["settle_steps"]  # the fewest there are


def test_what_does_not_get_there_says_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relaxation, "RELAX_STEPS", 25)
    bodies = substrate()
    press(bodies)
    report = settle(bodies, STRICT)
    assert report["settle_steps"] == 25
    assert report["left_J"] > RELAXED * STRICT


def test_long_waves_do_not_swing_before_a_pause() -> None:
    """A pressure that is set free at once makes the block yield: with the damping of thin rims from the start, which is a tenth of that
    of the longest wave, it swings and yields four times as much."""
    flow, steps = [], []
    for quick in (BALANCED.quick, 0):
        bodies = substrate()
        press(bodies, 3e-3)
        steps.append(settle(bodies, KINETIC, 0.0, BALANCED._replace(quick=quick))["settle_steps"])
        flow.append(float(bodies.target.elements.eps_p @ bodies.target.elements.volume))
    assert 0.0 < flow[0] < 0.4 * flow[1]
    assert steps[0] < 0.5 * steps[1]


def test_a_crushed_element_does_not_make_it_slower() -> None:
    plain, pinched = substrate(), substrate(pinch=0.95)
    assert pinched.target.stable_dt() < 0.2 * plain.target.stable_dt()
    steps = []
    for bodies in (plain, pinched):
        press(bodies)
        steps.append(settle(bodies, KINETIC)["settle_steps"])
    assert steps[1] < 1.3 * steps[0]


def test_strain_that_the_grid_can_have_comes_back_with_its_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    """f = -K u: the acceleration is -omega^2 u for a uniform strain of a free body, whatever elements and masses there are."""
    monkeypatch.setattr("coupler.fe.coarse.LEAST", 1e-9)
    t = substrate().target
    t.fixed, t.inv_mass = t.fixed[:0], 1.0 / t.mass
    relaxation = Relaxation(t, np.inf, 1e-10)
    x, dt = t.nodes.x.copy(), 1e-10
    way = (x - np.average(x, axis=0, weights=t.mass)) * np.array([1e-6, -0.5e-6, 0.7e-6])
    grid = CoarseGrid(t, relaxation.free, t.mass, dt)
    t.nodes.v[:] = way / dt
    relaxation.dt = dt
    relaxation.advance(0.0)
    expected = -((FREQUENCY / dt) ** 2) * way
    assert np.abs(grid.acceleration(t.nodes.f) - expected).max() < 0.005 * np.abs(expected).max()


def test_what_bonds_and_contact_hold_comes_back_no_faster_than_the_grid_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper of two blocks moves as a whole, the lower one is held, as at the edge of a window: only springs resist."""
    monkeypatch.setattr("coupler.fe.coarse.LEAST", 1e-9)
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((1.0,) * 3, 0.25, (0, 0, 1.0)))
    t, s, up, dt = b.target, b.surfaces, b.nodes(1), 1e-6
    free = np.zeros(len(t.nodes.x), bool)
    free[up] = True
    t.activate_all()
    way, x = np.array([2e-5, 1e-5, -1e-4]), t.nodes.x.copy()
    x[up] += way
    expected = -((FREQUENCY / dt) ** 2) * way
    bond, f = Bond.between(interface(s, t.nodes.x, 1, 0.01), s, t.nodes.x, penalty(b.K, 0.3)), np.zeros_like(t.nodes.x)
    bond.forces(x, f)
    bonded = CoarseGrid(t, free, t.mass, dt, [bond.springs()]).acceleration(f)[up]
    assert np.abs(bonded - expected).max() < 1e-3 * np.abs(expected).max()
    contact, f = b.touch(), np.zeros_like(t.nodes.x)
    contact.search(x, 1e-3)
    contact.forces(1e-9, x, np.zeros_like(x), f)
    pressed = CoarseGrid(t, free, t.mass, dt, [contact.pairs.springs()]).acceleration(f)[up]
    share = pressed.mean(axis=0)[2] / expected[2]
    assert 0.3 < share < 1.001  # not all that may touch do, and their forces are along the normal
    assert (
        np.abs(CoarseGrid(t, free, t.mass, dt).acceleration(f)[up]).max() > 1e3 * np.abs(expected).max()
    )  # without them


def test_half_the_elements_do_not_double_the_steps() -> None:
    """Without the grid they do; the equilibrium is the same, but for where metal yields at the edge of the floor."""
    steps, stresses = [], []
    for size, frequency in ((6e-6, FREQUENCY), (3e-6, FREQUENCY), (3e-6, 1e-9)):
        bodies = substrate(size=size)
        press(bodies)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("coupler.fe.coarse.FREQUENCY", frequency)
            steps.append(settle(bodies, STRICT)["settle_steps"])
        stresses.append(bodies.target.stress())
    assert steps[1] < 1.2 * steps[0]
    assert steps[2] > 3.0 * steps[1]
    assert np.sqrt(np.mean((stresses[2] - stresses[1]) ** 2)) < 0.01 * np.sqrt(np.mean(stresses[1] ** 2))


def test_every_element_bears_the_step_with_its_mass() -> None:
    """The bound of each element with the mass it was given is the step: so is that of all together."""
    t = substrate(pinch=0.9).target
    mass = masses_for(t, 1e-10)
    n, m = len(t.nodes.x), len(t.mesh.conn)
    assert 1e-10 <= HighestFrequency(n, m).longest_step(t, 1e-10, n, m, masses=(mass, 1.0 / mass)) < 2e-10


def test_elements_at_rest_have_no_part_in_the_highest_frequency() -> None:
    """After a call with all elements, one with half of them: the same number as from the restored state, to the last bit."""
    t = substrate().target
    bound = 1.5 * t.stable_dt()
    n, m = len(t.nodes.x), len(t.mesh.conn)
    own, restored = HighestFrequency(n, m), HighestFrequency(n, m)
    own.longest_step(t, bound, n, m)
    put(copied(own), restored)
    half = int(t.mesh.conn[: m // 2].max()) + 1, m // 2
    longest = own.longest_step(t, bound, *half)
    assert bound < longest < 3.0 * bound  # no limit of the function hides it
    assert longest == restored.longest_step(t, bound, *half)


def test_a_limit_far_above_the_needed_step_is_seldom_computed() -> None:
    """Between the iterations it decreases as the bound of the elements does; new nodes and a needed step near it ask for another."""
    t = substrate().target
    bound = 1.5 * t.stable_dt()
    n, m = len(t.nodes.x), len(t.mesh.conn)
    highest = HighestFrequency(n, m)

    def iterates(enough: float, bound: float, nodes: int, elements: int) -> tuple[bool, float]:
        before = highest.w.copy()
        longest = highest.longest_step(t, bound, nodes, elements, enough=enough)
        return bool((highest.w != before).any()), longest / limit

    half = int(t.mesh.conn[: m // 2].max()) + 1, m // 2
    limit = highest.longest_step(t, bound, *half)
    for factor in (1.0, 0.9, 0.8):
        assert iterates(0.5 * limit, factor * bound, *half) == (False, pytest.approx(factor))
    assert iterates(0.5 * limit, bound, *half)[0]
    assert iterates(0.9 * limit, bound, *half)[0]
    assert iterates(0.5 * limit, 0.6 * bound, *half)[0]
    assert iterates(0.5 * limit, bound, n, m)[0]
    assert not iterates(0.5 * limit, bound, n, m)[0]


def test_afterwards_all_is_as_it_was_but_at_rest() -> None:
    """Masses, damping, absorbing faces and inactive part are the solver's own again."""
    bodies = substrate(track_wave=True)
    t = bodies.target
    mass, reach, active = t.mass.copy(), t.reach, t.active_elements
    press(bodies)
    settle(bodies, KINETIC)
    np.testing.assert_array_equal(t.mass, mass)
    np.testing.assert_array_equal(t.inv_mass > 0, ~np.isin(np.arange(len(mass)), t.fixed))
    assert (t.reach, t.active_elements) == (reach, active)
    assert not t.nodes.v.any()


def test_an_inactive_part_under_stress_supports_the_active_part() -> None:
    """A push on a block whose lower part is inactive under stress: its momentum is that of the push and of what the supports give."""
    points, tets = mesher.cylinder(120e-6, 60e-6, 4e-6, 6e-6, 0.3)
    mesh = meshes.prepare(points, tets)
    target = Target(mesh, law_record(material("SS304"), rate_filter=1e-9), 300.0, absorbing=("sides",))
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), ("sides",), 0.3)
    target.reach = 25e-6
    press(bodies)
    # far from equilibrium: the inactive forces have to be counted, they do not cancel by themselves
    settle(bodies, 1e4 * KINETIC)
    assert target.active_elements < len(mesh.conn)
    top = np.flatnonzero((np.abs(mesh.points[:, 2]) < 1e-12) & (mesh.reach_node < 10e-6))
    start, pushed = target.external_impulse(), np.zeros(3)
    for _ in range(40):
        target.advance(1e-10)
        target.f_ext[top, 2] -= 1e-3
        target.finish()
        pushed[2] -= 1e-3 * len(top) * 1e-10
    pushed[2] += 0.5 * 1e-3 * len(top) * 1e-10  # velocities are those of half a step before the last kick's end
    error = target.momentum() - (target.external_impulse() - start) - pushed
    assert np.abs(error).max() < 1e-9 * np.abs(pushed).max()


def test_what_was_taken_is_what_the_bodies_have_lost() -> None:
    bodies = substrate()
    press(bodies)
    t = bodies.target
    before = t.elastic() + t.balance.plastic
    report = settle(bodies, KINETIC)
    after = t.elastic() + t.balance.plastic
    assert before - after == pytest.approx(report["taken_J"], rel=1e-3)


def test_rest_round_a_place_tends_to_that_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """A heated core of 10 um: what keeps still beyond a radius holds it back the less the larger that is, and takes up its own heat
    once. A part with more than half of the elements is all."""
    stresses = {}
    for radius in (np.inf, 24e-6, 40e-6):
        monkeypatch.setattr(relaxation, "LOCAL", 1.0)
        bodies = substrate().renumbered((0.0, 0.0, 0.0))
        t = bodies.target
        before = t.nodes.x.copy()
        centre = np.linalg.norm(t.nodes.x[t.mesh.conn].mean(axis=1), axis=1)
        heat = 1e-8 * t.mesh.V0 / t.mesh.V0.max()
        t.warm(np.arange(len(heat)), np.where(centre < 10e-6, heat, 1e-5 * heat))
        settle(bodies, 1e-3 * KINETIC, 0.0, COOLED, radius=radius)
        still = np.all(t.nodes.x == before, axis=1) & (before[:, 2] > -39e-6)
        assert still.any() == np.isfinite(radius)
        assert np.all(t.mesh.reach_node[still] > 0.6 * radius)
        assert t.inv_mass[t.mesh.reach_node < 20e-6].all()
        assert not t.elements.heat.any()
        assert t.mesh.node_volume @ t.nodes.energy == pytest.approx(
            t.balance.heat, rel=0.01
        )  # less the work of expansion
        stresses[radius] = t.stress()[centre < 14e-6]
    whole = stresses.pop(np.inf)
    far, near = (np.linalg.norm(s - whole) / np.linalg.norm(whole) for s in stresses.values())
    assert near < 0.04 < 0.15 < far < 0.25
    monkeypatch.undo()
    bodies = substrate().renumbered((0.0, 0.0, 0.0))
    before = bodies.target.nodes.x.copy()
    bodies.target.warm(np.arange(len(heat)), np.where(centre < 10e-6, heat, 1e-5 * heat))
    settle(bodies, 1e-3 * KINETIC, 0.0, COOLED, radius=40e-6)
    assert np.mean(bodies.target.mesh.reach_element < 40e-6) > relaxation.LOCAL
    assert (bodies.target.nodes.x != before)[before[:, 2] > -39e-6].any(axis=1).all()


@pytest.mark.parametrize("steps", [RELAX_STEPS - 1, RELAX_STEPS])
def test_an_equilibrium_that_was_given_up_is_a_warning(steps: int) -> None:
    pause = {"impact": 7, "settle_steps": 40.0, "cooling": {"balance_steps": float(steps), "then_settle_steps": 90.0}}
    closing = {"then_settle_steps": float(steps)}
    texts = [*unsettled(pause), *unsettled(closing)]
    assert len(texts) == (2 if steps == RELAX_STEPS else 0)
    for text, when in zip(texts, ("after impact 7", "after cooling to ambient"), strict=False):
        assert text.startswith(f"{when} the bodies have not reached equilibrium in 2500 steps")


def test_bodies_that_gain_energy_after_their_equilibrium_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """More motion than the impacts brought: the step is not stable, and the bodies would explode in the pauses after it."""
    monkeypatch.setattr(relaxation, "_run_for", lambda *_: 2.0 * KINETIC)
    with pytest.raises(SolverError, match="bodies at rest gained 2e-07 J, more than the 1e-07 J of the impact"):
        settle(substrate(), KINETIC)

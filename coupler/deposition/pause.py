"""Heat between impacts and after the last: conduction through the pause, cooling to ambient, and the stresses that both make.

Stresses are told apart by what has made them: `Target.thermal_stress` adds up what each pause and the last cooling have changed, from
equilibrium to equilibrium; what is left of the stress is that of the impacts (peening, joining). The sum of increments of incremental
deposition models (Tsui & Clyne 1997, Thin Solid Films 306), here with plastic flow: an impact that makes an element yield changes its
stress by an increment of its own.
"""

import time as clock
from collections.abc import Callable

import numpy as np

from ..contact.overlap import overlaps
from ..contact.surfaces import earlier_neighbours, interface
from ..fe.conductances import Links
from ..fe.cooling import Film, cool
from ..fe.explicit import Target
from ..fe.heat import take_heat
from ..fe.model import Elements
from ..files.summary import Values
from ..geometry.triangles import areas
from ..physics.constitutive import heat_capacities, pressures, yield_stresses
from ..physics.materials import Material
from ..physics.recovery import recovery_of
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.equilibrium import BALANCED, COOLED, Known, settle
from ..target.placing import NEAR
from .detaching import held_at_rest

COOLER = 0.25  # K: makes some 2 MPa
AT_AMBIENT = 1.0  # K: the most that the closing stage leaves an element from ambient
# In the closing stage at most: what flows in the first warms by some 40 K, in the second by less than AT_AMBIENT
COOLINGS = 8
STEPS_OF_RECOVERY = 40  # in the closing stage: twice as many change the strain that is left by 0.2 %
_SOFTER = 0.01  # share of the plastic strain that recovers, beyond which equilibrium is found anew
_AT_ONCE = 1e-18  # s: a step in which nothing moves
_EXACT = 1e-6  # K: to which heat is taken away


def pause(plan: Plan, time: float, bodies: Bodies, kinetic_0: float, radius: float = np.inf) -> Values:
    """Let heat flow for `time` s, and bodies at rest come to equilibrium again. kinetic_0: J, of the impacts before; radius: m from
    where the numbering begins, up to which the impact has left them out of it. Returns the report.

    The substrate's bottom and sides are kept at its temperature, the jet heats what it reaches where the spray says so, all else is
    insulated; bodies that lie on each other conduct as in perfect contact. What the impact has left out of balance, such as at the
    rim of its cut, is not caused by cooling: it is relaxed first. Both equilibria reach as far as temperatures have changed by COOLER,
    too.
    """
    started, t = clock.perf_counter(), bodies.target
    facets = np.concatenate([t.mesh.facets[t.mesh.sets[name]].ravel() for name in ("bottom", "sides")])
    links = _links(bodies, plan.splat_element_size)
    before, taken, film = t.elements.T.copy(), t.elements.eps_recovered.copy(), _film(bodies, plan.surface_heat)
    cooling = cool(t, time, np.unique(facets), plan.target.temperature, links, film, _recovery(plan, bodies))
    conducted = clock.perf_counter()
    softer = t.elements.eps_recovered - taken > _SOFTER * t.elements.eps_p
    changed = t.mesh.reach_element[(np.abs(t.elements.T - before) > COOLER) | softer]
    beyond = np.nextafter(changed.max(initial=0.0), np.inf)  # all of a shell of the numbering has the same distance
    radius, known = max(radius, float(beyond)), Known()
    report: Values = {"balance_steps": _balance(bodies, kinetic_0, radius, known), **cooling}
    report |= _settled(bodies, kinetic_0, radius, known)
    return report | {"seconds": {"conduction": conducted - started, "equilibria": clock.perf_counter() - conducted}}


def cool_to_ambient(plan: Plan, bodies: Bodies, kinetic_0: float) -> tuple[Bodies, Values]:
    """Bring all bodies to the plan's ambient temperature and to equilibrium: their stresses are residual then. Returns those that are
    still held (`detaching`), and the report.

    Each body ends with the thermal strain of its thermal_expansion(T) between the temperature
    that it came with, at which it was without stress, and ambient; where a material has none, with that of Gamma0 rho c_p / K. The
    fixed faces of the substrate follow its free contraction. What yields on the way to equilibrium warms: the heat is taken away
    again, until equilibrium leaves all within AT_AMBIENT.
    """
    started, t = clock.perf_counter(), bodies.target
    ambient = plan.ambient if plan.ambient is not None else plan.target.temperature
    bodies.separate(range(bodies.count))
    known = Known()
    if plan.cooling_time > 0.0:
        hot, recover = t.elements.T.copy(), _recovery(plan, bodies)
        for step in range(STEPS_OF_RECOVERY):
            t.elements.T[:] = hot + (step + 0.5) / STEPS_OF_RECOVERY * (ambient - hot)
            recover(plan.cooling_time / STEPS_OF_RECOVERY)
        t.elements.T[:] = hot
    _balance(bodies, kinetic_0, np.inf, known)
    came = [(plan.target.material, plan.target.temperature)]
    came += [(plan.impacts[i - 1].material, plan.impacts[i - 1].temperature) for i in bodies.impact[1:]]
    before = {
        "T_max_before_K": float(t.elements.T.max()),
        "T_mean_before_K": float(np.average(t.elements.T, weights=t.mesh.V0)),
    }
    shared, laws = _contraction(*came[0], ambient), np.split(t.laws, len(came))
    _contract(t, shared)
    energies = [_missing_energy(*each, ambient, law, shared) for each, law in zip(came, laws, strict=True)]
    missing = np.array(energies)[t.law_of] * t.laws["expansion"][t.law_of] * t.mesh.V0
    t.elements.heat[:] += missing
    t.balance.heat += float(missing.sum())
    report: Values = {**before, "ambient_K": ambient, "detached": []}
    for number in range(1, COOLINGS + 1):
        _take_heat_away(t, ambient)
        report |= _settled(bodies, kinetic_0, np.inf, known)
        bodies, detached = held_at_rest(plan, bodies, len(plan.impacts), "cooling", kinetic_0)
        report["detached"] += detached
        t, known = bodies.target, Known() if detached else known
        report |= {"coolings": number, "off_ambient_K": float(np.abs(t.elements.T - ambient).max())}
        if report["off_ambient_K"] <= AT_AMBIENT:
            break
    report["overlap_m"] = float(overlaps(bodies.surfaces, t.nodes.x, range(bodies.count)).max())
    return bodies, report | {"wall_s": clock.perf_counter() - started}


def _balance(bodies: Bodies, kinetic_0: float, radius: float, known: Known) -> float:
    """Relax what the impacts have left out of balance, which cooling has not caused; heat stays pending. Returns the steps."""
    t = bodies.target
    heat = t.elements.heat.copy()
    t.elements.heat[:] = 0.0
    steps = settle(bodies, kinetic_0, 0.0, BALANCED, radius, known)["settle_steps"]
    t.elements.heat[:] += heat
    return steps


def _settled(bodies: Bodies, kinetic_0: float, radius: float, known: Known) -> Values:
    """Relax thermal stresses, and add what the cooling has changed to those."""
    t = bodies.target
    before = t.stress()
    settled = settle(bodies, kinetic_0, 0.0, COOLED, radius, known)  # nothing is left to watch
    t.elements.thermal_stress[:] += t.stress() - before
    return {f"then_{name}": settled[name] for name in ("settle_steps", "left_J", "taken_J")}


def _recovery(plan: Plan, bodies: Bodies) -> Callable[[float], None]:
    """A function that lets all elements recover for a time (s) at their temperatures, none where the plan leaves it out."""
    if not plan.effects.recovery:
        return lambda _: None
    t = bodies.target
    metals = [plan.target.material, *(plan.impacts[i - 1].material for i in bodies.impact[1:])]
    laws = [recovery_of(metal) for metal in metals]
    known = {law: np.isin(t.law_of, [k for k, own in enumerate(laws) if own is law]) for law in laws if law is not None}

    def yields(rows: np.ndarray) -> np.ndarray:
        e = t.elements
        return yield_stresses(t.laws, t.law_of[rows], e.eps_p[rows], e.T[rows], e.eps_gradient[rows])

    def recover(time: float) -> None:
        e = t.elements
        for law, of_law in known.items():
            rows = np.flatnonzero(of_law & (e.eps_p > 0.0))
            before, left = yields(rows), law.after(e.eps_p[rows], e.T[rows], time)
            e.eps_recovered[rows] += e.eps_p[rows] - left
            e.eps_p[rows] = left
            e.sigma_y[rows] *= yields(rows) / before

    return recover


def _take_heat_away(t: Target, ambient: float) -> None:
    """Set all elements to ambient, K, by taking the heat for it; more than once where c_p(T) bends on the way."""
    m, rho = len(t.elements.T), t.laws["rho"][t.law_of]
    for _ in range(20):
        if np.abs(t.elements.T - ambient).max() < _EXACT:
            return
        c_p = heat_capacities(t.laws[t.law_of], 0.5 * (t.elements.T + ambient))
        gain = rho * t.mesh.V0 * c_p * (ambient - t.elements.T)
        t.balance.heat += take_heat(0, m, gain, t.cells, t.metals, Elements.of(t.elements))


def _contraction(metal: Material, T: float, ambient: float) -> float:
    """Linear thermal strain from T to ambient, K: of thermal_expansion, or of Gamma0 rho c_p / K where that is not known."""
    middle = 0.5 * (T + ambient)
    alpha = metal.thermal_expansion_at(middle) or metal.Gamma0 * metal.rho * metal.cp_at(middle) / (3.0 * metal.K)
    return alpha * (ambient - T)


def _contract(t: Target, strain: float) -> None:
    """Contract all bodies and what holds them by a linear strain as the substrate does: at once, with the energies at which the strain
    changes no pressure, so that no metal flows on the way."""
    t.nodes.x[:] *= 1.0 + strain
    t.rest_scale *= 1.0 + strain
    energy = (
        np.array([_energy_of(law, strain) for law in np.split(t.laws, len(t.laws))])[t.law_of]
        * t.laws["expansion"][t.law_of]
        * t.mesh.V0
    )
    pending = t.elements.heat.copy()
    t.elements.heat[:] = energy
    t.balance.heat += float(energy.sum())
    t.activate_all()
    t.advance(_AT_ONCE, is_conducting=False)
    t.rest()
    t.elements.heat[:] += pending


def _energy_of(law: np.ndarray, strain: float) -> float:
    """Energy (J/m3) at which a metal that is strained in all directions has the pressure that it had before; 0 without Gamma0."""
    pressure = pressures(law, np.array([(1.0 + strain) ** 3]), np.zeros(1))[0]
    return float(-pressure / law["Gamma0"][0]) if law["Gamma0"][0] else 0.0


def _missing_energy(metal: Material, T: float, ambient: float, law: np.ndarray, shared: float) -> float:
    """Energy (J/m3) that the equation of state needs beside the heat from T to ambient, K, to contract by `_contraction`, of which the
    strain `shared` has its energy."""
    heat = metal.rho * metal.cp_at(0.5 * (T + ambient)) * (ambient - T) if metal.Gamma0 else 0.0
    return _energy_of(law, _contraction(metal, T, ambient)) - _energy_of(law, shared) - heat


def _links(bodies: Bodies, size: float) -> list[Links]:
    """Where splats lie on each other or on the substrate. size: of their elements, m."""
    surfaces, x = bodies.surfaces, bodies.target.nodes.x
    reach = NEAR * size
    near = earlier_neighbours(surfaces, x, reach)
    contacts = [interface(surfaces, x, body, reach, near[body]) for body in range(1, bodies.count) if near[body]]
    return [Links(c.nodes, surfaces.facets[c.facet], c.weights, c.area) for c in contacts if len(c.nodes)]


def _film(bodies: Bodies, heat: tuple[float, float] | None) -> Film | None:
    """The jet on all that a particle can reach from above. heat: coefficient W/(m2 K), temperature K; None: no jet."""
    if heat is None:
        return None
    t = bodies.target
    facets = t.mesh.facets[np.setdiff1d(bodies.reachable(), t.mesh.sets["sides"])]
    return Film(facets.ravel(), np.repeat(areas(t.nodes.x, facets) / 3.0, 3), *heat)

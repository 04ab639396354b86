"""Heat between impacts and after the last: conduction through the pause, cooling to ambient, and the stresses that both make.

Stresses are told apart by what has made them: `Target.thermal_stress` adds up what each pause and the last cooling have changed, from
equilibrium to equilibrium; what is left of the stress is that of the impacts (peening, joining). The sum of increments of incremental
deposition models (Tsui & Clyne 1997, Thin Solid Films 306), here with plastic flow: an impact that makes an element yield changes its
stress by an increment of its own.
"""

import time as clock

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
from ..physics.constitutive import heat_capacities
from ..physics.materials import Material
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.equilibrium import BALANCED, COOLED, Known, settle
from ..target.placing import NEAR
from .detaching import held_at_rest

COOLER = 0.25  # K: makes some 2 MPa
AT_AMBIENT = 1.0  # K: the most that the closing stage leaves an element from ambient
# In the closing stage at most: what flows in the first warms by some 40 K, in the second by less than AT_AMBIENT
COOLINGS = 8
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
    before = t.elements.T.copy()
    cooling = cool(t, time, np.unique(facets), plan.target.temperature, links, _film(bodies, plan.surface_heat))
    conducted = clock.perf_counter()
    changed = t.mesh.reach_element[np.abs(t.elements.T - before) > COOLER]
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
    held faces of the substrate follow its free contraction. What yields on the way to equilibrium warms: the heat is taken away
    again, until equilibrium leaves all within AT_AMBIENT.
    """
    started, t = clock.perf_counter(), bodies.target
    ambient = plan.ambient if plan.ambient is not None else plan.target.temperature
    bodies.separate(range(bodies.count))
    known = Known()
    _balance(bodies, kinetic_0, np.inf, known)
    came = [(plan.target.material, plan.target.temperature)]
    came += [(plan.impacts[i - 1].material, plan.impacts[i - 1].temperature) for i in bodies.impact[1:]]
    before = {
        "T_max_before_K": float(t.elements.T.max()),
        "T_mean_before_K": float(np.average(t.elements.T, weights=t.mesh.V0)),
    }
    missing = np.array([_missing_energy(metal, T, ambient) for metal, T in came])[t.law_of] * t.mesh.V0
    missing *= t.laws["expansion"][t.law_of]
    t.elements.heat[:] += missing
    t.balance.heat += float(missing.sum())
    shrunk = 1.0 + _contraction(*came[0], ambient)
    t.nodes.x[:] *= shrunk
    t.rest_scale *= shrunk
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


def _missing_energy(metal: Material, T: float, ambient: float) -> float:
    """Energy (J/m3) that the equation of state needs beside the heat from T to ambient, K, to contract by `_contraction`.

    p = ... + Gamma0 E: a free body expands in volume by Gamma0 E / K.
    """
    if metal.Gamma0 == 0.0:
        return 0.0
    heat = metal.rho * metal.cp_at(0.5 * (T + ambient)) * (ambient - T)
    return 3.0 * metal.K / metal.Gamma0 * _contraction(metal, T, ambient) - heat


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

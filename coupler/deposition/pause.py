"""Heat conduction in the pauses between impacts, cooling to ambient after the last impact, and the thermal stresses.

Stresses are separated by cause: the field thermal_stress sums the changes of stress in each pause and in the final cooling, from
equilibrium to equilibrium. The rest of the stress comes from the impacts (peening, joining). Incremental deposition models sum
increments in the same way (Tsui & Clyne 1997, Thin Solid Films 306); here elements also yield.
"""

import time as clock
from collections.abc import Callable

import numpy as np

from ..contact.overlap import overlaps
from ..contact.surfaces import earlier_neighbours, interface
from ..core.arrays import Links
from ..fe.conductances import LINK_RESISTANCE
from ..fe.cooling import cool
from ..fe.explicit import Target
from ..fe.heat import add_heat
from ..fe.model import Elements
from ..files.summary import Values
from ..geometry.triangles import areas
from ..impact.domains import metals_of
from ..physics.constitutive import heat_capacities, pressures, yield_stresses
from ..physics.materials import Material
from ..physics.recovery import recovery_of
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.equilibrium import BALANCED, COOLED, Known, settle
from ..target.placing import NEAR
from .detaching import all_attached

COOLER = 0.25  # K: a change of temperature that makes about 2 MPa; smaller changes need no new equilibrium
AT_AMBIENT = 1.0  # K: greatest difference from ambient after the closing stage
# Most repetitions in the closing stage. Plastic work warms elements by about 40 K in the first, by less than AT_AMBIENT in the second.
COOLINGS = 8
STEPS_OF_RECOVERY = 40  # in the closing stage; 80 steps change the remaining strain by 0.2 %
_SOFTER = 0.01  # recovered share of the plastic strain, above which a new equilibrium is computed
_AT_ONCE = 1e-18  # s: a time step without motion
_EXACT = 1e-6  # K: accuracy of a given temperature


def pause(plan: Plan, time: float, bodies: Bodies, kinetic_0: float, radius: float = np.inf) -> Values:
    """Conduct heat for `time` s, and bring the bodies to equilibrium again. Returns the report.

    kinetic_0: kinetic energy of the impacts before, J; radius: distance from the impact points, m, within which the impacts have left
    the bodies out of equilibrium. Bottom and sides of the substrate keep the initial temperature; the jet heats the surface if the
    scene has a spray; other surfaces are insulated; touching bodies conduct as in perfect contact. A first equilibrium relaxes the
    imbalance from the impacts, a second one that from the changes of temperature. Both extend to `radius`, or farther to the last
    element whose temperature changes by more than `COOLER` or whose plastic strain recovers.
    """
    started, t = clock.perf_counter(), bodies.target
    facets = np.concatenate([t.mesh.facets[t.mesh.sets[name]].ravel() for name in ("bottom", "sides")])
    links = _links(bodies, plan.splat_element_size)
    before, recovered, gas = t.elements.T.copy(), t.elements.eps_recovered.copy(), _gas(bodies, plan.surface_heat)
    cooling = cool(t, time, np.unique(facets), plan.target.temperature, links, gas, _recovery(plan, bodies))
    conducted = clock.perf_counter()
    softer = t.elements.eps_recovered - recovered > _SOFTER * t.elements.eps_p
    changed = t.mesh.reach_element[(np.abs(t.elements.T - before) > COOLER) | softer]
    beyond = np.nextafter(changed.max(initial=0.0), np.inf)  # to the end of a shell: its elements have one distance
    radius, known = max(radius, float(beyond)), Known()
    report: Values = {"balance_steps": _balance(bodies, kinetic_0, radius, known), **cooling}
    report |= _settled(bodies, kinetic_0, radius, known)
    return report | {"seconds": {"conduction": conducted - started, "equilibria": clock.perf_counter() - conducted}}


def cool_to_ambient(plan: Plan, bodies: Bodies, kinetic_0: float) -> tuple[Bodies, Values]:
    """Bring all bodies to the ambient temperature of the plan and to equilibrium: the stresses are then residual stresses. Returns the
    bodies without detached splats (`all_attached`), and the report.

    Each body gets the thermal strain between its initial temperature, at which it is free of stress, and ambient: from
    thermal_expansion(T), or from Gamma0 rho c_p / K for a material without it. The fixed faces of the substrate move with its free
    contraction. Plastic work during the equilibration warms elements; the heat is removed and the equilibration repeated until all
    temperatures are within AT_AMBIENT.
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
    at_first = [plan.impacts[i - 1].temperature if i else plan.target.temperature for i in bodies.impact]
    came = list(zip(metals_of(plan, bodies), at_first, strict=True))
    T_max, T_mean = float(t.elements.T.max()), float(np.average(t.elements.T, weights=t.mesh.V0))
    laws = np.split(t.laws, len(came))
    expands = bool(
        laws[0]["Gamma0"][0] and laws[0]["expansion"][0]
    )  # else heat does not change the volume of the substrate
    shared = came[0][0].strain_between(came[0][1], ambient) if expands else 0.0
    _contract(t, shared)
    energies = [_missing_energy(*each, ambient, law, shared) for each, law in zip(came, laws, strict=True)]
    missing = np.array(energies)[t.law_of] * t.laws["expansion"][t.law_of] * t.mesh.V0
    t.elements.heat[:] += missing
    t.balance.heat += float(missing.sum())
    report: Values = {"T_max_before_K": T_max, "T_mean_before_K": T_mean, "ambient_K": ambient, "detached": []}
    for number in range(1, COOLINGS + 1):
        _remove_heat(t, ambient)
        report |= _settled(bodies, kinetic_0, np.inf, known)
        bodies, detached = all_attached(plan, bodies, len(plan.impacts), "cooling", kinetic_0)
        report["detached"] += detached
        t, known = bodies.target, Known() if detached else known
        report |= {"coolings": number, "off_ambient_K": float(np.abs(t.elements.T - ambient).max())}
        if report["off_ambient_K"] <= AT_AMBIENT:
            break
    report["overlap_m"] = float(overlaps(bodies.surfaces, t.nodes.x, range(bodies.count)).max())
    return bodies, report | {"wall_s": clock.perf_counter() - started}


def _balance(bodies: Bodies, kinetic_0: float, radius: float, known: Known) -> float:
    """Relax the imbalance from the impacts. The heat in `elements.heat` takes effect only afterwards. Returns the number of steps."""
    t = bodies.target
    heat = t.elements.heat.copy()
    t.elements.heat[:] = 0.0
    steps = settle(bodies, kinetic_0, 0.0, BALANCED, radius, known)["settle_steps"]
    t.elements.heat[:] += heat
    return steps


def _settled(bodies: Bodies, kinetic_0: float, radius: float, known: Known) -> Values:
    """Relax after a change of temperature, and add the change of stress to thermal_stress. Returns entries of the report."""
    t = bodies.target
    before = t.stress()
    settled = settle(bodies, kinetic_0, 0.0, COOLED, radius, known)  # without a check of released energy
    t.elements.thermal_stress[:] += t.stress() - before
    return {f"then_{name}": settled[name] for name in ("settle_steps", "left_J", "taken_J")}


def _recovery(plan: Plan, bodies: Bodies) -> Callable[[float], None]:
    """The function `recover(time)`: dislocations of all elements recover for `time` (s) at the temperature of each element. It does
    nothing if the plan excludes recovery."""
    if not plan.effects.recovery:
        return lambda _: None
    t = bodies.target
    laws = [recovery_of(metal) for metal in metals_of(plan, bodies)]
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
            # molten metal has no yield stress
            e.sigma_y[rows] *= np.divide(yields(rows), before, out=np.ones(len(rows)), where=before > 0.0)

    return recover


def _remove_heat(t: Target, ambient: float) -> None:
    """Set all elements to ambient temperature, K, by removal of heat; repeated, because c_p depends on the temperature."""
    m, rho = len(t.elements.T), t.laws["rho"][t.law_of]
    for _ in range(20):
        if np.abs(t.elements.T - ambient).max() < _EXACT:
            return
        c_p = heat_capacities(t.laws[t.law_of], 0.5 * (t.elements.T + ambient))
        gain = rho * t.mesh.V0 * c_p * (ambient - t.elements.T)
        t.balance.heat += add_heat(0, m, gain, t.cells, t.metals, Elements.of(t.elements))


def _contract(t: Target, strain: float) -> None:
    """Contract all bodies and the fixed faces in one step by the linear strain of the substrate. Energies change such that pressures
    stay constant, so that no element yields."""
    t.nodes.x[:] *= 1.0 + strain
    t.rest_scale *= 1.0 + strain
    of_law = np.array([_energy_of(law, strain) for law in np.split(t.laws, len(t.laws))])
    energy = of_law[t.law_of] * t.laws["expansion"][t.law_of] * t.mesh.V0
    pending = t.elements.heat.copy()
    t.elements.heat[:] = energy
    t.balance.heat += float(energy.sum())
    t.activate_all()
    t.advance(_AT_ONCE, is_conducting=False)
    t.rest()
    t.elements.heat[:] += pending


def _energy_of(law: np.ndarray, strain: float) -> float:
    """Energy (J/m3) that keeps the pressure of a metal constant under a linear strain in all directions; 0 without Gamma0."""
    pressure = pressures(law, np.array([(1.0 + strain) ** 3]), np.zeros(1))[0]
    return float(-pressure / law["Gamma0"][0]) if law["Gamma0"][0] else 0.0


def _missing_energy(metal: Material, T: float, ambient: float, law: np.ndarray, shared: float) -> float:
    """Energy (J/m3) with which the equation of state gives the strain of `Material.strain_between`. Two parts are subtracted: the
    energy of the strain `shared`, which all bodies have, and the heat from T to ambient (K). law: constants of the metal."""
    heat = metal.rho * metal.cp_at(0.5 * (T + ambient)) * (ambient - T) if metal.Gamma0 else 0.0
    return _energy_of(law, metal.strain_between(T, ambient)) - _energy_of(law, shared) - heat


def _links(bodies: Bodies, size: float) -> list[Links]:
    """Thermal contacts of splats with each other and with the substrate. size (m): size of the splats' elements."""
    surfaces, x = bodies.surfaces, bodies.target.nodes.x
    reach = NEAR * size
    near = earlier_neighbours(surfaces, x, reach)
    contacts = [interface(surfaces, x, body, reach, near[body]) for body in range(1, bodies.count) if near[body]]
    return [Links.of(c.nodes, surfaces.facets[c.facet], c.weights, np.sqrt(c.area) / LINK_RESISTANCE) for c in contacts]


def _gas(bodies: Bodies, heat: tuple[float, float] | None) -> tuple[np.ndarray, float] | None:
    """Conductance (n,) W/K from the jet to each node of the surfaces that are reachable from above, and temperature (K) of the jet.
    heat: heat transfer coefficient (W/(m2 K)) and gas temperature; None if there is no jet."""
    if heat is None:
        return None
    t = bodies.target
    facets = t.mesh.facets[np.setdiff1d(bodies.reachable(), t.mesh.sets["sides"])]
    conductance = heat[0] * np.repeat(areas(t.nodes.x, facets) / 3.0, 3)
    return np.bincount(facets.ravel(), conductance, len(t.nodes.x)), heat[1]

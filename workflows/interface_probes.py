"""Springs of the contact, and strength of the bonds over the radius: python workflows/interface_probes.py

springs: energy of the springs of the contact at the greatest deformation, and of the rebound, over their stiffness, without bonds
(docs/tables/contact_springs.csv). profile: strength of the bonds over the radius (bond_profile.csv). Impacts of
workflows/critical_ni.toml and critical_al.toml. Rows in the tables are not computed again.
"""

import itertools
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
from bonding_energy import scene_of
from pages import computed, fill, study_table

from coupler import Scene
from coupler.impact.exchange import Impact
from coupler.impact.touching import softer_strength
from coupler.studies.critical import at_velocity
from coupler.studies.sweep import toml_text

SPRINGS = (
    "metal", "velocity_m_s", "preset", "contact_stiffness", "springs_J_m2", "rebound_J_m2", "restitution", "steps",
)  # fmt: skip
PROFILE = (
    "metal", "diameter_um", "velocity_m_s", "preset", "zone_r_over_R", "clean_share", "strength_MPa", "over_flow_stress",
    "energy_J_m2",
)  # fmt: skip
VELOCITY_NI = 665.0  # m/s, of the springs
SIZE_AL, VELOCITY_AL = 22.0, 1100.0  # um and m/s, of the profile
ZONES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)  # of the particle's radius, at the greatest deformation


def flow_stresses(impact: Impact) -> np.ndarray:
    """Flow stress (v,) Pa of the softer metal at the vertices of the particle's surface; infinite far from the target."""
    stresses = np.full(impact.surface.weights.shape[0], np.inf)
    near, facets = impact.contact.touching(len(stresses), 10.0 * impact.particle.spacing)
    stresses[near] = softer_strength(impact.domains, near, facets)
    return stresses


class Profile:
    """A probe: bonds by their radius, as they have formed by the end of the impact."""

    def __init__(self) -> None:
        self.values: tuple[np.ndarray, ...] | None = None

    def __call__(self, impact: Impact) -> None:
        bonds, exposure = impact.bonds, impact.exposure
        if impact.sinking > 0.0 or bonds is None or exposure is None:
            return
        x, bond = impact.surface.positions(impact.particle.x)[bonds.bond.nodes], bonds.bond
        flow = flow_stresses(impact)[bonds.bond.nodes]
        values = bond.strength[:, 0], flow, bond.energy[:, 0], exposure.clean[bonds.bond.nodes, 0]
        self.values = np.hypot(x[:, 0], x[:, 1]), bond.area, *values


def compute(text: str, probe: Callable[[Impact], None], **numerics: float) -> dict[str, Any]:
    """The values of the run of a scene."""
    with computed(Scene.from_text(text, "probe"), probe=probe, numerics=numerics) as (result, _):
        return dict(result.values)


def springs(preset: str, factor: str) -> dict[str, object]:
    """One impact without bonds; energies over the section of the particle. factor: on the stiffness of the contact."""
    scene, energy = scene_of("Ni", "10", preset=preset), list[float]()

    def probe(impact: Impact) -> None:
        if not energy and impact.sinking < 0.0:  # the particle turns back
            energy.append(impact.contact.penalty_energy)

    data = tomllib.loads(at_velocity(scene, VELOCITY_NI)) | {"adhesion": {"kind": "none"}}
    s = compute(toml_text(data), probe, contact_stiffness=float(factor))
    section = 0.25 * np.pi * scene.particle.diameter**2
    rebound = 0.5 * s["particle_mass_kg"] * s["velocity_z_m_s"] ** 2
    return {
        "metal": scene.particle.material, "velocity_m_s": VELOCITY_NI, "springs_J_m2": round(energy[0] / section, 1),
        "rebound_J_m2": round(rebound / section, 1), "restitution": round(s["restitution"], 4), "steps": s["steps"],
    }  # fmt: skip


def profile() -> list[dict[str, object]]:
    """Means over the bonded area of each zone."""
    scene, probe = scene_of("Al1100", f"{SIZE_AL:g}", preset="standard"), Profile()
    compute(at_velocity(scene, VELOCITY_AL), probe)
    assert probe.values is not None
    radius, area, *fields = probe.values
    rows: list[dict[str, object]] = []
    for low, high in itertools.pairwise(ZONES):
        zone = (radius >= 0.5e-6 * SIZE_AL * low) & (radius < 0.5e-6 * SIZE_AL * high)
        if not area[zone].any():  # nothing has bonded there
            continue
        strength, flow, energy, clean = (float(np.average(field[zone], weights=area[zone])) for field in fields)
        rows.append({
            "metal": scene.particle.material, "diameter_um": SIZE_AL, "velocity_m_s": VELOCITY_AL, "preset": "standard",
            "zone_r_over_R": f"{low:g} to {high:g}", "clean_share": round(clean, 3), "strength_MPa": round(strength * 1e-6),
            "over_flow_stress": round(strength / flow, 2), "energy_J_m2": round(energy, 1),
        })  # fmt: skip
    return rows


def main() -> None:
    """Run what is missing."""
    remake = "python workflows/interface_probes.py"
    cases = ((preset, factor) for preset in ("draft", "standard") for factor in ("1", "8", "16"))
    fill(study_table("contact_springs", SPRINGS, SPRINGS[2:4], remake), cases, springs)
    profiles = study_table("bond_profile", PROFILE, PROFILE[4:5], remake)
    for line in () if profiles.rows else profile():
        print(profiles.add(line), flush=True)


if __name__ == "__main__":
    main()

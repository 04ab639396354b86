"""Where bonds lose their strength, and tension and jet at the edge of the contact: python workflows/interface_probes.py

springs: energy of the springs of the contact at the greatest deformation, and of the rebound, over their stiffness, without bonds.
losses: of the energy to tear the bonds in tension, what is lost while the contact presses, by its pressure, and after it has let go.
profile: strength of the bonds over the radius. edge: largest mean tension within D / 5 of the edge of the contact, and outward speed of
the particle's surface, over spacing and velocity. Impacts of workflows/critical_ni.toml, critical_cu.toml and critical_al.toml. Writes
docs/tables/contact_springs.csv, bond_losses.csv, bond_profile.csv and edge_tension.csv, whose rows are not computed again, and their
parts of the page on bonding; --docs only the page.
"""

import itertools
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bonding_energy import scene_of
from pages import PAGES, markdown, options, single_impact, study_table, versions, write_parts

from coupler import Scene, run
from coupler.geometry.triangles import vertex_areas
from coupler.impact.exchange import Impact
from coupler.impact.touching import softer_strength
from coupler.physics.adhesion import EXTRUSION
from coupler.progress import Progress
from coupler.studies.critical import at_velocity
from coupler.studies.sweep import toml_text
from coupler.studies.table import Row

PRESSURES = (0.0, 1.0 / 3.0, EXTRUSION)  # over the flow stress
LOSSES = ("metal", "velocity_m_s", "pressed_above_extrusion", "pressed_to_extrusion", "pressed_to_third", "let_go")
LOSS_CASES = (("ni", 10.0, 665.0), ("cu", 14.0, 610.0))
EDGE = ("metal", "diameter_um", "velocity_m_s", "spacing_um", "tension_GPa", "jet_over_velocity")
EDGE_CASES = tuple(("Ni", 10.0, v, h) for v in (250.0, 400.0, 660.0) for h in (0.806, 0.56, 0.4))
SPRINGS = (
    "metal",
    "velocity_m_s",
    "preset",
    "contact_stiffness",
    "springs_J_m2",
    "rebound_J_m2",
    "restitution",
    "steps",
)
SPRING_CASES = (
    *(("ni", 10.0, 665.0, preset, factor) for preset in ("draft", "standard") for factor in (1.0, 8.0, 16.0)),
)
PROFILE = (
    "metal",
    "diameter_um",
    "velocity_m_s",
    "preset",
    "zone_r_over_R",
    "clean_share",
    "strength_MPa",
    "over_flow_stress",
    "energy_J_m2",
)
PROFILE_CASES = (("al", 22.0, 1100.0, "standard"),)
ZONES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)  # of the particle's radius, at the greatest deformation
WINDOW = (0.1, 0.2)  # of D / v: the edge is free, the jet forms


def flow_stresses(impact: Impact) -> np.ndarray:
    """Flow stress (v,) Pa of the softer metal at the vertices of the particle's surface; infinite far from the target."""
    stresses = np.full(impact.surface.weights.shape[0], np.inf)
    near, facets = impact.contact.touching(len(stresses), 10.0 * impact.particle.spacing)
    stresses[near] = softer_strength(impact.domains, near, facets)
    return stresses


class Losses:
    """A probe: energy (J) to tear bonds in tension that each class of pressure has taken so far."""

    def __init__(self) -> None:
        self.taken = dict.fromkeys(LOSSES[2:], 0.0)
        self._damage: dict[int, float] = {}

    def __call__(self, impact: Impact) -> None:
        hold, contact, exposure = impact.hold, impact.contact, impact.exposure
        if hold is None or exposure is None:
            return
        bond, rows = hold.bond, hold.rows
        area = vertex_areas(impact.surface.positions(impact.particle.x), impact.surface.triangles)
        force = contact.stiffness * impact.surface.at_vertices(contact.depth)
        pressure = ((force + exposure._ring @ force) / (area + exposure._ring @ area))[rows]
        strength = flow_stresses(impact)
        before = np.array([min(self._damage.get(row, 0.0), now) for row, now in zip(rows, bond.damage, strict=True)])
        lost = bond.area * bond.energy[:, 0] * ((1.0 - before) ** 2 - bond.soundness)
        classes = 3 - np.searchsorted(PRESSURES, pressure / strength[rows], side="left")
        classes[bond.traction[:, 0] > 0.0] = 3
        for index, name in enumerate(self.taken):
            self.taken[name] += float(lost[classes == index].sum())
        self._damage = dict(zip(rows.tolist(), bond.damage, strict=True))


class Profile:
    """A probe: bonds by their radius, as they have formed by the end of the impact."""

    def __init__(self) -> None:
        self.values: tuple[np.ndarray, ...] | None = None

    def __call__(self, impact: Impact) -> None:
        hold, exposure = impact.hold, impact.exposure
        if impact.sinking > 0.0 or hold is None or exposure is None:
            return
        x, bond = impact.surface.positions(impact.particle.x)[hold.rows], hold.bond
        flow = flow_stresses(impact)[hold.rows]
        values = bond.strength[:, 0], flow, bond.energy[:, 0], exposure.clean[hold.rows, 0]
        self.values = np.hypot(x[:, 0], x[:, 1]), bond.area, *values


class Springs:
    """A probe: energy (J) of the contact's springs when the particle turns back."""

    def __init__(self) -> None:
        self.energy: float | None = None

    def __call__(self, impact: Impact) -> None:
        if self.energy is None and impact.sinking < 0.0:
            self.energy = impact.contact.penalty_energy


class Edge:
    """A probe: largest mean tension (Pa) near the edge of the contact and outward speed (m/s) of the surface, in the WINDOW."""

    def __init__(self, diameter: float, velocity: float):
        self.reach, self.crossing = 0.2 * diameter, diameter / velocity
        self.tension = self.speed = 0.0

    def __call__(self, impact: Impact) -> None:
        particle, surface, target = impact.particle, impact.surface, impact.target
        skin, v = surface.positions(particle.x), surface.values(particle.v)
        pressing = impact.contact.depth[: len(skin)] > 0.0
        if not WINDOW[0] <= impact.time / self.crossing < WINDOW[1] or not pressing.any():
            return
        r = np.hypot(skin[:, 0], skin[:, 1])
        edge, height = r[pressing].max(), skin[pressing, 2].max()
        self.speed = max(self.speed, float(((v[:, :2] * skin[:, :2]).sum(axis=1) / np.maximum(r, 1e-9)).max()))
        centres = target.x[target.mesh.conn].mean(axis=1)
        for x, stress in ((particle.x, particle.stress()), (centres, target.stress())):
            near = (np.abs(np.hypot(x[:, 0], x[:, 1]) - edge) < self.reach) & (np.abs(x[:, 2] - height) < self.reach)
            self.tension = max(self.tension, float(stress[near, :3].mean(axis=1).max(initial=0.0)))


def compute(text: str, probe: Callable[[Impact], None], **numerics: float) -> dict[str, Any]:
    """The values of the run of a scene."""
    with tempfile.TemporaryDirectory() as place:
        scene, quiet = Scene.from_text(text, "probe"), Progress(quiet=True)
        return dict(run(scene, Path(place) / "run", threads=1, probe=probe, progress=quiet, numerics=numerics).values)


def springs(name: str, size: float, velocity: float, preset: str, factor: float) -> dict[str, object]:
    """One impact without bonds; energies over the section of the particle."""
    scene, probe = scene_of(name, size, preset=preset), Springs()
    data = tomllib.loads(at_velocity(scene, velocity)) | {"adhesion": {"kind": "none"}}
    s = compute(toml_text(data), probe, contact_stiffness=factor)
    section = 0.25 * np.pi * scene.particle.diameter**2
    rebound = 0.5 * s["particle_mass_kg"] * s["velocity_z_m_s"] ** 2
    values = (
        scene.particle.material, velocity, preset, factor, round((probe.energy or 0.0) / section, 1), round(rebound / section, 1),
        round(s["restitution"], 4), s["steps"],
    )  # fmt: skip
    return dict(zip(SPRINGS, values, strict=True))


def springs_page(rows: list[Row]) -> list[str]:
    """Energy of the springs and of the rebound, by preset and stiffness."""
    lines = [
        [f"{row['metal']}, {float(row['velocity_m_s']):g} m/s", row["preset"], f"{float(row['contact_stiffness']):g}",
         f"{row['springs_J_m2']} J/m2", f"{row['rebound_J_m2']} J/m2", row["restitution"], row["steps"]] for row in rows
    ]  # fmt: skip
    return [
        *markdown("without bonds | preset | stiffness | springs | rebound | restitution | steps", lines),
        "",
        versions(rows),
    ]


def losses(name: str, size: float, velocity: float) -> dict[str, object]:
    scene, probe = scene_of(name, size, preset="standard"), Losses()
    compute(at_velocity(scene, velocity), probe)
    total = sum(probe.taken.values())
    shares = (round(value / total, 3) for value in probe.taken.values())
    return dict(zip(LOSSES, (scene.particle.material, velocity, *shares), strict=True))


def profile(name: str, size: float, velocity: float, preset: str) -> list[dict[str, object]]:
    """Means over the bonded area of each zone."""
    scene, probe = scene_of(name, size, preset=preset), Profile()
    compute(at_velocity(scene, velocity), probe)
    assert probe.values is not None
    radius, area, *fields = probe.values
    rows = []
    for low, high in itertools.pairwise(ZONES):
        zone = (radius >= 0.5e-6 * size * low) & (radius < 0.5e-6 * size * high)
        if not area[zone].any():  # nothing has bonded there
            continue
        strength, flow, energy, clean = (float(np.average(field[zone], weights=area[zone])) for field in fields)
        values = (
            scene.particle.material, size, velocity, preset, f"{low:g} to {high:g}", round(clean, 3),
            round(strength * 1e-6), round(strength / flow, 2), round(energy, 1),
        )  # fmt: skip
        rows.append(dict(zip(PROFILE, values, strict=True)))
    return rows


def profile_page(rows: list[Row]) -> list[str]:
    """Strength of the bonds over the radius, a line for each run."""
    lines = []
    for key, zones in itertools.groupby(rows, key=lambda row: (row["metal"], row["velocity_m_s"], row["preset"])):
        own = {row["zone_r_over_R"]: f"{row['strength_MPa']} MPa ({row['over_flow_stress']})" for row in zones}
        cells = [own.get(f"{low:g} to {high:g}", "-") for low, high in itertools.pairwise(ZONES)]
        lines.append([f"{key[0]}, {float(key[1]):g} m/s, {key[2]}", *cells])
    head = ["r / R", *(f"{low:g} to {high:g}" for low, high in itertools.pairwise(ZONES))]
    return [*markdown(head, lines), "", versions(rows)]


def edge(metal: str, size: float, velocity: float, spacing: float) -> dict[str, object]:
    """One impact on the same metal up to 0.25 D / v."""
    probe = Edge(size * 1e-6, velocity)
    text = f'preset = "draft"\n{single_impact(metal, size, velocity, metal)}diameter = "{4 * size} um"\nheight = "{2 * size} um"\n'
    text += f'[resolution]\nspacing = "{spacing} um"\nelement_size = "{1.25 * spacing} um"\n[adhesion]\nkind = "none"\n'
    compute(text + f'[end]\ntime = "{0.25e3 * size / velocity} ns"\n', probe)
    values = metal, size, velocity, spacing, round(probe.tension * 1e-9, 2), round(probe.speed / velocity, 3)
    return dict(zip(EDGE, values, strict=True))


def main() -> None:
    """Run what is missing and write the parts of the page."""
    a = options(__doc__ or "", "docs")
    remake = "python workflows/interface_probes.py"
    lost, edges = (
        study_table("bond_losses", LOSSES, LOSSES[:2], remake),
        study_table("edge_tension", EDGE, EDGE[:4], remake),
    )
    for case in LOSS_CASES if not a.docs else ():
        if not any(float(row["velocity_m_s"]) == case[2] for row in lost.rows):
            print(lost.add(losses(*case)), flush=True)
    held = study_table("contact_springs", SPRINGS, SPRINGS[:4], remake)
    computed = {(row["preset"], float(row["contact_stiffness"])) for row in held.rows}
    for of_springs in SPRING_CASES if not a.docs else ():
        if of_springs[3:] not in computed:
            print(held.add(springs(*of_springs)), flush=True)
    profiles = study_table("bond_profile", PROFILE, PROFILE[:5], remake)
    for run_of in PROFILE_CASES if not a.docs else ():
        if not any(row["preset"] == run_of[3] and float(row["velocity_m_s"]) == run_of[2] for row in profiles.rows):
            for line in profile(*run_of):
                print(profiles.add(line), flush=True)
    known = {(row["metal"], *(float(row[key]) for key in EDGE[1:4])) for row in edges.rows}
    for place in EDGE_CASES if not a.docs else ():
        if place not in known:
            print(edges.add(edge(*place)), flush=True)
    head = "lost of the energy in tension | above $p_E$ | $\\sigma_0 / 3$ to $p_E$ | 0 to $\\sigma_0 / 3$ | let go"
    cells = [
        [f"{row['metal']}, {float(row['velocity_m_s']):g} m/s", *(f"{float(row[name]):.1%}" for name in LOSSES[2:])]
        for row in lost.rows
    ]
    spacings = sorted({float(row["spacing_um"]) for row in edges.rows}, reverse=True)
    lines = []
    for velocity in sorted({float(row["velocity_m_s"]) for row in edges.rows}):
        own = {float(row["spacing_um"]): row for row in edges.rows if float(row["velocity_m_s"]) == velocity}
        cell = [f"{own[h]['tension_GPa']} GPa, {own[h]['jet_over_velocity']}" if h in own else "-" for h in spacings]
        lines.append([f"{velocity:g} m/s", *cell])
    parts = {
        "losses": [*markdown(head, cells), "", versions(lost.rows)],
        "springs": springs_page(held.rows),
        "profile": profile_page(profiles.rows),
        "edge": [
            *markdown(["tension, jet / velocity", *(f"{h:g} um" for h in spacings)], lines),
            "",
            versions(edges.rows),
        ],
    }
    write_parts(PAGES["bonding"], parts)


if __name__ == "__main__":
    main()

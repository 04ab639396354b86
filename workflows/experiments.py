"""Single impacts that others have measured, computed with every strength set of the library: python workflows/experiments.py

    python workflows/experiments.py --only restitution     # of: restitution, band, fine, splats, aluminium
    python workflows/experiments.py --docs                 # runs nothing: the page and its figure from the tables

The measurements, readings, bands and suspects are in measurements.toml. Each run is a row of docs/tables/restitution_sets.csv,
splats_4340.csv or aluminium.csv that is not computed again. Nothing is fitted.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pages import computed, drawing, impact_tables, markdown, options, versions, with_error, write_parts
from study_table import Row, column, measurements, number, study, table_rows

from coupler import Scene
from coupler.physics.materials import entry, material
from coupler.physics.strength import HARDNESS_OVER_FLOW_STRESS, STRAIN_OF_INDENT

REBOUND, SPLAT, ALUMINIUM = measurements("rebound"), measurements("splat"), measurements("aluminium")
METALS = tuple(name for name, value in REBOUND.items() if isinstance(value, dict))
PRESETS = ("draft", "standard")
STIFFNESS = (0.5, 2.0)  # factors on the contact stiffness, for the band
COLOURS = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9"  # of strength sets
PROBED = {"Ni": (310, 473), "OFHC_Cu": (315, 489)}  # m/s, where the band is computed
KEY = ("metal", "set", "velocity_m_s", "preset", "contact_stiffness")
Key = tuple[str, str, str, str, str]
SUSPECTS = {(name, f"{v:g}"): change for name, change in ALUMINIUM["suspects"].items() for v, _ in ALUMINIUM["e"]} | {
    (f"{name}, bonds", f"{v:g}"): change for name, change in ALUMINIUM["bonds"].items() for v in ALUMINIUM["bonded_m_s"]
}
BONDED = {"adhesion": {"kind": "cohesive", "criterion": "exposure"}}  # of the suspects with bonds


def in_window(velocity: float) -> bool:
    """Whether a velocity (m/s) counts in the mean error."""
    low, high = REBOUND["window_m_s"]
    return bool(low <= velocity <= high)


def first_set(metal: str) -> str:
    """The strength set of a metal that is used unless another is named."""
    return next(iter(entry(metal).sets))


def rebounds(preset: str) -> list[Key]:
    """All measured velocities with all sets, those of the window first."""
    found = [(metal, name, v) for metal in METALS for name in entry(metal).sets for v, _ in REBOUND[metal]["e"]]
    found.sort(key=lambda each: not in_window(each[2]))
    return [(metal, name, f"{v:g}", preset, "1") for metal, name, v in found]


def fine() -> list[Key]:
    """Keys of the velocities in the window at `standard`, the first set of each metal first."""
    keys = [key for key in rebounds("standard") if in_window(float(key[2]))]
    return sorted(keys, key=lambda key: key[1] != first_set(key[0]))


def band() -> list[Key]:
    """A softer and a stiffer contact, with the first set."""
    probed = [(metal, v, factor) for metal, speeds in PROBED.items() for v in speeds for factor in STIFFNESS]
    return [(metal, first_set(metal), f"{v:g}", "draft", f"{factor:g}") for metal, v, factor in probed]


def splats() -> list[Key]:
    """Single particles on 4340 at the mean velocity, with all sets of the metals named."""
    sets = [(metal, name) for metal in SPLAT["computed"] for name in entry(metal).sets]
    return [(metal, name, f"{SPLAT['velocity_m_s']:g}", "draft", "1") for metal, name in sets]


def scene_of(metal: str, strength: str, velocity: float, diameter: float, target: str, preset: str = "draft") -> Scene:
    """An impact on a target 6 diameters wide and 3 deep. velocity: m/s; diameter: um; strength: set of the metal."""
    tables = impact_tables(metal, diameter, velocity, target, (6.0 * diameter, 3.0 * diameter))
    tables["substrate"]["bottom"] = "absorbing"
    more = {"adhesion": {"kind": "none"}, "materials": {metal: {"strength": strength}}}
    return Scene.from_dict({"preset": preset, **tables, **more}, "experiment")


def row_of(
    metal: str, strength: str, velocity: str, preset: str, stiffness: str, splat: bool = False
) -> dict[str, object]:
    """The run of a key as a row of the table; splat: on 4340, else on its own metal."""
    v = float(velocity)
    D = float(np.mean(SPLAT["diameter_um"])) if splat else REBOUND[metal]["diameter_um"]
    target = SPLAT["target"] if splat else metal
    scene = scene_of(metal, strength, v, D, target, preset)
    numerics = {} if stiffness == "1" else {"contact_stiffness": float(stiffness)}
    with computed(scene, numerics=numerics, error=splat) as (result, cpu):  # the error of a splat is on the page
        s = result.values
    flattening_band = (s.get("errors") or {}).get("flattening_ratio_total", {}).get("half_width")
    return {
        "target": target, "diameter_um": D,
        "engine": scene.resolution.engine, "restitution": s["rebound_velocity_m_s"] / v,
        "rebound_m_s": s["rebound_velocity_m_s"], "flattening": s["flattening_ratio_total"], "flattening_band": flattening_band,
        "splat_diameter_um": s["splat_diameter_m"] * 1e6, "thickness_um": s["thickness_m"] * 1e6,
        "crater_um": s["crater_depth_m"] * 1e6, "T_max_K": s["T_max_K"], "numerical_share": s["numerical_dissipation"],
        "drift": s["energy_drift"], "cpu_s": cpu,
    }  # fmt: skip


def suspect_row(suspect: str, velocity: str) -> dict[str, object]:
    """The rebound of aluminium with one suspect, without bonds at draft, or with bonds at standard. velocity: m/s."""
    change, v, D = dict(SUSPECTS[suspect, velocity]), float(velocity), ALUMINIUM["diameter_um"]
    bonded = suspect.endswith(", bonds")
    preset, strength, stiffness = ("standard", "Hassani_2016", 8.0) if bonded else ("draft", "Pierazzo_2008", 1.0)
    stiffness = change.pop("contact_stiffness", stiffness)
    usual = scene_of("Al1100", strength, v, D, "Al1100", preset)
    scene = usual.with_(**BONDED if bonded else {}).with_(**change)
    with computed(scene, numerics={"contact_stiffness": stiffness}, error=False) as (result, cpu):
        s = result.values
    return {
        "restitution": (s["rebound_velocity_m_s"] or 0.0) / v, "margin_J": s["margin_J"],
        "flattening": s["flattening_ratio_total"], "T_max_K": s["T_max_K"], "numerical_share": s["numerical_dissipation"], "cpu_s": cpu,
    }  # fmt: skip


def chosen(rows: Sequence[Row], **values: str) -> list[Row]:
    """Rows with these values, by velocity, without failed ones."""
    own = [row for row in rows if not row["failed"] and all(row[name] == value for name, value in values.items())]
    return sorted(own, key=lambda row: number(row, "velocity_m_s"))


def curve(rows: Sequence[Row], metal: str, name: str, preset: str) -> tuple[NDArray, NDArray]:
    """Velocities (m/s) and restitution of a set at a resolution, with the usual contact."""
    own = chosen(rows, metal=metal, set=name, preset=preset, contact_stiffness="1")
    return column(own, "velocity_m_s"), column(own, "restitution")


def errors(rows: Sequence[Row], metal: str, name: str, preset: str) -> tuple[float, float, int]:
    """Root mean square and mean of computed less measured restitution over the window, and the number of velocities."""
    computed = dict(zip(*curve(rows, metal, name, preset), strict=True))
    off = np.array([computed[v] - e for v, e in REBOUND[metal]["e"] if in_window(v) and v in computed])
    return (float(np.sqrt((off**2).mean())), float(off.mean()), len(off)) if len(off) else (math.nan, math.nan, 0)


def band_of(rows: Sequence[Row], metal: str) -> float:
    """Half-width of the error of the restitution of a metal due to the discretisation, by the rule in measurements.toml."""
    first = first_set(metal)
    coarse, standard = (dict(zip(*curve(rows, metal, first, preset), strict=True)) for preset in PRESETS)
    points = [abs(standard[v] - coarse[v]) for v in standard if v in coarse and in_window(v)]
    stiffness = []
    for v in PROBED[metal]:
        at_v = {"metal": metal, "set": first, "velocity_m_s": f"{v:g}"}
        pair = [chosen(rows, **at_v, contact_stiffness=f"{factor:g}") for factor in STIFFNESS]
        if all(pair):
            stiffness.append(0.5 * abs(number(pair[1][0], "restitution") - number(pair[0][0], "restitution")))
    return math.hypot(max(points, default=0.0), max(stiffness, default=0.0)) or math.nan


def restitution_part(rows: Sequence[Row]) -> list[str]:
    """Mean errors of each set over the window, and the band of the discretisation."""
    lines = []
    for metal in METALS:
        for name in entry(metal).sets:
            rms, mean, _ = errors(rows, metal, name, PRESETS[-1])
            lines.append([metal, name, f"{rms:.3f} ({mean:+.3f})"])
    bands = ", ".join(f"{metal} ± {band_of(rows, metal):.3f}" for metal in METALS)
    table = markdown("metal | strength set | rms (mean)", lines)
    return [*table, "", f"Error of the discretisation: {bands}.", "", versions(rows)]


def splat_ratio(row: Row) -> float:
    """(d0 - h) / d0 with d0 = (w^2 h)^(1/3), width w and height h of the splat, as measured."""
    w, h = number(row, "splat_diameter_um"), number(row, "thickness_um")
    return 1.0 - float(h / (w * w * h) ** (1 / 3))


def splat_part(rows: Sequence[Row]) -> list[str]:
    """Flattening of splats on 4340 by hardness: computed with each strength set (hardness by Tabor), and measured for each powder."""
    done = [row for row in rows if not row["failed"]]
    lines = []
    for row in done:
        flow = material(row["metal"], row["set"]).flow_stress(STRAIN_OF_INDENT, 0.0, 293.0)
        ratio = with_error(splat_ratio(row), number(row, "flattening_band"), 2)
        lines.append([f"{HARDNESS_OVER_FLOW_STRESS * flow / 1e9:.2f}", f"{row['metal']} ({row['set']})", ratio, ""])
    for name, (hardness, error) in SPLAT["nanohardness_GPa"].items():
        mean, scatter = SPLAT["measured"][name]
        lines.append([f"{hardness:.2f} ± {error:.2f}", f"powder {name}", "", f"{mean:.2f} ± {scatter:.2f}"])
    return markdown("hardness, GPa | metal | computed | measured", sorted(lines), done)


def suspects_part(rows: Sequence[Row]) -> list[str]:
    """A row for each suspect of aluminium: restitution without bonds, and the margin with bonds."""
    found = {(row["suspect"], row["velocity_m_s"]): row for row in rows}
    speeds, bonded = [f"{v:g}" for v, _ in ALUMINIUM["e"]], [f"{v:g}" for v in ALUMINIUM["bonded_m_s"]]
    lines = [["measured", *(f"{e:.3f}" for _, e in ALUMINIUM["e"])]]
    for name in ALUMINIUM["suspects"]:
        lines.append([name, *(f"{number(found[name, v], 'restitution'):.3f}" for v in speeds)])
    margins = []
    for name in ALUMINIUM["bonds"]:
        margins.append([name, *(f"{number(found[f'{name}, bonds', v], 'margin_J') * 1e9:+.1f}" for v in bonded)])
    head = ["restitution", *(f"{v} m/s" for v in speeds)]
    second = ["margin to stick, nJ", *(f"{v} m/s" for v in bonded)]
    return [*markdown(head, lines), "", *markdown(second, margins, rows)]


def draw(rows: Sequence[Row]) -> None:
    """Draw the restitution against velocity, measured and with every strength set, with the errors of both."""
    with drawing("restitution_sets", 11.0, 5.6) as figure:
        for left, metal in zip((0.07, 0.56), METALS, strict=True):
            axis, half = figure.add_axes((left, 0.3, 0.42, 0.65)), band_of(rows, metal)
            v, e = np.array(REBOUND[metal]["e"]).T
            axis.errorbar(
                v, e, REBOUND["e_error"], v * REBOUND["velocity_error"], fmt="ks", ms=4, lw=1, label="measured"
            )
            for name, colour in zip(entry(metal).sets, COLOURS, strict=False):
                for preset, style in zip(PRESETS, ("o:", "o-"), strict=True):
                    x, y = curve(rows, metal, name, preset)
                    face = "none" if preset == "draft" else colour
                    axis.plot(x, y, style, color=colour, ms=4, lw=1.2, label=f"{name}, {preset}", mfc=face)
                if len(x) and math.isfinite(half):
                    axis.fill_between(x, y - half, y + half, color=colour, alpha=0.08, lw=0)
            axis.axvline(REBOUND[metal]["critical_velocity_m_s"], color="0.5", lw=1, ls="--")
            axis.axvspan(*REBOUND["window_m_s"], color="0.95", zorder=0)
            axis.set(xlabel="velocity of impact (m/s)", ylabel="coefficient of restitution", ylim=(0, None))
            axis.set_title(f"{metal}, {REBOUND[metal]['diameter_um']:g} µm", fontsize=10)
            axis.legend(fontsize=6.5, ncols=3, columnspacing=1.0, loc="upper center", bbox_to_anchor=(0.5, -0.13))


PARTS = {  # name: table, keys
    "restitution": ("restitution_sets", partial(rebounds, "draft")), "band": ("restitution_sets", band),
    "splats": ("splats_4340", splats), "fine": ("restitution_sets", fine),
}  # fmt: skip


if __name__ == "__main__":
    a = options(__doc__, "docs", only=[*PARTS, "aluminium"])
    for part in () if a.docs else a.only:
        if part == "aluminium":
            study("aluminium", ("suspect", "velocity_m_s"), SUSPECTS, suspect_row)
        else:
            name, keys = PARTS[part]
            study(name, KEY, keys(), partial(row_of, splat=part == "splats"), may_fail=True)
    rebound, splat = table_rows("restitution_sets"), table_rows("splats_4340")
    draw(rebound)
    parts = {"restitution": restitution_part(rebound), "splats": splat_part(splat)}
    write_parts("experiments", {**parts, "aluminium": suspects_part(table_rows("aluminium"))})

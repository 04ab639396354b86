"""Rebound of pure aluminium, one suspect at a time: python workflows/aluminium.py

The measured values, the suspects and their numbers are in workflows/measurements.toml, [aluminium]. Each run is a row of
docs/tables/aluminium.csv that is not computed again. --docs runs nothing.
"""

from pages import computed, fill, markdown, measurements, number, options, study_table, table_rows, write_parts

from coupler import Scene

KNOWN = measurements("aluminium")
KEY = ("suspect", "velocity_m_s")
COLUMNS = (*KEY, "restitution", "margin_J", "flattening", "T_max_K", "numerical_share", "cpu_s")
SCENE = """
preset = "{preset}"
effects = {effects}
[particle]
material = "Al1100"
diameter = "{D:g} um"
velocity = "{v:g} m/s"
[substrate]
material = "Al1100"
diameter = "{W:g} um"
height = "{H:g} um"
bottom = "absorbing"
[contact]
friction = {friction}
[adhesion]
{adhesion}
[materials.Al1100]
strength = "{set}"
{numbers}
"""
USUAL = {
    "preset": "draft", "effects": '"auto"', "D": 14.0, "friction": 0.5, "set": "Pierazzo_2008", "numbers": "",
    "adhesion": 'kind = "none"', "stiffness": 1.0,
}  # fmt: skip
BONDED = {
    "preset": "standard", "set": "Hassani_2016", "adhesion": 'kind = "cohesive"\ncriterion = "exposure"', "stiffness": 8.0,
}  # fmt: skip
CASES = {(name, f"{v:g}"): change for name, change in KNOWN["suspects"].items() for v, _ in KNOWN["e"]} | {
    (f"{name}, bonds", f"{v:g}"): BONDED | change
    for name, change in KNOWN["bonds"].items()
    for v in KNOWN["bonded_m_s"]
}


def row_of(suspect: str, velocity: str) -> dict[str, object]:
    """The run of a case. velocity: m/s."""
    values, v = USUAL | CASES[suspect, velocity], float(velocity)
    scene = Scene.from_text(SCENE.format(**values, v=v, W=6 * values["D"], H=3 * values["D"]))
    with computed(scene, numerics={"contact_stiffness": values["stiffness"]}, error=False) as (result, cpu):
        s = result.values
    return {
        "restitution": (s["rebound_velocity_m_s"] or 0.0) / v, "margin_J": s["margin_J"],
        "flattening": s["flattening_ratio_total"], "T_max_K": s["T_max_K"], "numerical_share": s["numerical_dissipation"], "cpu_s": cpu,
    }  # fmt: skip


def part() -> list[str]:
    """A row of the page for each suspect, without and with bonds."""
    rows = table_rows("aluminium")
    found = {(row["suspect"], row["velocity_m_s"]): row for row in rows}
    speeds, bonded = [f"{v:g}" for v, _ in KNOWN["e"]], [f"{v:g}" for v in KNOWN["bonded_m_s"]]
    lines = [["measured", *(f"{e:.3f}" for _, e in KNOWN["e"])]]
    lines += [[name, *(f"{number(found[name, v], 'restitution'):.3f}" for v in speeds)] for name in KNOWN["suspects"]]
    margins = [
        [name, *(f"{number(found[f'{name}, bonds', v], 'margin_J') * 1e9:+.1f}" for v in bonded)]
        for name in KNOWN["bonds"]
    ]
    head = ["restitution", *(f"{v} m/s" for v in speeds)]
    second = ["margin to stick, nJ", *(f"{v} m/s" for v in bonded)]
    return [*markdown(head, lines), "", *markdown(second, margins, rows)]


def main() -> None:
    """Run what is missing, write the page."""
    a = options(__doc__, "docs")
    table = study_table("aluminium", COLUMNS, KEY, "python workflows/aluminium.py")
    fill(table, () if a.docs else CASES, row_of)
    write_parts("experiments", {"aluminium": part()})


if __name__ == "__main__":
    main()

"""Table and sentence of the page of the nickel map, from docs/tables/map_ni.csv: python workflows/map_page.py"""

from pages import markdown, versions, write_parts
from study_table import number, table_rows

from coupler.studies.maps import interpolate

AXES = ("velocity_m_s", "diameter_m")
# Measure -> name, digits. Lengths are divided by the diameter.
SHOWN = {
    "flattening_ratio": ("flattening", 2), "crater_depth_m": ("crater / diameter", 2), "T_p99_K": ("temperature of 99 %, K", 0),
    "restitution": ("rebound / impact velocity", 3),
}  # fmt: skip


if __name__ == "__main__":
    rows = [row for row in table_rows("map_ni") if row["status"] == "done"]
    at = {tuple(number(row, axis) for axis in AXES): row for row in rows}
    speeds, sizes = (sorted({place[k] for place in at}) for k in (0, 1))
    lines = []
    for v in speeds:
        line = [f"{v:.0f}"]
        for name, (_, places) in SHOWN.items():
            cells = []
            for D in (sizes[0], sizes[-1]):
                value = number(at[v, D], name) / (D if name.endswith("_m") else 1.0)
                cells.append(f"{value:.{places}f}" if at[v, D][name] else at[v, D]["verdict"])
            line.append("/".join(cells))
        lines.append(line)
    texts = []
    for name in ("flattening_ratio", "T_p99_K"):
        values = [{"status": "done", **{key: number(row, key) for key in (*AXES, name)}} for row in rows]
        found = interpolate(values, name, AXES)  # type: ignore[arg-type]
        texts.append(f"{found.loo_rms:.2g} of a spread of {found.spread:.3g} in {SHOWN[name][0]}")
    told = f"Error of the interpolation, one point left out (root mean square): {'; '.join(texts)}."
    head = ["velocity, m/s", *(text for text, _ in SHOWN.values())]
    write_parts("maps", {"map": [*markdown(head, lines), "", told, "", versions(rows)]})

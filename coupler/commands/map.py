"""The command `coldspray map`: the table of a parameter sweep, and maps of its measures with their uncertainty."""

import argparse
from typing import Any

from ..errors import StoreError
from ..files.inputs import reading
from ..files.outputs import MARK, check_folder, claim_file, kind_of
from .arguments import Commands, add_command, add_force, path, working

QUANTITIES = (
    "flattening_ratio", "T_p99_K", "restitution", "velocity_ratio", "T_mean_K", "eps_p_mean", "crater_depth_m", "splat_diameter_m",
    "rebound_velocity_m_s", "bonded_area_end_m2", "numerical_dissipation",
)  # fmt: skip
DRAWN = QUANTITIES[:4]


def add(commands: Commands) -> None:
    option = add_command(commands, "map", run, "draw maps of the results of a sweep, or of any folder with runs")
    text = "folder of a sweep, finished or not, or any folder with folders of runs"
    option("folder", type=path, metavar="DIR", help=text)
    option("--show", nargs="+", choices=QUANTITIES, default=DRAWN, metavar="QUANTITY",
           help=f"measures to draw: {', '.join(QUANTITIES)} (default: {', '.join(DRAWN)})")  # fmt: skip
    option("--axes", nargs="+", default=(), metavar="KEY",
           help="keys of the scene, such as particle.velocity contact.friction (default: those of velocity, diameter and"
           " temperature that vary)")  # fmt: skip
    option("--refine", type=int, default=0, metavar="N",
           help="first compute N new points, one after another, where the first quantity is least certain")  # fmt: skip
    add_force(option)
    option("--out", type=path, metavar="DIR", help="folder for map.csv and pictures (default: the folder of the runs)")


def run(arguments: argparse.Namespace) -> int:
    from ..studies import map_figures, maps, runs_table

    if kind_of(arguments.folder) == "run":
        raise StoreError(f"{arguments.folder} is the folder of a single run: give a folder that holds several runs")
    if arguments.refine < 0:
        raise StoreError(f"--refine {arguments.refine}: give the number of points to compute, zero or more")
    rows, axes = _table(arguments)
    for done in range(arguments.refine):
        # each material has its own map
        names = dict.fromkeys(row["material"] for row in rows if row["status"] == "done")
        own = [[row for row in rows if row["material"] == name] for name in names] or [rows]
        points = [(maps.best_point(each, arguments.show[0], axes)[0], each) for each in own]
        open_ = [(point, each) for point, each in points if point.at]
        if not open_:
            print(f"there is no new point to compute: {points[0][0].why}")
            break
        point, of_material = open_[done % len(open_)]
        of = f"{of_material[0]['material']}: " if len(own) > 1 else ""
        print(f"running {done + 1} of {arguments.refine}: {of}{point.words}", flush=True)
        maps.run_next(arguments.folder, of_material, point.at)
        rows, axes = _table(arguments)
    out = arguments.out or arguments.folder
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    for name in ("map.csv", *(drawn.name for drawn in out.glob("map_*.png"))):
        claim_file(out / name, (".csv", ".png"), force=arguments.force)
    print(f"{len(rows)} points: " + ", ".join(f"{n} {status}" for status, n in runs_table.counts(rows).items()))
    kinds = {kind: len(own) for kind, own in map_figures.by_verdict(rows).items() if own}
    kinds.pop(map_figures.NO_VALUE, None)
    if kinds:
        print("verdicts: " + ", ".join(f"{kind} {n}" for kind, n in kinds.items()))
    for row in rows:
        if row["status"] != "done":
            print(f"  {row['point']}: {row['status']}" + (f": {row['reason'][:160]}" if row["reason"] else ""))
    with working("interpolating and drawing"):
        lines = map_figures.draw(rows, out, arguments.show, axes)
    print("\n".join(lines))
    # the table is written last: if it exists, all pictures exist
    runs_table.write_table(rows, out / "map.csv", f"{MARK} map; SI units", axes)
    print(f"table in {out / 'map.csv'}")
    return 0


def _table(arguments: argparse.Namespace) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    from ..studies import runs_table

    with reading(arguments.folder), working("reading the runs"):
        rows = runs_table.table(arguments.folder)
        return rows, runs_table.add_axes(rows, arguments.axes)

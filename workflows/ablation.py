"""What each remedy against short time steps is worth: runs with it switched off, one remedy at a time.

    python workflows/ablation.py             # docs/tables/ablation.csv and its part of the stability page (half an hour)
    python workflows/ablation.py --docs      # runs nothing: from the table that exists

A remedy is switched off where it can act. Rows are compared by steps: their processor times (in the table) are of a busy machine. Each
run is a process of its own, in one thread; rows in the table are not computed again.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pages import PAGES, ROOT, markdown, marked, number, options, study_table, table_rows, versions, write_parts

from coupler.studies.table import Row

COLUMNS = ("case", "without", "end", "steps", "dt_mean_ps", "flattening", "crater_um", "drift", "cpu_s", "why")
KEY = ("case", "without")
NOTHING = "nothing"
COATING, TRIPLE, FAST = "coating of 12", "three Ni, 500 to 610 m/s", "Ni at 1000 m/s"
BATTERY = (
    "Hard on Soft, 1200 m/s", "Ni on Al, 1250 m/s", "SS304 on Al, 1000 m/s", "Softest on Hard, 300 m/s",
    "Cu at 45 degrees on the rim of a Ni splat, 700 m/s", "Al on 42CrMo4, 1250 m/s", "Ni at 1639 K on SS304 at 300 K, 500 m/s",
)  # fmt: skip
SOFT_TARGETS, ON_A_SPLAT, RETRIED = BATTERY[:3], BATTERY[4:5], BATTERY[5:]
PATIENCE = {FAST: 60.0, TRIPLE: 120.0, COATING: 500.0, **dict.fromkeys(BATTERY, 120.0)}  # s of processor time
WHERE = {
    NOTHING: (FAST, TRIPLE, *BATTERY, COATING),
    "shape stress": (FAST, TRIPLE, *SOFT_TARGETS),
    "mesh frequency": (FAST, TRIPLE, *BATTERY[:4], COATING),
    "inactive elements": (FAST, TRIPLE, COATING),
    "mass scaling": (TRIPLE, *ON_A_SPLAT, COATING),
    "window": (COATING,),
    "retry": RETRIED,
}


def scene_of(case: str, without: str) -> dict[str, Any]:
    """The scene of a case, as nested tables; what a scene can switch off is off."""
    import stability

    from coupler.files.inputs import read_toml

    if case in BATTERY:
        data = dict(stability.battery()[case])
    else:
        name = {FAST: "fast_ni", TRIPLE: "triple_ni", COATING: "coating_ni"}[case]
        data = {**read_toml(ROOT / "workflows" / f"{name}.toml"), "preset": "draft"}
    if case == COATING:
        data["coating"] = {**data["coating"], "number": 12, "layers": 4, "radius": "18 um"}
    if without == "mass scaling":
        data["splat"] = {**data.get("splat", {}), "mass_scaling": 0.0}
    if without == "window":
        data["substrate"] = {**data["substrate"], "window": "100 um"}  # all of it
    return data


def no_shape_stress() -> None:
    import coupler.fe.kernels as kernels

    kernels.SHAPE_STIFFNESS = 0.0
    import coupler.fe.stability as stability

    stability.SHAPE_STIFFNESS = 0.0


def no_mesh_frequency() -> None:
    from coupler.fe.stability import HighestFrequency

    HighestFrequency.longest_step = lambda self, t, bound, n, m, springs=None: bound  # type: ignore[method-assign]


def no_inactive_elements() -> None:
    from coupler.fe.explicit import Target

    original: Callable[..., None] = Target.__init__
    Target.__init__ = lambda self, *a, **k: original(self, *a, **{**k, "track_wave": False})  # type: ignore[method-assign]


def no_retry() -> None:
    from coupler.impact import retry

    retry.REMEDIES = ()


SWITCHES = {
    "shape stress": no_shape_stress, "mesh frequency": no_mesh_frequency, "inactive elements": no_inactive_elements,
    "retry": no_retry,
}  # fmt: skip


def compute(case: str, without: str) -> None:
    """Run one case in this process; its row as JSON, in the last line of the output."""
    import json
    import time

    SWITCHES.get(without, lambda: None)()
    import stability

    from coupler import Scene, run
    from coupler.errors import ColdsprayError
    from coupler.progress import Progress

    row: dict[str, object] = {"case": case, "without": without}
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            scene = Scene.from_dict(scene_of(case, without), "ablation")
            result = run(
                scene,
                Path(folder) / "run",
                progress=Progress(quiet=True),
                threads=1,
                probe=stability.deadline(PATIENCE[case]),
            )
        except stability.Slow as error:
            row |= {"end": "no end", "why": str(error)}
        except ColdsprayError as error:
            row |= {"end": "gives up", "why": " ".join(str(error).split())[:160]}
        else:
            impacts = result.summary["impacts"]
            steps = sum(impact["steps"] for impact in impacts)
            simulated = sum(impact["end"]["time_s"] or 0.0 for impact in impacts)
            retries = sum(len(impact.get("retries") or ()) for impact in impacts)
            row |= {
                "end": result.undecided or "finished", "steps": steps, "dt_mean_ps": 1e12 * simulated / steps,
                "flattening": impacts[-1]["end"]["flattening_ratio"], "crater_um": 1e6 * (impacts[-1]["end"]["crater_depth_m"] or 0.0),
                "drift": result.energy_drift, "why": f"{retries} retries" if retries else "",
            }  # fmt: skip
    print(json.dumps(row | {"cpu_s": time.process_time() - start}))


def study() -> None:
    """Compute the rows that the table lacks."""
    import json

    table = study_table("ablation", COLUMNS, KEY, "python workflows/ablation.py")
    kept = tempfile.mkdtemp()  # kernels without the shape stress are others under the same names
    for without, cases in WHERE.items():
        for case in cases:
            if (case, without) in table:
                continue
            environment = {**os.environ, **({"NUMBA_CACHE_DIR": kept} if without == "shape stress" else {})}
            command = [sys.executable, __file__, "--case", case, "--without", without]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            print(table.add(json.loads(done.stdout.splitlines()[-1])), flush=True)


def part() -> list[str]:
    """Each remedy against the same run with all of them."""
    rows = {(row["case"], row["without"]): row for row in table_rows("ablation")}

    def ratio(row: Row, name: str) -> str:
        whole = rows.get((row["case"], NOTHING))
        return f"{number(row, name) / number(whole, name):.2f}" if whole and row[name] and whole[name] else "-"

    lines = [
        [row["without"], marked(case, row), row["end"], row["steps"] or "-", ratio(row, "steps"),
         row["flattening"] or "-", row["why"]]
        for (case, _), row in rows.items()
    ]  # fmt: skip
    table = markdown("without | case | end | steps | steps, ratio | flattening | remark", lines)
    return [*table, "", versions(rows.values())]


if __name__ == "__main__":
    a = options(__doc__, "docs", case="", without=NOTHING)
    if a.case:
        compute(a.case, a.without)
    else:
        if not a.docs:
            study()
        write_parts(PAGES["stability"], {"ablation": part()})

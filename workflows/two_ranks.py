"""A script of one's own on two ranks: mpiexec -n 2 python workflows/two_ranks.py [--out DIR]

A 15 um nickel particle on steel, coarse enough for seconds. A probe looks on from inside the loop (on the rank that has the
target) and notes how deep the particle's lowest point is; rank 0 reads the result. Without mpiexec it runs in one process.
"""

import argparse
from pathlib import Path

from coupler import Scene, run
from coupler.errors import is_first_rank
from coupler.progress import Progress

SCENE = """
[particle]
material = "Ni"
diameter = "15 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
[resolution]
spacing = "1.5 um"
"""


def main() -> None:
    """Run, look on, read."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/two_ranks"))
    a = parser.parse_args()
    deepest: list[tuple[float, float]] = []

    def probe(impact) -> None:
        """impact: the `coupler.impact.exchange.Impact`, between two chunks of steps."""
        lowest = float(impact.surface.positions(impact.particle.x)[:, 2].min())
        deepest.append((impact.time, lowest))
        if len(deepest) % 20 == 0:
            print(f"probe: {impact.time * 1e9:5.1f} ns, lowest point {lowest * 1e6:6.2f} um", flush=True)

    scene, quiet = Scene.from_text(SCENE, "two_ranks"), Progress(quiet=True)
    result = run(scene, a.out, force=True, progress=quiet, probe=probe)
    if is_first_rank():  # rank 0, or the only process
        idle = ", ".join(f"{share:.0%}" for share in result.idle_share) or "none: one process"
        print(
            f"flattening {result.flattening_ratio:.3f}, crater {result.crater_depth_m * 1e6:.2f} um, {result.ranks} rank(s)"
        )
        print(f"wall time of the steps {result.wall_loop_s:.1f} s, waiting for others: {idle}")


if __name__ == "__main__":
    main()

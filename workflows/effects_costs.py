"""What effects cost, on and off: python workflows/effects_costs.py [--rounds N]

docs/tables/effects_costs.csv: processor time of a step with everything on, and the share of it that leaving out an effect saves. The
impacts advance in turn, ten steps of each at a time, so that a load on the machine affects all of them alike; of each ten steps the
least of several rounds counts.
"""

import argparse

from effects_study import CROSSINGS, SCENES, Effects, least_of
from pages import TABLES, write_table

from coupler.impact.exchange import WINDOW
from coupler.scene.effects import NAMES

SCENE = "Ni on steel, 500 m/s"


def impacts(rounds: int) -> list[dict[str, str]]:
    """A row for each choice of effects: ms per step, and the share of it that everything on would save."""
    choices: dict[str, Effects] = {"everything on": "all", "auto": "auto", "none": "none"}
    choices |= {f"without {name}": ["all", f"-{name}"] for name in NAMES if name not in ("adhesion", "cooling")}
    least = least_of(rounds, SCENES[SCENE], choices, CROSSINGS)
    step = {name: sum(costs) / (WINDOW * len(costs)) for name, costs in least.items()}
    whole = step["everything on"]
    return [
        {"effects": name, "ms_per_step": f"{1e3 * seconds:.4g}", "saves": f"{1.0 - seconds / whole:.4f}"}
        for name, seconds in step.items()
    ]


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=1, help="of the impacts")
    rows = impacts(parser.parse_args().rounds)
    write_table(TABLES / "effects_costs.csv", rows, "remake: python workflows/effects_costs.py")


if __name__ == "__main__":
    main()

"""The statistical error of a coating, from coatings whose particles are drawn from the same distributions with other seeds."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import COLD, Result
from ..plan.reading import Scene
from .coating import CoatingMeasures, SeedError, lines, measure, read
from .splats import Splats

FOLDER = "seeds"  # folder of these runs, in the folder of the run
MEASURES = (
    "thickness_mean_m", "Sa_m", "Sq_m", "porosity_closed", "porosity_open", "deposition_efficiency", "stress_in_plane_Pa",
)  # fmt: skip


def other_seeds(scene: Scene, count: int) -> dict[str, str]:
    """The scenes (TOML) with the `count` seeds after the seed of the scene, by name, such as "seed 8". Raises StoreError for a
    scene without a table [coating]."""
    if scene.coating is None:
        raise StoreError(
            "--seeds: the scene of this run has no table [coating] and therefore no seed: leave --seeds out"
        )
    seeds = range(scene.coating.seed + 1, scene.coating.seed + 1 + count)
    # without the particles, which come from the seed of the scene
    return {f"seed {n}": scene.with_(particle=None, coating={"seed": n}).to_toml() for n in seeds}


def errors(coatings: Sequence[CoatingMeasures]) -> dict[str, SeedError]:
    """The error of each of MEASURES, from coatings of several seeds; empty for a single coating."""
    if len(coatings) < 2:
        return {}
    return {key: seed_error([getattr(each, key) for each in coatings]) for key in MEASURES}


def seed_error(each: Sequence[float]) -> SeedError:
    """The error of a measure, from its values (SI) in several coatings; infinite for a single value."""
    values = np.array(each)
    error = float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.inf
    return SeedError(len(values), float(values.mean()), error, float(values.min()), float(values.max()))


def measured(result: Result, splats: Splats, radius: float | None = None) -> CoatingMeasures:
    """`coating.measure` of a run, with errors from the finished runs of other seeds in its folder. radius: radius of the disc, m."""
    own, runs = measure(splats, radius), sorted((result.directory / FOLDER).glob("*/summary.json"))
    others = [other for path in runs if _but_its_seed(other := Result(path.parent)) == _but_its_seed(result)]
    return replace(own, seeds=errors([own, *(measure(read(other), own.disc_radius_m) for other in others)]))


def _but_its_seed(result: Result) -> dict[str, object]:
    """The scene of a run without values that depend on its seed."""
    data = parse_toml(result.scene_text)
    return {**data, "particle": None, "coating": {**data.get("coating", {}), "seed": None}}


def lines_of(result: Result) -> list[tuple[str, str]]:
    """The text lines `coating.lines` of a run, finished or not. Empty if no splat can be measured, or for a single splat that is not
    cold."""
    if len(result.plan.get("impacts", [])) < 2 and not len(result.times(COLD)):
        return []
    try:
        return lines(measured(result, read(result)))
    except StoreError:
        return []

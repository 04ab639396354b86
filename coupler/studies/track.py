"""Tracks of the spray: cross-sections of one pass and of a raster, from the spot and the deposition efficiency by angle of impact."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import SceneError, StoreError
from ..measures import REBOUNDS, STICKS
from ..plan.job import Job
from ..plan.passes import spot_of
from ..plan.powder import table_of
from ..report.figure import blank, save
from ..scene.job import TrackSpray
from ..spray.track import CELLS, Gun, measures, waves
from .runs_table import table
from .table import write_rows

CSV, RECORD, PICTURE = FILES = ("track.csv", "track.json", "track.png")
MIDDLE, WIDE = "middle of the raster", "wide raster"
Profile = tuple[NDArray[np.float64], NDArray[np.float64]]
OF_WIDTH = (0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6)  # steps over the width of one pass at half its height


def compute(job: Job, folder: Path, tell: Callable[[str], None]) -> tuple[dict[str, Profile], dict[str, Any]]:
    """Profiles (x, heights) (n,) m: "one pass" and, with `passes`, "raster"; and the contents of track.json, SI units. folder: the file
    names in the job are relative to it; tell: function that receives the name of the current work. Raises SceneError."""
    path = job.data.spray
    assert isinstance(path, TrackSpray)
    try:
        spot, (angles, efficiency) = spot_of(path, folder), efficiency_of(job, path, folder)
    except ValueError as error:
        raise SceneError([f"spray.{error}"], job.name) from None
    per_mass = sum(powder.table.share / powder.flying.rho for powder in job.powders.values())
    gun = Gun(spot, path.angle, path.feed_rate * per_mass / path.traverse_speed, angles, efficiency)
    if not gun.efficiency_at(np.zeros(1))[0] > 0.0:
        at = f"{math.degrees(path.angle):.3g} degrees from the normal"
        raise SceneError([f"spray.efficiency: no powder sticks at {at}: change it, or spray.angle"], job.name)
    if path.step is not None and path.step < (least := 2.0 * spot.reach / CELLS):
        raise SceneError([f"spray.step = {1e3 * path.step:.3g} mm: give at least {1e3 * least:.2g} mm"], job.name)
    known: dict[str, Any] = {"version": __version__, "track": job.name, MIDDLE: [], WIDE: []}
    profiles = {}
    for name, lines in (("one pass", (0.0,)), ("raster", path.lines if path.passes else ())):
        if lines:
            tell(name)
            profiles[name] = gun.spray(lines)
            known[name] = measures(*profiles[name], len(lines) * gun.area)
    if path.step is not None:
        known[MIDDLE].append(waves(*profiles["raster"], path.step, float(np.mean(path.lines))))
    for step in known["one pass"]["width_m"] * np.array(OF_WIDTH):
        tell(f"wide raster with step {1e3 * step:.3g} mm")
        half = math.ceil(spot.reach / math.cos(path.angle) / step) + 1
        x, h = gun.spray(step * np.arange(-half, half + 1.0), CELLS // 2)
        known[WIDE].append(waves(x, h, float(step)))
    return profiles, known | {"angle_rad": angles.tolist(), "efficiency": efficiency.tolist()}


def efficiency_of(job: Job, path: TrackSpray, folder: Path) -> Profile:
    """Angles of impact (n,), rad from the normal, and deposition efficiency (n,) at each, from the table or runs `path.efficiency`.
    Default by formula: a particle sticks on a coating of its metal if its normal velocity is critical or higher (Li et al. (2003),
    Thermal Spray 2003, ASM, 91); mean by volume. Raises ValueError; its message begins with the name of the field."""
    if path.efficiency is None:
        angle = np.arange(90.0)
        volume = [powder.table.share / powder.flying.rho for powder in job.powders.values()]
        each = [[at.fates(1.0 / math.cos(math.radians(a)))[STICKS] for a in angle] for at in job.arrived.values()]
        share = np.average(each, axis=0, weights=volume)
    else:
        try:
            source = folder / path.efficiency
            if source.is_dir():
                angle, share = _of_runs(source)
            else:
                known = table_of(path.efficiency, folder)
                (_, angle), (name, share) = list(known.columns.items())[:2]
                share = share / (100.0 if known.units.get(name) == "%" else 1.0)
            if not ((np.diff(angle, prepend=-1e-9, append=90.0 + 1e-9) > 0.0).all() and abs(share - 0.5).max() <= 0.5):
                raise ValueError("needs ascending angles of 0 to 90 degrees, and efficiencies of 0 to 1")
        except (StoreError, ValueError) as error:
            raise ValueError(f'efficiency = "{path.efficiency[:60]}": {error}') from None
    if angle[-1] < 90.0:  # a grazing particle does not stick
        angle, share = np.append(angle, 90.0), np.append(share, 0.0)
    return np.radians(angle), share


def _of_runs(folder: Path) -> Profile:
    """Angles (deg from the normal) of the runs of a folder, and for each angle the share of the mass of the particles that sticks."""
    rows = [
        (round(math.degrees(row["keys"]["particle.angle"]), 6), row["diameter_m"] ** 3, row["verdict"] == STICKS)
        for row in table(folder)
        if row["verdict"] in (STICKS, REBOUNDS) and "particle.angle" in row["keys"]
    ]
    if not rows:
        raise ValueError("its runs have no verdicts of single particles: sweep over particle.angle")
    angle, mass, stays = np.array(rows, float).T
    known, of = np.unique(angle, return_inverse=True)
    return known, np.bincount(of, mass * stays) / np.bincount(of, mass)


def words(known: Mapping[str, Any]) -> list[str]:
    """The results as text lines."""
    lines = [
        f"{name}: height {1e6 * of['height_m']:.3g} um, width at half height {1e3 * of['width_m']:.3g} mm, flanks"
        f" {math.degrees(of['flank_left_rad']):.3g} and {math.degrees(of['flank_right_rad']):.3g} deg, deposition efficiency"
        f" {of['efficiency']:.1%}"
        for name, of in known.items()
        if name in ("one pass", "raster")
    ]
    return lines + [
        f"{name}: step {1e3 * row['step_m']:.3g} mm, thickness {1e6 * row['thickness_m']:.3g} um, waviness (peak to valley)"
        f" {1e6 * row['waviness_m']:.3g} um"
        for name in (MIDDLE, WIDE)
        for row in known[name]
    ]


def write(profiles: Mapping[str, Profile], known: Mapping[str, Any], out: Path, title: str, about: str) -> None:
    """Write the table and the picture of a track into a folder. known: as in `compute`; title: title of the picture; about: first
    line of the table."""
    rows = [
        {"profile": name, "x_m": float(x), "height_m": float(h)}
        for name, profile in profiles.items()
        for x, h in zip(*profile, strict=True)
    ]
    write_rows(out / CSV, ("profile", "x_m", "height_m"), rows, about)
    figure = blank(11.0, 3.6, dpi=150, layout="constrained")
    section, angles, steps = figure.subplots(1, 3, width_ratios=(2, 1, 1))
    for name, (places, heights) in profiles.items():
        section.plot(1e3 * places, 1e6 * heights, label=name)
    section.set(xlabel="x (mm)", ylabel="height (µm)", title=title)
    section.legend(fontsize=8)
    angles.plot(np.degrees(known["angle_rad"]), 100.0 * np.array(known["efficiency"]), "k")
    angles.set(xlabel="angle of impact from the normal (°)", ylabel="deposition efficiency (%)", ylim=(0.0, None))
    step, mean, wave = np.array([list(row.values()) for row in known[WIDE]]).T
    steps.plot(1e3 * step, 100.0 * wave / mean, "k.-")
    steps.set(xlabel="step (mm)", ylabel="waviness (% of the thickness)")
    save(figure, out / PICTURE)

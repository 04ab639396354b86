"""The picture of a search for the critical velocity."""

import math
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from ..measures import REBOUNDS, STICKS, UNDECIDED
from ..report.picture import blank, save
from .critical import Bracket, Row

_MARKERS = {STICKS: "o", REBOUNDS: "v", UNDECIDED: "s"}


def draw(rows: Sequence[Row], bracket: Bracket, diameter: float, picture: Path, error: float | None = None) -> None:
    """Draw three quantities against the impact velocity: the coefficient of restitution; the bonded area divided by the cross-section
    of the particle (diameter in m); with several placements the fraction that sticks. Markers show verdicts, lines connect means.
    error: error from the resolution, m/s, None if not measured."""
    figure = blank(10.0 + 4.0 * bool(bracket.shares), 4.0, dpi=130, layout="constrained")
    left, right, *more = figure.subplots(1, 3 if bracket.shares else 2)
    section = 0.25 * math.pi * diameter**2
    for at, key, factor, colour, label in (
        (left, "restitution", 1.0, "k", "rebound velocity / impact velocity"),
        (right, "bonded_area_m2", 1.0 / section, "0.6", "largest"),
        (right, "bonded_area_end_m2", 1.0 / section, "k", "at the end"),
    ):
        points = [
            (row["velocity_m_s"], factor * row[key], row["verdict_by_bonds"]) for row in rows if row[key] is not None
        ]
        levels = [(v, [y for _, y, _ in own]) for v, own in groupby(points, key=lambda point: point[0])]
        at.plot([v for v, _ in levels], [sum(y) / len(y) for _, y in levels], color=colour, linewidth=0.8)
        for verdict, marker in _MARKERS.items():
            own = [(v, y) for v, y, word in points if word == verdict]
            if own:
                at.scatter(*zip(*own, strict=True), marker=marker, color=colour, s=24, zorder=3,
                           label=verdict if at is left else f"{label}, {verdict}")  # fmt: skip
        at.set_ylim(bottom=0.0)
        at.set_xlabel("impact velocity in m/s")
    left.set_ylabel("coefficient of restitution")
    right.set_ylabel("bonded area / cross section")
    for at in more:
        at.plot(*zip(*sorted(bracket.shares.items()), strict=True), "ko-", markersize=4, linewidth=0.8)
        at.axhline(0.5, color="0.6", linewidth=0.8, linestyle="--")
        at.set_ylim(-0.05, 1.05)
        at.set_xlabel("impact velocity in m/s")
        at.set_ylabel("share of the placements that stick")
    low, high = bracket.band
    for at in (left, right, *more):
        if bracket.velocity is not None:
            at.axvspan(low or at.get_xlim()[0], high or at.get_xlim()[1], color="#d55e00", alpha=0.25, linewidth=0.0)
            if error is not None:
                ends = bracket.velocity - error, bracket.velocity + error
                at.axvspan(*ends, color="0.5", alpha=0.15, linewidth=0.0, zorder=0, label="error of the resolution")
        if at.get_legend_handles_labels()[0]:
            at.legend(fontsize=7)
    figure.suptitle(bracket.words, fontsize=9)
    save(figure, picture)

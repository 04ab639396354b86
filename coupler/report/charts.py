"""Curves of a run as plain figures for the page: energy, motion, time step, profiles with depth.

Each is a dict of `traces` and `layout` in the words of plotly.js, which draws them in the reader's browser.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from .profiles import Profile

Figure = dict[str, object]  # traces, layout and height, for JSON

# Entries of the ledger, from the bottom of the stack: columns of the history, words, colours (after Okabe & Ito, who
# chose them to be told apart by everybody).
LEDGER: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("plastic_particle",), "plastic work, particle", "#d55e00"),
    (("plastic_target",), "plastic work, target", "#e69f00"),
    (("friction",), "friction", "#f0e442"),
    (("numerical_particle",), "dissipated by the SPH scheme", "#cc79a7"),
    (("numerical_target",), "bulk viscosity, target", "#e8c6d8"),
    (("boundary",), "absorbed at boundaries", "#999999"),
    (("contact",), "contact springs", "#444444"),
    (("elastic_particle", "elastic_target"), "elastic, both", "#009e73"),
    (("kinetic_target",), "kinetic, target", "#56b4e9"),
    (("kinetic_particle",), "kinetic, particle", "#0072b2"),
)
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")
ABOVE = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "xanchor": "left"}
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
PART_OF_OTHER = 1e-3  # of the initial kinetic energy: a smaller rest is rounding


def energy(history: Mapping[str, NDArray], kinetic_0: float | None = None) -> Figure | None:
    """The ledger over time, stacked, in % of the initial kinetic energy; None without its columns.

    kinetic_0: J; from the first row if not given. What the columns that are known here leave of the whole is shown as
    "other", so that the stack is always the total that was booked.
    """
    if not len(history.get("time", ())) or not {"kinetic_particle", "drift"} <= history.keys():
        return None
    time, drift = history["time"] * 1e9, history["drift"]
    shares = [
        (np.sum([history[name] for name in names if name in history], axis=0), words, colour)
        for names, words, colour in LEDGER
        if any(name in history for name in names)
    ]
    total = np.sum([share for share, _, _ in shares], axis=0)
    kinetic_0 = kinetic_0 or float(total[0] / (1 + drift[0]))
    other = (1 + drift) * kinetic_0 - total
    if np.abs(other).max() > PART_OF_OTHER * kinetic_0:
        shares.insert(-2, (other, "other", "#bbbbbb"))
    traces = [
        {
            "x": _short(time), "y": _short(100 * share / kinetic_0), "name": words, "stackgroup": "all",
            "mode": "lines", "line": {"width": 0.6, "color": colour}, "fillcolor": colour,
            "hovertemplate": "%{y:.2f} %",
        }
        for share, words, colour in shares
    ]  # fmt: skip
    layout = {
        "xaxis": {"title": "time (ns)"},
        "yaxis": {"title": "% of the initial kinetic energy", "rangemode": "tozero"},
        "legend": {"traceorder": "reversed"},
    }
    return {"traces": traces, "layout": layout, "height": 420}


def drift(history: Mapping[str, NDArray]) -> Figure | None:
    """What the ledger fails to close by, over time, in % of the initial kinetic energy."""
    return _over_time(history, "ledger fails to close by (%)", {"drift": ("drift", 100.0)})


def lengths(history: Mapping[str, NDArray]) -> Figure | None:
    """Height, thickness and crater depth over time."""
    names = {"height": "height above surface", "thickness": "whole thickness", "crater_depth": "crater depth"}
    return _over_time(history, "length (µm)", {name: (words, 1e6) for name, words in names.items()})


def velocity(history: Mapping[str, NDArray]) -> Figure | None:
    """Mean velocity of the particle along the surface's normal over time."""
    return _over_time(history, "mean velocity of the particle (m/s)", {"velocity_z": ("upwards", 1.0)})


def force(history: Mapping[str, NDArray]) -> Figure | None:
    """Contact force on the particle along the surface's normal over time."""
    return _over_time(history, "contact force (mN)", {"contact_force": ("upwards", 1e3)})


def time_step(history: Mapping[str, NDArray]) -> Figure | None:
    """The time step over time."""
    return _over_time(history, "time step (ps)", {"dt": ("dt", 1e12)})


def compared(histories: Mapping[str, Mapping[str, NDArray]], column: str, words: str, factor: float) -> Figure | None:
    """One column of several runs over time. histories: name of the run -> its history."""
    traces = []
    for k, (name, history) in enumerate(histories.items()):
        if column in history and "time" in history:
            line = {"color": LINES[k % len(LINES)], "dash": DASHES[k // len(LINES) % len(DASHES)], "width": 1.8}
            traces.append(
                {
                    "x": _short(history["time"] * 1e9),
                    "y": _short(history[column] * factor),
                    "name": name.replace("<", "&lt;"),  # a folder's name is text, not markup
                    "mode": "lines",
                    "line": line,
                }
            )
    layout = {"xaxis": {"title": "time (ns)"}, "yaxis": {"title": words}, "legend": ABOVE, "showlegend": True}
    return {"traces": traces, "layout": layout, "height": 300} if traces else None


def with_depth(
    profiles: Sequence[Profile], name: str, words: str, factor: float, span: tuple[float, float]
) -> Figure | None:
    """A field along the axis at several times, depth downwards. span: least and greatest depth to show, um."""
    lines: list[tuple[Profile, NDArray]] = [(p, p.values[name] * factor) for p in profiles if name in p.values]
    traces = []
    for time, colour in shades([profile.time for profile in profiles]).items():
        joined = [(profile, values) for profile, values in lines if profile.time == time]
        traces.append(_down(joined, f"{time * 1e9:.1f} ns", colour))
    return _deep(traces, words, span, legend=False) if traces else None


def shades(times: Iterable[float]) -> dict[float, str]:
    """A colour for each time, the later the darker."""
    each = sorted(set(times))
    return {t: to_hex(colormaps["viridis_r"](0.15 + 0.85 * (k / max(len(each) - 1, 1)))) for k, t in enumerate(each)}


def stress_with_depth(profiles: Sequence[Profile], span: tuple[float, float]) -> Figure | None:
    """Normal stresses along the axis at the one time of the profiles, depth downwards. span: as in `with_depth`."""
    lines = [(profile, profile.values["stress"] * 1e-6) for profile in profiles if "stress" in profile.values]
    parts = (("σ<sub>xx</sub>", 0), ("σ<sub>yy</sub>", 1), ("σ<sub>zz</sub>", 2))
    traces = [
        _down([(profile, values[:, part]) for profile, values in lines], words, LINES[part], DASHES[part])
        for words, part in parts
    ]
    return _deep(traces, "normal stress (MPa)", span, legend=True) if lines else None


def _down(lines: Sequence[tuple[Profile, NDArray]], words: str, colour: str, dash: str = "solid") -> dict[str, object]:
    """Values of several bodies as one line with gaps between them."""
    x: list[float | None] = []
    y: list[float | None] = []
    for profile, values in lines:
        x += [*_short(values), None]
        y += [*_short(profile.depth * 1e6), None]
    line = {"color": colour, "width": 1.8, "dash": dash}
    return {"x": x, "y": y, "name": words, "mode": "lines", "line": line, "connectgaps": False}


def _deep(traces: list[dict[str, object]], words: str, span: tuple[float, float], legend: bool) -> Figure:
    line = {"color": "#888", "width": 1, "dash": "dash"}
    surface = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0, "y1": 0, "line": line}
    layout = {
        "xaxis": {"title": words, "side": "bottom"},
        "yaxis": {"title": "depth below the surface (µm)", "range": [1.02 * span[1], span[0] - 0.02 * span[1]]},
        "hovermode": "y unified",
        "legend": {"x": 0.03, "y": 0.03, "xanchor": "left", "yanchor": "bottom"},
        "showlegend": legend,
        "shapes": [surface],
    }
    return {"traces": traces, "layout": layout, "height": 440}


def _over_time(history: Mapping[str, NDArray], words: str, wanted: Mapping[str, tuple[str, float]]) -> Figure | None:
    have = {name: said for name, said in wanted.items() if len(history.get(name, ())) and "time" in history}
    if not have:
        return None
    traces = [
        {
            "x": _short(history["time"] * 1e9), "y": _short(history[name] * factor), "name": label, "mode": "lines",
            "line": {"color": LINES[k % len(LINES)], "width": 1.8, "dash": DASHES[k % len(DASHES)]},
        }
        for k, (name, (label, factor)) in enumerate(have.items())
    ]  # fmt: skip
    layout = {
        "xaxis": {"title": "time (ns)"},
        "yaxis": {"title": words},
        "showlegend": len(traces) > 1,
        "legend": ABOVE,
    }
    return {"traces": traces, "layout": layout, "height": 280}


def _short(values: NDArray) -> list[float | None]:
    """Five digits are more than a screen shows; what is no number is a gap."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in np.asarray(values, dtype=float)]

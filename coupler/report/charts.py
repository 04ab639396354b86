"""Curves of a run for the report: energy, motion, time step, fields against depth.

Each figure is a dict with `traces` and `layout` of plotly.js, which draws it in the browser.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from .profiles import Profile

Figure = dict[str, object]  # traces, layout and height, for JSON
Trace = dict[str, object]
History = Mapping[str, NDArray]

# Terms of the ledger from the bottom of the stack: columns of the history, label, colour (Okabe & Ito, for colour-blind readers)
LEDGER: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("plastic_particle",), "plastic work, particle", "#d55e00"),
    (("plastic_target",), "plastic work, target", "#e69f00"),
    (("friction",), "friction", "#f0e442"),
    (("numerical_particle",), "dissipated by the SPH scheme", "#cc79a7"),
    (("numerical_target",), "bulk viscosity and scaled inertia, target", "#e8c6d8"),
    (("boundary",), "absorbed at boundaries", "#999999"),
    (("contact", "bodies", "bond"), "springs of contact and bonds", "#444444"),
    (("elastic_particle", "elastic_target"), "elastic, both", "#009e73"),
    (("kinetic_target",), "kinetic, target", "#56b4e9"),
    (("kinetic_particle",), "kinetic, particle", "#0072b2"),
)
# Curves over time: name of the figure -> label of the axis, factor from SI, column of the history -> label
CURVES: dict[str, tuple[str, float, dict[str, str]]] = {
    "drift": ("change of the energy sum (%)", 100.0, {"drift": "drift"}),
    "lengths": ("length (µm)", 1e6, {
        "height": "height above surface", "thickness": "whole thickness", "crater_depth": "crater depth"}),
    "velocity": ("mean velocity of the particle (m/s)", 1.0, {"velocity_z": "upwards"}),
    "force": ("contact force (mN)", 1e3, {"contact_force": "upwards"}),
    "step": ("time step (ps)", 1e12, {"dt": "dt"}),
}  # fmt: skip
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
PART_OF_OTHER = 1e-3  # of the initial kinetic energy: a smaller remainder is a rounding error
MOMENT = 1e-13  # s: invisible on the page, but more than the rounding of times


def energy(history: History) -> Figure | None:
    """The terms of the energy ledger against time, as stacked areas in % of the kinetic energy at the start of each impact; None
    if the history is empty or lacks the columns. "other": total energy according to the column `drift`, minus the sum of the terms."""
    if not len(history.get("time", ())) or not {"kinetic_particle", "drift"} <= history.keys():
        return None
    history, starts = _apart(history)
    known = [([history[n] for n in names if n in history], words, colour) for names, words, colour in LEDGER]
    terms = [(np.sum(columns, axis=0), words, colour) for columns, words, colour in known if columns]
    total = np.sum([term for term, _, _ in terms], axis=0)
    first = np.clip(np.searchsorted(starts, np.arange(len(total)), side="right") - 1, 0, None)
    kinetic_0 = (total / (1 + history["drift"]))[starts][first]
    other = (1 + history["drift"]) * kinetic_0 - total
    if np.nanmax(np.abs(other / kinetic_0)) > PART_OF_OTHER:
        terms.insert(-2, (other, "other", "#bbbbbb"))
    traces = [
        trace(history["time"] * 1e9, np.nan_to_num(100 * term / kinetic_0), words, color=colour, width=0.6)
        | {"stackgroup": "all", "fillcolor": colour, "hovertemplate": "%{y:.2f} %"}
        for term, words, colour in terms
    ]
    top = 103 + 100 * max(np.nanmax(history["drift"]), 0)
    share = {"title": "% of the initial kinetic energy", "range": [-3, top]}
    layout = {"xaxis": axis("time (ns)", traces, "x"), "yaxis": share, "legend": {"traceorder": "reversed"}}
    return {"traces": traces, "layout": layout, "height": 420}


def _apart(history: History) -> tuple[dict[str, NDArray], NDArray]:
    """The history with two new rows between impacts, NaN except for the time; and the new index of the first row of each impact."""
    time = history["time"]
    firsts = np.flatnonzero(np.diff(history.get("impact", np.ones(len(time))))) + 1
    apart = {name: np.insert(column.astype(float), np.repeat(firsts, 2), np.nan) for name, column in history.items()}
    starts = firsts + 2 * np.arange(1, len(firsts) + 1)
    apart["time"][starts - 2], apart["time"][starts - 1] = time[firsts - 1] + MOMENT, time[firsts] - MOMENT
    return apart, np.insert(starts, 0, 0)


def over_time(history: History, name: str) -> Figure | None:
    """The figure `name` of CURVES: its columns of the history against time; None if the history lacks all of them."""
    label, factor, columns = CURVES[name]
    if not len(history.get("time", ())):
        return None
    history, traces = _apart(history)[0], list[Trace]()
    for (column, words), colour, dash in zip(columns.items(), LINES, DASHES, strict=False):
        if column in history:
            traces.append(trace(history["time"] * 1e9, history[column] * factor, words, color=colour, dash=dash))
    return _of_time(traces, label, 280) if traces else None


def compared(histories: Mapping[str, History], column: str, label: str, factor: float) -> Figure | None:
    """A column times `factor` against time, for all runs that have it; None if none has. histories: by run name; label: of the axis."""
    traces = []
    for k, (name, history) in enumerate(histories.items()):
        if column in history and "time" in history:
            style = {"color": LINES[k % len(LINES)], "dash": DASHES[k // len(LINES) % len(DASHES)]}
            words, history = name.replace("<", "&lt;"), _apart(history)[0]  # a folder's name is text, not markup
            traces.append(trace(history["time"] * 1e9, history[column] * factor, words, **style))
    return _of_time(traces, label, 300) if traces else None


def _of_time(traces: Sequence[Trace], label: str, height: int) -> Figure:
    layout = {
        "xaxis": axis("time (ns)", traces, "x"), "yaxis": axis(label, traces, "y"), "showlegend": len(traces) > 1,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "xanchor": "left"},
    }  # fmt: skip
    return {"traces": traces, "layout": layout, "height": height}


def with_depth(
    profiles: Sequence[Profile], name: str, label: str, factor: float, span: tuple[float, float]
) -> Figure | None:
    """Field `name` times `factor` over depth, a curve for each time; None if no profile has it. span: depths to show (from, to), um."""
    traces = []
    for time, colour in shades(profile.time for profile in profiles).items():
        own = [(p, p.values[name] * factor) for p in profiles if p.time == time and name in p.values]
        traces += [_down(own, f"{time * 1e9:.1f} ns", colour)] if own else []
    return _deep(traces, label, span, legend=False) if traces else None


def shades(times: Iterable[float]) -> dict[float, str]:
    """A colour for each time. Later times are darker."""
    each = sorted(set(times))
    return {t: to_hex(colormaps["viridis_r"](0.15 + 0.85 * (k / max(len(each) - 1, 1)))) for k, t in enumerate(each)}


def stress_with_depth(profiles: Sequence[Profile], span: tuple[float, float]) -> Figure | None:
    """Normal stresses along vertical profiles at one time, depth downwards; None without stress. span: as in `with_depth`."""
    lines = [(profile, profile.values["stress"] * 1e-6) for profile in profiles if "stress" in profile.values]
    traces = [
        _down([(p, values[:, k]) for p, values in lines], f"σ<sub>{axis}</sub>", LINES[k], DASHES[k])
        for k, axis in enumerate(("xx", "yy", "zz"))
    ]
    return _deep(traces, "normal stress (MPa)", span, legend=True) if lines else None


def _down(lines: Sequence[tuple[Profile, NDArray]], words: str, colour: str, dash: str = "solid") -> Trace:
    """Values of several bodies over depth as one curve, with a gap between two bodies. words: name of the curve."""
    gap = [np.nan]
    x = np.concatenate([part for _, values in lines for part in (values, gap)])
    y = np.concatenate([part for profile, _ in lines for part in (profile.depth * 1e6, gap)])
    return trace(x, y, words, color=colour, dash=dash) | {"connectgaps": False}


def _deep(traces: Sequence[Trace], label: str, span: tuple[float, float], legend: bool) -> Figure:
    line = {"color": "#888", "width": 1, "dash": "dash"}
    layout = {
        "xaxis": axis(label, traces, "x"), "hovermode": "y unified", "showlegend": legend,
        "yaxis": {"title": "depth below the surface (µm)", "range": [1.04 * span[1], span[0] - 0.04 * span[1]]},
        "legend": {"x": 0.03, "y": 0.03, "xanchor": "left", "yanchor": "bottom"},
        "shapes": [{"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": 0, "y1": 0, "line": line}],
    }  # fmt: skip
    return {"traces": traces, "layout": layout, "height": 440}


def axis(title: str, traces: Sequence[Trace], key: str) -> dict[str, object]:
    """An axis that covers the values of all traces along `key` ("x" or "y"), with a margin."""
    values = [v for t in traces for v in t[key] if v is not None]  # type: ignore[attr-defined]
    low, high = min(values, default=0.0), max(values, default=1.0)
    room = 0.04 * (high - low) or abs(0.04 * high) or 1.0
    return {"title": title, "range": [low - room, high + room]}


def trace(x: NDArray, y: NDArray, name: str, **line: str | float) -> Trace:
    """The data of one curve, rounded to seven digits; NaN makes a gap."""
    places = ([float(f"{value:.7g}") if np.isfinite(value) else None for value in values] for values in (x, y))
    return {**dict(zip("xy", places, strict=True)), "name": name, "mode": "lines", "line": {"width": 1.8, **line}}

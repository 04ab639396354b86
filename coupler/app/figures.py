"""Curves for the local web page, drawn by plotly: deposition window and flight of a powder, flow stresses, energies of a run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..files.result import HISTORY, Result
from ..physics.adhesion import critical_velocity
from ..physics.materials import Material
from ..plan.job import Job
from ..report import charts
from ..spray.flight import DRAG_LAWS, fly_together
from ..spray.window import EROSION, OPTIMAL
from ..studies.job_numbers import BAND

Figure = dict[str, Any]
GREY, GRID = "#808a94", "rgba(128,138,148,0.25)"


def shell(traces: Sequence[Mapping[str, Any]], x: str, y: str, name: str, **layout: Any) -> Figure:
    """A plotly figure that is readable on a light and on a dark background. x, y: titles of the axes; name: file name of the PNG that
    the reader can save."""
    line = {"gridcolor": GRID, "zerolinecolor": GRID, "linecolor": GREY, "automargin": True}
    axes = {axis: {"title": {"text": text, "standoff": 8}, **line} for axis, text in (("xaxis", x), ("yaxis", y))}
    clear = dict.fromkeys(("paper_bgcolor", "plot_bgcolor"), "rgba(0,0,0,0)")
    base = {
        "font": {"color": GREY}, "margin": {"l": 55, "r": 10, "t": 30, "b": 40}, "hovermode": "closest", **clear,
        "legend": {"orientation": "h", "y": -0.22, "yanchor": "top"}, "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": GREY},
    }  # fmt: skip
    config = {"responsive": True, "displaylogo": False, "toImageButtonOptions": {"filename": name, "scale": 2}}
    return {"data": [*traces], "layout": {**axes, **base, **layout}, "config": config}


def deposition_window(job: Job, powder: str) -> Figure:
    """Velocity against temperature at impact: the size classes of a metal powder, the critical velocities of powder and surface for
    diameter D50, and the optimal and erosion velocities of the powder. powder: name of the powder."""
    spray, own, lines = job.arrived[powder], job.powders[powder], []
    coldest, hottest = float(spray.temperature.min()), float(spray.temperature.max())
    T, D50 = np.linspace(min(280.0, coldest), min(hottest + 200.0, 0.9 * own.metal.T_m), 40), own.sizes.diameter(0.5)
    pair = {job.surface: job.metals[job.surface], own.table.material: own.metal}
    for (name, metal), colour in zip(pair.items(), charts.LINES, strict=False):
        if metal.sigma_TS is None:
            continue
        v = job.slant * np.array([critical_velocity(metal, t, D50) for t in T])
        for factor in (1 - BAND, 1 + BAND):
            edge = charts.trace(T, factor * v, "", color=colour, width=0) | {"hoverinfo": "skip", "showlegend": False}
            lines.append(edge | ({"fill": "tonexty", "fillcolor": f"{colour}26"} if factor > 1 else {}))
        lines.append(charts.trace(T, v, f"critical, {name}, ± {BAND:.0%}", color=colour))
    for factor, dash, word in ((OPTIMAL, "dash", "optimal"), (EROSION, "dot", "erosion")):
        lines.append(charts.trace(T, factor * v, f"{word}, {name}", color=colour, dash=dash))
    sizes = [round(1e6 * D, 1) for D in spray.diameter.tolist()]
    bar = {"title": {"text": "µm"}, "thickness": 10, "outlinewidth": 0}
    marks = {
        "color": sizes, "colorscale": "Viridis", "size": 8, "line": {"width": 0.5, "color": GREY}, "colorbar": bar,
    }  # fmt: skip
    cloud = charts.trace(spray.temperature, spray.velocity, f"{powder}: 25 classes of equal mass") | {"mode": "markers"}
    hover = "%{text} µm: %{y:.0f} m/s, %{x:.0f} K<extra></extra>"
    lines.append(cloud | {"marker": marks, "text": sizes, "hovertemplate": hover})
    return shell(lines, "temperature at impact (K)", "velocity (m/s)", f"window-{job.name}")


def flights(job: Job, powder: str) -> Figure:
    """Velocity of the gas and of particles of a powder of diameters D10, D50 and D90 along the axis of the nozzle; their temperatures
    in a second panel below."""
    gas, own = job.data.gas, job.powders[powder]
    D = [own.sizes.diameter(share) for share in (0.1, 0.5, 0.9)]
    flown = fly_together(job.flow, own.flying, D, gas.powder_temperature, DRAG_LAWS[gas.drag])
    curves = [("gas", flown[0].u, flown[0].T_gas, GREY)]
    curves += [(f"{powder}, {1e6 * d:.0f} µm", f.v, f.T, c) for d, f, c in zip(D, flown, charts.LINES, strict=False)]
    lines, x = [], 1e3 * flown[0].x
    for name, v, T, colour in curves:
        lines.append(charts.trace(x, v, name, color=colour))
        lines.append(charts.trace(x, T, name, color=colour) | {"yaxis": "y2", "showlegend": False})
    figure = shell(lines, "distance from the throat (mm)", "velocity (m/s)", f"flight-{job.name}")
    layout = figure["layout"]
    layout["yaxis2"] = layout["yaxis"] | {"domain": [0.0, 0.47], "title": {"text": "temperature (K)", "standoff": 8}}
    layout["yaxis"] |= {"domain": [0.53, 1.0]}
    layout["xaxis"] |= {"anchor": "y2"}
    return figure


def energies(result: Result) -> Figure | None:
    """The energy balance of a run up to the last stored time; None before its first row is written."""
    drawn = charts.energy(result.history()) if (result.directory / HISTORY).is_file() else None
    traces: Any = drawn["traces"] if drawn else ()
    legend = {"orientation": "h", "y": -0.2, "yanchor": "top", "font": {"size": 10}, "traceorder": "reversed"}
    return shell(traces, "time (ns)", "% of kinetic energy at start", "energies", legend=legend) if drawn else None


def flow_stresses(metals: Sequence[Material], rate: float, T: float) -> Figure:
    """Flow stress (MPa) against plastic strain for each strength set of the metals, at a strain rate (1/s) and a temperature (K)."""
    strain, lines = np.linspace(0.0, 1.0, 60), []
    for k, metal in enumerate(metals):
        stress = np.array([metal.flow_stress(e, rate, T) for e in strain]) / 1e6
        style = {"color": charts.LINES[k % len(charts.LINES)], "dash": charts.DASHES[k // len(charts.LINES) % 5]}
        lines.append(charts.trace(strain, stress, f"{metal.name} {metal.strength.set}", **style))
    return shell(lines, "plastic strain", "flow stress (MPa)", "flow-stress")

"""docs/evidence/splats.png: what the default makes of three clouds of the battery, cut open.

    python workflows/splat_figure.py [--clouds DIR]

Clouds that DIR lacks are computed (see splat_battery.py).
"""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import splat_battery
import splat_clouds
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection
from pages import options

from coupler.geometry.sections import crossing, cut_tets
from coupler.splat.convert import convert

matplotlib.use("Agg")

CLOUDS = {"Ni1000": "Ni, 1000 m/s", "Ni500_angular": "Ni, angular, 500 m/s", "long_lip_5000": "long lip, synthetic"}


def section(axes: Any, points: np.ndarray, tets: np.ndarray, values: np.ndarray, most: float) -> Any:
    """Draw the cut of tetrahedra with the plane y = 0, coloured by their values (m,)."""
    edges, owner = cut_tets(points, tets, 0.0)
    corners = crossing(points, edges, 0.0)[0] * 1e6
    drawn = PolyCollection(list(corners), array=values[owner], cmap="viridis", edgecolors="k", linewidths=0.3)
    drawn.set_clim(0.0, most)
    return axes.add_collection(drawn)


def main() -> None:
    """Make the picture."""
    a = options(__doc__, clouds=splat_battery.CLOUDS, out=Path("docs/evidence/splats.png"))
    figure, axes = plt.subplots(2, len(CLOUDS), figsize=(12.0, 4.4), constrained_layout=True)
    makers = splat_clouds.real() | splat_clouds.synthetic()
    clouds = [splat_battery.cloud_of(name, a.clouds, makers[name]) for name in CLOUDS]
    most = max(float(np.percentile(cloud.eps_p, 99)) for cloud in clouds if cloud.eps_p is not None)
    for column, cloud, label in zip(axes.T, clouds, CLOUDS.values(), strict=True):
        assert cloud.eps_p is not None
        near = np.abs(cloud.x[:, 1]) < 0.8 * cloud.spacing
        at = cloud.x[near] * 1e6
        column[0].scatter(at[:, 0], at[:, 2], s=9, c=cloud.eps_p[near], cmap="viridis", vmin=0.0, vmax=most)
        column[0].set_title(f"{label}: {len(cloud.x)} points", fontsize=9)
        splat = convert(cloud, splat_battery.SIZE_OVER_SPACING * cloud.spacing)
        for body in splat.bodies:
            assert body.eps_p is not None
            drawn = section(column[1], body.points, body.tets, body.eps_p, most)
        r = splat.report
        numbers = f"{r['tets']} tets, gamma {r['gamma_min']:.2f}, volume {r['volume_error_before']:+.1%}"
        column[1].set_title(f"{r['method']}: {numbers}", fontsize=7.5)
        low, high = cloud.x.min(axis=0) * 1e6 - 2.0, cloud.x.max(axis=0) * 1e6 + 2.0
        for panel in column:
            panel.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[2], high[2]))
        column[1].set_xlabel("x (µm)")
    for panel, label in zip(axes[:, 0], ("points at y = 0", "elements"), strict=True):
        panel.set_ylabel(f"{label}\nz (µm)")
    figure.colorbar(drawn, ax=axes[:, -1], label="plastic strain", shrink=0.7)
    figure.savefig(a.out, dpi=100)


if __name__ == "__main__":
    main()

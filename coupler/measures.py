"""What is measured of an impact, always by the same words: shape, strain, temperature, stress, energy."""

from typing import Any

import numpy as np

from .splat.carry import CarriedSurface, shape_measures


def von_mises_of(stress: np.ndarray) -> np.ndarray:
    """Equivalent stress (n,) of tensors (n,6), Voigt xx yy zz yz xz xy, Pa."""
    mean = stress[:, :3].mean(axis=1)
    deviator = stress[:, :3] - mean[:, None]
    return np.sqrt(1.5 * (np.sum(deviator**2, axis=1) + 2.0 * np.sum(stress[:, 3:] ** 2, axis=1)))


def measure(
    particle: Any, target: Any, surface: CarriedSurface, surface_nodes: np.ndarray, diameter: float
) -> dict[str, float]:
    """Measures of this instant, SI. Heights from the undeformed surface z = 0; means over mass, percentiles over
    points.

    particle, target: the two domains; surface: the particle's carried surface; surface_nodes: nodes of the target
    that can be touched; diameter: the particle's, m.
    """
    m = shape_measures(surface.positions(particle.x), diameter)
    m["crater_depth_m"] = float(-target.x[surface_nodes, 2].min())
    m["eps_p_mean"] = float(np.average(particle.eps_p, weights=particle.mass))
    m["eps_p_p99"] = float(np.percentile(particle.eps_p, 99))
    m["eps_p_max"] = float(particle.eps_p.max())
    m["T_mean_K"] = float(np.average(particle.T, weights=particle.mass))
    m["T_p99_K"] = float(np.percentile(particle.T, 99))
    m["T_max_K"] = float(particle.T.max())
    m["von_mises_max_Pa"] = float(von_mises_of(particle.stress()).max())
    m["target_eps_p_max"] = float(target.eps_p.max())
    m["target_T_max_K"] = float(target.T.max())
    m["target_von_mises_max_Pa"] = float(von_mises_of(target.stress()).max())
    m["velocity_z_m_s"] = float(particle.momentum()[2] / particle.mass.sum())
    return m

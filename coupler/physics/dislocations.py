"""Taylor's relation between flow stress and dislocation density, and the dislocations due to gradients of plastic strain.

With y = b sqrt(rho), Burgers vector b and dislocation density rho (1/m2), the flow stress is y (A + B ln y).
"""

import math

TAYLOR_FACTOR = 3.06  # of fcc polycrystals: Bishop & Hill (1951), Phil. Mag. 42, 1298, second-hand
TAYLOR_DENSITY = 1e12  # 1/m2, density at which Taylor's coefficient is alpha
# share of the coefficient that is proportional to the line tension: Devincre, Kubin & Hoc (2006), Scripta Mater. 54, 741
LINE_TENSION = 0.8
NYE_FACTOR = 1.9  # of fcc polycrystals: Arsenlis & Parks (1999), Acta Mater. 47, 1597, second-hand


def taylor_relation(G: float, burgers: float, alpha: float) -> tuple[float, float]:
    """A and B, Pa, in Taylor's relation sigma = y (A + B ln y), y = b sqrt(density). G: Pa; burgers: b, m.

    sigma = M G y alpha (0.2 + 0.8 ln(alpha y) / ln(alpha b sqrt(1e12 / m2))): short segments have less line tension (Devincre, Kubin &
    Hoc 2006; Kubin, Devincre & Hoc (2008), Acta Mater. 56, 6040). M: TAYLOR_FACTOR; alpha: Taylor's coefficient at TAYLOR_DENSITY.
    """
    stress, reference = TAYLOR_FACTOR * alpha * G, math.log(alpha * burgers * math.sqrt(TAYLOR_DENSITY))
    slope = LINE_TENSION / reference
    return stress * (1.0 - LINE_TENSION + slope * math.log(alpha)), stress * slope


def stress_of_gradient(forest: tuple[float, float], length: float, eta: float) -> float:
    """Flow stress, Pa, due to only the dislocations of a gradient of plastic strain, eta (1/m). forest: A and B, Pa; length (m):
    `Material.gradient_length`. For a metal that gradients do not harden, the length and the result are 0."""
    (A, B), y = forest, math.sqrt(length * eta)
    return y * (A + B * math.log(y)) if y > 0.0 else 0.0

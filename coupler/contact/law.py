"""The law of contact (numba): a penalty spring along the normal, and friction by a spring that slips at Coulomb's limit.

The stable time step of the contact depends on this law: k is its largest stiffness dF/dd.
"""

from ..compiling import njit

TANGENTIAL = 0.5  # stiffness of the friction spring divided by that of the penalty spring


@njit(cache=True, nogil=True, inline="always")
def normal_force(k: float, d: float) -> float:
    """Force (N) of a spring of stiffness k (N/m) at penetration d (m)."""
    return k * d


@njit(cache=True, nogil=True, inline="always")
def friction_force(k: float, mu: float, d: float, g: float) -> tuple[float, float]:
    """Friction force (N) with coefficient mu, and heat (J) of the slip. g: trial force (N) without slip."""
    friction = min(g, mu * normal_force(k, d))
    return friction, friction * (g - friction) / (TANGENTIAL * k)


@njit(cache=True, nogil=True, inline="always")
def stored(k: float, d: float, g2: float) -> float:
    """Energy (J) that both springs store: k d^2 / 2 + g^2 / (2 TANGENTIAL k). g2: square of the friction force, N2."""
    return 0.5 * k * d * d + 0.5 * g2 / (TANGENTIAL * k)


def stiffness(bulk_modulus: float, area: float, spacing: float, factor: float = 1.0) -> float:
    """Stiffness k = factor K a / h, N/m, of a point. K: softer bulk modulus, Pa; a: area of the point, m2; h: spacing of the
    surface, m.

    The contact is about as stiff as a layer of the material of one spacing thickness and does not limit the time step. Under a
    pressure p the penetration is p h / (factor K): one twentieth of a spacing at 10 GPa in nickel.
    """
    return factor * bulk_modulus * area / spacing

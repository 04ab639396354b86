"""The law of contact (numba): a penalty spring along the normal, and friction by a spring that slips at Coulomb's limit.

What depends on it elsewhere is the stable time step: k is the largest stiffness dF/dd.
"""

from ..compiling import njit

TANGENTIAL = 0.5  # stiffness of the spring of friction over that of the penalty


@njit(cache=True, nogil=True, inline="always")
def normal_force(k: float, d: float) -> float:
    """Force (N) of a spring of stiffness k (N/m) at penetration d (m)."""
    return k * d


@njit(cache=True, nogil=True, inline="always")
def friction_force(k: float, mu: float, d: float, g: float) -> tuple[float, float]:
    """Friction (N), and heat (J) of slip, with coefficient mu, where friction would be g (N) if it did not slip."""
    friction = min(g, mu * normal_force(k, d))
    return friction, friction * (g - friction) / (TANGENTIAL * k)


@njit(cache=True, nogil=True, inline="always")
def stored(k: float, d: float, g2: float) -> float:
    """Potential (J) of these forces, from which they follow: k d^2 / 2 + g^2 / 2 TANGENTIAL k. g2: square of the friction, N2."""
    return 0.5 * k * d * d + 0.5 * g2 / (TANGENTIAL * k)


def stiffness(bulk_modulus: float, area: float, spacing: float, factor: float = 1.0) -> float:
    """Stiffness k (N/m) of a point that stands for an area (m2) of a surface of this spacing (m): factor K a / h.

    K (Pa) is the softer bulk modulus. A pressure p presses the surfaces p h / (factor K) into each other, one twentieth of a spacing at
    10 GPa in nickel; the contact is about as stiff as a layer of the material one spacing thick and does not set the time step.
    """
    return factor * bulk_modulus * area / spacing

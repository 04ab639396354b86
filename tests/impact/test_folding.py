"""A particle meets itself: forces where its parts come together, none through its walls, none where it is convex."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from coupler.impact.folding import SHAPES, Folding
from coupler.particle import shapes
from coupler.particle.carried_surface import CarriedSurface

STIFFNESS = 1e4  # N/m


class Ball:
    """A hollow sphere about the origin, whose walls are moved along z."""

    def __init__(self, friction: float = 0.0):
        self.body = body = shapes.shape("hollow_sphere", 25e-6, 1000)
        assert body.inner is not None
        surface = CarriedSurface(body.points, body.vertices, body.triangles, body.spacing)
        self.folding = Folding(body, surface, np.zeros(3), STIFFNESS, friction)
        self.hole = float(np.linalg.norm(body.inner[0], axis=1).mean())
        n = len(body.points)
        self.particle = cast(Any, SimpleNamespace(mass=np.ones(n), v=np.zeros((n, 3)), dt=1e-12))

    def push(self, inside: float, outside: float) -> np.ndarray:
        """Forces (n,3) N on the points, where near the axis the wall of the cavity has moved by `inside` of its radius to the middle,
        and the outer wall by `outside`."""
        x, z = self.body.points, np.abs(self.body.points[:, 2])
        near = np.exp(-(x[:, 0] ** 2 + x[:, 1] ** 2) / self.hole**2)
        depth = np.clip((z - self.hole) / self.hole, 0.0, 1.0)  # in the wall
        p = self.particle
        p.x, p.f_ext = x.copy(), np.zeros_like(x)
        p.x[:, 2] -= np.sign(x[:, 2]) * near * self.hole * (inside + (outside - inside) * depth)
        self.folding.search(p, 0.0)
        self.folding.forces(p)
        return p.f_ext


def test_walls_of_a_cavity_that_meet_are_pushed_apart() -> None:
    """Equal and opposite in force and in moment; before they meet there is no force."""
    ball = Ball()
    assert not any(ball.push(s, s).any() for s in np.linspace(0.0, 0.8, 5))
    for s in np.arange(0.82, 1.3, 0.02):  # a twentieth of a spacing each
        f = ball.push(s, s)
        if ball.folding.contact.depth.max() > 0.1 * ball.body.spacing:
            break
    c, x = ball.folding.contact, ball.particle.x
    assert 0.0 < c.depth.max() < 0.3 * ball.body.spacing
    upper = ball.body.points[:, 2] > 0.0
    lift = float(f[upper, 2].sum())
    assert lift > 0.5 * STIFFNESS * float(c.depth.max())
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-12 * lift)
    np.testing.assert_allclose(np.cross(x, f).sum(axis=0), 0.0, atol=1e-12 * lift * ball.hole)


def test_a_wall_that_is_pressed_flat_has_no_contact_through_itself() -> None:
    """Both of its sides come as near as two parts that touch, from within."""
    ball = Ball()
    for s in np.linspace(0.0, 0.98, 30):
        assert not ball.push(0.0, s).any()
    assert (ball.folding.contact.history["ignored"][:, 0] > 0.0).any()


def test_convex_shapes_have_no_self_contact() -> None:
    assert not {"sphere", "oblate", "angular"} & set(SHAPES)

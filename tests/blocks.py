"""Blocks of finite elements that meet in one target: what the tests of contact and bonds between bodies share."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from conftest import elastic

from coupler.contact.bodies import BodyContact
from coupler.contact.bond import Bond, penalty
from coupler.contact.surfaces import Surfaces, interface
from coupler.fe import mesh as meshes
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.target.bodies import Bodies
from coupler.target.domain import BodyState

Place = tuple[tuple[float, float, float], float, tuple[float, float, float]]  # edges, element size, lowest corner


def join(bodies: dict[str, meshes.TetMesh]) -> tuple[meshes.TetMesh, np.ndarray]:
    """One mesh of prepared bodies, which share no node, and the body (m,) of each element; sets are "name.top" and so on."""
    first = np.cumsum([0, *(len(mesh.points) for mesh in bodies.values())])
    mesh, _, element = meshes.prepare_ordered(
        np.concatenate([part.points for part in bodies.values()]),
        np.concatenate([part.conn + at for part, at in zip(bodies.values(), first, strict=False)]),
    )
    body = np.repeat(np.arange(len(bodies), dtype=np.int32), [len(part.conn) for part in bodies.values()])[element]
    sets = {}
    for b, name in enumerate(bodies):
        own = np.flatnonzero(body[mesh.facet_element] == b)
        sets |= {f"{name}.{side}": own[ids] for side, ids in meshes.name_sides(mesh.points, mesh.facets[own]).items()}
    return replace(mesh, sets=sets), body


class Blocks:
    """Elastic blocks a, b, c ... in one target, stepped together with their contact and bonds."""

    def __init__(
        self, *places: Place, fixed: tuple[str, ...] = (), material: Any = None, turn: np.ndarray | None = None
    ):
        material = material or elastic()
        turn = np.eye(3) if turn is None else turn
        parts = {}
        for name, (lengths, size, corner) in zip("abcdef", places, strict=False):
            points, tets = mesher.box(lengths, size)
            parts[name] = meshes.prepare((points + corner) @ turn.T, tets)
        mesh, self.body = join(parts)
        self.target = t = Target(mesh, law_record(material), 300.0, fixed=fixed, track_wave=False)
        self.surfaces = Surfaces.of(mesh.facets, mesh.facet_element, self.body)
        self.body_of_node = np.zeros(len(t.nodes.x), int)
        self.body_of_node[mesh.conn.ravel()] = np.repeat(self.body, 4)
        self.K = material.K
        self.contact: BodyContact | None = None
        self.bond: Bond | None = None

    def touch(self, friction: float = 0.0) -> BodyContact:
        self.contact = BodyContact(self.surfaces, self.target.nodes.x, [self.K] * self.surfaces.bodies, friction)
        return self.contact

    def tie(self, **law: float) -> Bond:
        """Bond the second block to the first."""
        t, spacing = self.target, self.surfaces.spacing(self.target.nodes.x, 1)
        found = interface(self.surfaces, t.nodes.x, 1, 0.1 * spacing)
        self.bond = Bond.between(found, self.surfaces, t.nodes.x, penalty(self.K, spacing), **law)
        return self.bond

    def nodes(self, body: int) -> np.ndarray:
        return np.flatnonzero(self.body_of_node == body)

    def velocity(self, body: int) -> np.ndarray:
        mine, t = self.nodes(body), self.target
        return t.mass[mine] @ t.velocity()[mine] / t.mass[mine].sum()

    def energy(self) -> float:
        t, c, b = self.target, self.contact, self.bond
        held = t.kinetic() + t.elastic() + t.balance.plastic + t.balance.numerical
        if c is not None:
            held += c.pairs.penalty_energy + c.pairs.sums.friction_heat + c.pairs.sums.lost
        return float(held + (b.stored + b.dissipated if b is not None else 0.0))

    def moment(self) -> np.ndarray:
        t = self.target
        return np.cross(t.nodes.x, t.mass[:, None] * t.velocity()).sum(axis=0)

    def run(
        self,
        until: float,
        push: np.ndarray | None = None,
        watch: Callable[[], None] | None = None,
        limit: float = np.inf,
    ) -> None:
        """Step to the time `until`, s; push (N,3) N: dead load; watch: called after each step."""
        t, steps, dt = self.target, 0, 0.0
        while t.time < until * (1 - 1e-12):
            if steps % 10 == 0:
                dt = alone = min(t.stable_dt(springs=None if self.bond is None else self.bond.springs()), limit)
                if self.contact is not None:
                    fastest = float(np.linalg.norm(t.nodes.v, axis=1).max())
                    self.contact.search(t.nodes.x, 15 * fastest * dt, self.bond)
                    dt = min(dt, self.contact.stable_dt(t.mass, alone))
            step = min(dt, until - t.time)
            t.advance(step)
            if self.contact is not None:
                self.contact.forces(step, t.nodes.x, t.nodes.v, t.f_ext)
            if self.bond is not None:
                self.bond.forces(t.nodes.x, t.f_ext)
            if push is not None:
                t.f_ext += push
            t.finish()
            steps += 1
            if watch is not None:
                watch()


def touching(contact: BodyContact) -> int:
    """How many nodes touched at the last forces."""
    return int(np.count_nonzero(contact.pairs.depth))


def cubes(side: float) -> Blocks:
    """Two cubes of unlike meshes, one on the other; side in m."""
    return Blocks(((side,) * 3, 0.3 * side, (0, 0, 0)), ((side,) * 3, 0.25 * side, (0, 0, side)))


def pinched(mesh: meshes.TetMesh, share: float) -> meshes.TetMesh:
    """A mesh with one tetrahedron inside pressed flat: by that share of its height."""
    inside = np.setdiff1d(np.arange(len(mesh.points)), mesh.facets.ravel())
    e = next(e for e, nodes in enumerate(mesh.conn) if np.isin(nodes, inside).all())
    a, b, c, d = mesh.points[mesh.conn[e]]
    normal = np.cross(c - b, d - b)
    normal /= np.linalg.norm(normal)
    points = mesh.points.copy()
    points[mesh.conn[e][0]] -= share * np.dot(a - b, normal) * normal
    return meshes.prepare(points, mesh.conn.astype(np.int64))


def block(corner: tuple[float, float, float], stress: float, J: float, law: np.ndarray) -> BodyState:
    """A cube of 20 um, its lowest corner there, under a uniform state."""
    points, tets = mesher.box((20e-6, 20e-6, 20e-6), 5e-6)
    edge = points[tets[:, 1:]] - points[tets[:, :1]]
    turned = np.linalg.det(edge) < 0
    tets[turned, 2:] = tets[turned, 2:][:, ::-1]
    n, m = len(points), len(tets)
    deviator = np.tile([stress, -stress, 0.0, 0.0, 0.0, 0.0], (m, 1))
    mass = float(law["rho"][0]) * 8e-15 / J
    return BodyState(
        points + np.array(corner), tets, deviator, np.full(m, J), np.zeros((n, 3)), np.zeros(n), mass, law,
        eps_p=np.full(m, 0.3), T=np.full(m, 400.0), eps_gradient=np.zeros((m, 3)),
    )  # fmt: skip


def substrate() -> Bodies:
    points, tets = mesher.box((60e-6, 60e-6, 20e-6), 6e-6)
    mesh = meshes.prepare(points - np.array([30e-6, 30e-6, 20e-6]), tets)
    target = Target(mesh, law_record(material("SS304"), rate_filter=1e-9), 300.0, fixed=("bottom",), track_wave=False)
    return Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), (), 0.3)

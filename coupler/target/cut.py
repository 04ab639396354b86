"""Sub-domains of the target: an impact is computed on the part of the bodies around its point of impact, which is then put back.

A sub-domain contains the elements with a node within a radius of the point of impact, whole splats, and a rim around them. The window
of the impact (`fe.window`) has the same radius: nodes beyond its edge do not move, so that the impact has the same numbers as in the
full domain. Elements outside the radius do not change. Sub-domains more than an element apart are independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..contact.bodies import ContactPast
from ..contact.bond import Bond
from ..contact.contact import ContactSums
from ..contact.model import new_history
from ..core.arrays import occurring
from ..core.records import arrays_of, concatenate, copied, take
from ..fe.state import Balance
from ..geometry.tetrahedra import boundary_faces, least_at_corners
from ..geometry.triangles import edges
from .bodies import Bodies
from .domain import SPLAT, Point, Selection, domain_now, merge, select

ROUNDS = 20  # at most, to remove pinched edges from the surface of a sub-domain
R = TypeVar("R")


@dataclass(frozen=True)
class Cut:
    """Record of a sub-domain. part: its domain and indices; nodes, elements: indices in the full domain that its impact can change;
    balance, sums, bonds: energies of its target, its contact and its bonds before the impact."""

    part: Selection
    nodes: np.ndarray
    elements: np.ndarray
    balance: Balance
    sums: ContactSums
    bonds: np.ndarray


def cut_out(whole: Bodies, origin: Point, radius: float) -> tuple[Bodies, Cut]:
    """The sub-domain, numbered outwards from origin (m), and its record. It has the elements within `radius` m of origin, a rim around
    them, and all elements of the splats in both. The full domain changes only by the heat of `Bodies.release_heat`."""
    t = whole.target
    whole.release_heat()
    conn, x = t.mesh.conn, t.nodes.x
    distance = np.linalg.norm(x - np.asarray(origin), axis=1)
    reach = least_at_corners(distance, conn)
    inside = reach < radius
    touched = np.zeros(len(x), bool)
    touched[conn[inside]] = True
    # the rim contains all nodes that have a bond or a contact with a node inside, and all elements around nodes that are not farther
    # away than the farthest moving node
    facets = x[t.mesh.facets[touched[t.mesh.facets].any(axis=1)]]
    longest = float(np.linalg.norm(facets - np.roll(facets, 1, axis=1), axis=2).max(initial=0.0))
    rim = max(1.5 * longest, float(distance[touched].max(initial=0.0)) - radius)
    chosen = reach <= radius + rim
    splats = np.zeros(whole.count, bool)
    splats[whole.body[chosen]] = True
    splats[whole.impact == 0] = False
    chosen |= splats[whole.body]  # whole splats: the contact stiffness depends on the whole surface
    chosen = _without_pinches(conn, chosen)
    selected = select(domain_now(t, whole.body), chosen)
    selected.domain.nodes.node_number[:] = selected.nodes
    selected.domain.elements.element_number[:] = selected.elements
    numbered, rank = merge([selected.domain], origin)
    part = whole.remade(numbered)
    part.impact = whole.impact[selected.bodies]
    part.buried = np.flatnonzero(np.isin(selected.facets, whole.buried))
    index = np.full(len(x), -1)
    index[selected.nodes] = rank
    if (past := whole.past()) is not None and part.count > 1:
        part.touch(past.renumbered(index, len(part.target.nodes.x)))
    if whole.bond is not None:
        part.bond = take(whole.bond, (index[whole.bond.nodes] >= 0) & (index[whole.bond.triangles] >= 0).all(axis=1))
        part.bond.stored = float(part.bond.stored_by_each.sum())
        part.bond.renumber(index)
    elements = np.flatnonzero(inside)
    balance, sums = copied(part.target.balance), _sums(part)
    return part, Cut(selected, occurring(conn[elements], len(x)), elements, balance, sums, _energies(part.bond))


def _without_pinches(conn: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Mask (m,) of the chosen elements and of the elements around pinched edges. A pinched edge belongs to more than two triangles of
    the surface; ray casting needs a surface with a unique inside."""
    n = int(conn.max()) + 1
    for _ in range(ROUNDS):
        a, b = edges(boundary_faces(conn[chosen])[0]).astype(np.int64).T
        key = np.sort(np.minimum(a, b) * n + np.maximum(a, b))
        pinched = np.zeros(n, bool)
        pinched[np.concatenate(np.divmod(key[2:][key[2:] == key[:-2]], n))] = True
        if not pinched.any():
            break
        chosen = chosen | pinched[conn].any(axis=1)
    return chosen


def put_back(whole: Bodies, parts: Sequence[tuple[Cut, Bodies]]) -> Bodies:
    """The full domain in which each computed part replaces its sub-domain. No node may be modified by two parts. New splats are
    numbered after the existing bodies, in the order of the parts. Existing indices do not change."""
    mesh = whole.target.mesh
    domains, count, n, facets = [domain_now(whole.target, whole.body)], whole.count, len(mesh.points), len(mesh.facets)
    placed, buried, before = [], [whole.buried], n
    for cut, part in parts:
        part.release_heat()
        now = domain_now(part.target, part.body)
        node, facet = now.nodes.node_number.copy(), np.full(len(now.mesh.facets), -1)
        facet[: len(cut.part.facets)] = cut.part.facets
        first = len(cut.part.bodies)
        if part.count > first:
            splats = select(now, part.body >= first)
            mesh = splats.domain.mesh
            sets = {f"{SPLAT}{count + k}": mesh.sets[f"{SPLAT}{k}"] for k in range(part.count - first)}
            domains.append(replace(splats.domain, mesh=replace(mesh, sets=sets)))
            node[splats.nodes] = n + np.arange(len(splats.nodes))
            facet[splats.facets] = facets + np.arange(len(splats.facets))
            count, n, facets = count + part.count - first, n + len(splats.nodes), facets + len(splats.facets)
        covered = facet[part.buried]
        buried.append(covered[covered >= 0])
        # indices of its nodes in the new full domain, and those that its impact can change
        placed.append((cut, part, node, (node >= before) | np.isin(node, cut.nodes)))
    domain = merge(domains)[0]
    for cut, part, node, _ in placed:
        _replace(domain.nodes, part.target.nodes, cut.nodes, node)
        _replace(domain.elements, part.target.elements, cut.elements, part.target.elements.element_number)
    new = whole.remade(domain)
    new.impact = np.concatenate([whole.impact, *(part.impact[len(cut.part.bodies) :] for cut, part in parts)])
    new.buried = np.unique(np.concatenate(buried))
    new.target.balance += sum((part.target.balance - cut.balance for cut, part in parts), Balance())
    new.bond = _bonds(whole, placed, *np.sum([_energies(part.bond) - cut.bonds for cut, part in parts], axis=0))
    if new.count > 1:
        past = ContactPast(new_history(len(new.target.nodes.x)))
        if (of_whole := whole.past()) is not None:
            past = of_whole.renumbered(np.arange(before), len(new.target.nodes.x))
        for _, part, node, mine in placed:
            if (of_part := part.past()) is not None:
                past.nodes[node[mine]] = of_part.nodes[mine]
        gain = sum((_sums(part) - cut.sums for cut, part in parts), ContactSums())
        new.touch(ContactPast(past.nodes, past.sums + gain))
    return new


def _sums(bodies: Bodies) -> ContactSums:
    """The energy sums of the contact between bodies."""
    past = bodies.past()
    return ContactSums() if past is None else past.sums


def _energies(bond: Bond | None) -> np.ndarray:
    """Stored and dissipated energy (2,) J of a set of bonds."""
    return np.array((0.0, 0.0) if bond is None else (bond.stored, bond.dissipated))


def _bonds(
    whole: Bodies, parts: Sequence[tuple[Cut, Bodies, np.ndarray, np.ndarray]], stored: float, dissipated: float
) -> Bond | None:
    """Bonds of the full domain that no impact can change, and bonds of the parts that their impacts can change. parts: each with
    the index (p,) of each node in the full domain, and the mask of the nodes that its impact can change; stored, dissipated (J):
    changes of the energies of bonds in the impacts of the parts."""
    bonds = list[Bond]()
    if (bond := whole.bond) is not None:
        stored, dissipated = stored + bond.stored, dissipated + bond.dissipated
        bonds.append(bond)
    for cut, part, node, own in parts:
        if bonds:
            b = bonds[0]
            n = 1 + max(int(b.nodes.max(initial=0)), int(b.triangles.max(initial=0)), int(cut.part.nodes.max()))
            changed, copied = np.zeros((2, n), bool)
            changed[cut.nodes] = copied[cut.part.nodes] = True
            away = _any(b.nodes, b.triangles, changed) & copied[b.nodes] & copied[b.triangles].all(axis=1)
            bonds = [take(b, ~away)]
        if part.bond is not None:
            more = take(part.bond, _any(part.bond.nodes, part.bond.triangles, own))
            more.renumber(node)
            bonds = [concatenate([*bonds, more])]
    return replace(bonds[0], stored=float(stored), dissipated=float(dissipated)) if bonds else None


def _any(nodes: np.ndarray, triangles: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Mask (k,) of the bonds, between nodes (k,) and triangles (k,3), that have at least one node of the mask `which`."""
    return which[nodes] | which[triangles].any(axis=1)


def _replace(record: R, part: R, ids: np.ndarray, index: np.ndarray) -> None:
    """Overwrite each row i in `ids` of a record with the row k of `part` for which index[k] = i; -1: no row of the record."""
    row = np.full(int(index.max()) + 1, -1)
    kept = np.flatnonzero(index >= 0)
    row[index[kept]] = kept
    rows = row[ids]
    values = arrays_of(part)
    for name, array in arrays_of(record).items():
        array[ids] = np.take(values[name], rows, axis=0)

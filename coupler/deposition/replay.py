"""Merge of the files of simultaneous impacts into the files of the run, in the order of the impacts."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files.result import Result
from ..files.store import Store, StoreState
from ..impact.recorder import cell_fields
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.cut import Cut
from .task import Task, TaskResult


@dataclass(frozen=True)
class _Written:
    """Files of a task, and the place of its sub-domain in the full domain. folder, store: folder and state of the files; nodes,
    elements: those of the sub-domain; changed: nodes that the impact can move, all three as indices in the full domain; more: numbers
    of nodes and of elements of its splat; before: simulated time of the earlier impacts, s."""

    folder: Path
    store: StoreState
    nodes: np.ndarray
    elements: np.ndarray
    changed: np.ndarray
    more: tuple[int, int]
    before: float


class BatchReplay:
    """Files of a batch on the full domain. Its impacts are written one after another, each on the bodies after the earlier impacts. The
    data are copies: they can be written after the bodies have changed."""

    def __init__(self, plan: Plan, before: Bodies, after: Bodies):
        """before, after: the bodies before and after the batch."""
        self._points, self._cells = before.target.nodes.x.copy(), before.target.mesh.conn
        self._fields = cell_fields(plan, before)
        self._x_after, self._cells_after = after.target.nodes.x.copy(), after.target.mesh.conn
        self._fields_after = cell_fields(plan, after)
        self._impacts: list[_Written] = []

    def add(self, task: Task, cut: Cut, result: TaskResult, before: float) -> None:
        """Add the files of the next impact of the batch. before: simulated time of the earlier impacts, s."""
        met, left = task.bodies.target, result.bodies.target
        more = len(left.nodes.x) - len(met.nodes.x), len(left.elements.T) - len(met.elements.T)
        indices = met.nodes.node_number, met.elements.element_number
        self._impacts.append(_Written(task.folder, result.store, *indices, cut.nodes, more, before))

    def write(self, store: Store) -> None:
        """Append the files of the tasks to the files of the run; fields of a sub-domain become a part of those of the full domain."""
        for each in self._impacts:
            self._append(store, each)
            self._go_on(each)

    def _append(self, store: Store, part: _Written) -> None:
        own = Result(part.folder)
        for row in part.store.history:
            values = dict(zip(part.store.columns, row.tolist(), strict=True))
            store.record({**values, "time": part.before + values["time"]})
        for domain, steps in part.store.steps.items():
            for step in range(min(steps, len(own.times(domain)))):  # a power failure can lose stored fields
                fields = own.fields(step, domain)
                points, cells, (at_points, inside) = fields.points, fields.cells, fields.split()
                if domain == "target":
                    points, cells = self._points.copy(), self._cells
                    points[part.nodes] = fields.points
                    velocity = np.zeros_like(points)
                    velocity[part.nodes] = at_points["velocity"]
                    whole = {name: values.copy() for name, values in self._fields.items()}
                    for name in inside.keys() - {"body"}:
                        whole[name][part.elements] = inside[name]
                    at_points, inside = {"velocity": velocity}, whole
                store.write(domain, part.before + fields.time, points, cells, at_points, inside)

    def _go_on(self, part: _Written) -> None:
        """Update the full domain to the state after an impact: replace its sub-domain, and add its splat."""
        n, m = len(self._points), len(self._cells)
        changed = np.zeros(n, bool)
        changed[part.changed] = True
        near = changed[self._cells].any(axis=1)  # nodal pressures also change elements beside the sub-domain
        self._points[part.changed] = self._x_after[part.changed]
        self._points = np.concatenate([self._points, self._x_after[n : n + part.more[0]]])
        self._cells = self._cells_after[: m + part.more[1]]
        for name, values in self._fields.items():
            now = self._fields_after[name][: m + part.more[1]]
            self._fields[name] = np.concatenate([values, now[m:]])
            self._fields[name][:m][near] = now[:m][near]

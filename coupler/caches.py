"""Folders in which the program keeps what it need not compute again: compiled kernels and the pace of the machine."""

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

_KERNELS = re.compile(r"kernels-[0-9a-f]{12}")


def user_folder() -> Path:
    """The user's cache folder: $COLDSPRAY_CACHE, or coldspray in $XDG_CACHE_HOME or in ~/.cache."""
    if own := os.environ.get("COLDSPRAY_CACHE"):
        return Path(own)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "coldspray"
    except RuntimeError:  # a user without a home, as in containers
        return Path(tempfile.gettempdir()) / f"coldspray-{os.getuid()}"


def kernel_folder(package: Path, asked: str | None) -> Path:
    """Folder of a package's compiled kernels, another for each state of their sources.

    numba compares the file of a kernel alone, not those of the functions that it calls: in one folder for all states, a kernel would
    keep the strength law from before an update. asked: the user's $NUMBA_CACHE_DIR, which comes first; then the package's own folder,
    then the user's cache folder: the first that can be written. Where none can, a folder for this process alone.
    """
    sources = [path.read_bytes() for path in sorted(package.glob("*/*.py"))]
    state = hashlib.sha256(b"".join(source for source in sources if b"njit" in source)).hexdigest()
    places = [package / "__pycache__", user_folder()]
    if asked:  # perhaps by a process of this program that has started this one
        places.insert(0, Path(asked).parent if _KERNELS.fullmatch(Path(asked).name) else Path(asked))
    for place in places:
        folder = place.absolute() / f"kernels-{state[:12]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    own = tempfile.mkdtemp(prefix="coldspray-")
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return Path(own)

"""Cache folders for compiled kernels and for the measured speed of the machine."""

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
    """The folder for the compiled kernels of a package. Each version of the sources has its own folder.

    numba checks only the source file of a kernel, not the files of functions that the kernel calls. With a single folder, a kernel
    would use an old strength law after an update. The folder is in the first of these places that is writable: `asked`
    ($NUMBA_CACHE_DIR of the user), the folder of the package, the cache folder of the user. If none is writable, it is a temporary
    folder of this process.
    """
    sources = [path.read_bytes() for path in sorted(package.glob("*/*.py"))]
    state = hashlib.sha256(b"".join(source for source in sources if b"njit" in source)).hexdigest()
    places = [package / "__pycache__", user_folder()]
    if asked:  # may be the folder of kernels of a coldspray process that started this one
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

"""An animation of the cross-section as MP4 (written by ffmpeg) or GIF. All pictures have the same extent, colours and scale bar."""

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from ..errors import StoreError
from ..files.outputs import MARK, replacing
from ..files.result import Result
from .picture import colour_range, cross_section, drawable, panels, stage, stored_steps, view
from .words import title

SECONDS = 4.0  # approximate length of a film
RATES = (5.0, 25.0)  # least and greatest number of pictures in a second
REST = 1.5  # s for which the last picture stays
PIXELS = 250  # along the longer side of the particle
SUFFIXES = (".mp4", ".gif")


def animate(
    result: Result, path: str | Path | None = None, field: str = "T", fps: float | None = None,
    stage: Callable[[str], None] = lambda text: None,
) -> Path:  # fmt: skip
    """Write an animation of the cross-section through particle and target, with a picture for each stored step. Returns the path.

    path: an .mp4 file, which needs ffmpeg, or a .gif file; default: `<field>.mp4` (without ffmpeg `<field>.gif`) in the folder of the
    run. field: key in `fields.FIELDS`. fps: pictures in a second; default: the film lasts about SECONDS. stage(text): called with the
    name of each step. Raises StoreError if the run lacks the field, the path has another ending, or the file cannot be written.
    """
    path = Path(path) if path is not None else result.directory / f"{field}{SUFFIXES[ffmpeg() is None]}"
    if path.suffix.lower() not in SUFFIXES:
        raise StoreError(f"cannot write {path}: the name of an animation must end in {' or '.join(SUFFIXES)}")
    if fps is not None and not 0.1 <= fps <= 100:
        raise StoreError(f"fps = {fps:g}: give 0.1 to 100 pictures per second")
    have = drawable(result)
    if not have:
        raise StoreError(f"{result.directory} has no stored step of particle, surface and target: try again later")
    if field not in have:
        raise StoreError(f"{result.directory} has no field {field!r} to draw; it has the fields {', '.join(have)}")
    rate = fps or float(np.clip(stored_steps(result) / SECONDS, *RATES))
    write = _mp4 if path.suffix.lower() == ".mp4" else _gif
    with replacing(path) as part:
        write(part, frames(result, field, stage), rate, round(REST * rate))
    return path


def frames(result: Result, field: str, told: Callable[[str], None] = lambda text: None) -> Iterator[NDArray[np.uint8]]:
    """The pictures (rows, columns, 3), of one size; rows and columns are even, as in a video. told: gets "picture 1 of 9" and so on."""
    at, steps = stage(result), range(stored_steps(result))
    seen = view(result, steps, at)
    sections = [cross_section(result, step, (field,), at, seen, PIXELS) for step in steps]
    ranges, heading = {field: colour_range(sections, field)}, title(result)
    for number, section in enumerate(sections, 1):
        told(f"picture {number} of {len(sections)}")
        canvas = FigureCanvasAgg(panels(section, ranges, heading))
        canvas.draw()
        picture = np.asarray(canvas.buffer_rgba())[..., :3]
        rows, columns = (length - length % 2 for length in picture.shape[:2])
        yield np.ascontiguousarray(picture[:rows, :columns])


def ffmpeg() -> str | None:
    """Path of the ffmpeg program: of the system, else of the optional package imageio-ffmpeg; None if neither is installed."""
    try:
        import imageio_ffmpeg

        bundled = imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):  # a RuntimeError: none for this machine
        bundled = None
    return shutil.which("ffmpeg") or bundled


def _mp4(path: Path, pictures: Iterator[NDArray[np.uint8]], rate: float, rest: int) -> None:
    """Write `rate` pictures per second by ffmpeg, the last one `rest` times more. Raises StoreError if ffmpeg is missing or fails."""
    if (program := ffmpeg()) is None:
        raise StoreError(f"cannot write {path}: ffmpeg is missing: pip install coldspray[film], or write a .gif")
    first = next(pictures)
    rows, columns, _ = first.shape
    command = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{columns}x{rows}", "-r", f"{rate:g}",
               "-i", "-", "-an", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-metadata", f"comment={MARK}",
               "-f", "mp4", str(path)]  # fmt: skip
    with tempfile.TemporaryFile() as errors:
        film = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        with contextlib.suppress(BrokenPipeError), film:  # broken: ffmpeg has failed, its message is raised below
            assert film.stdin is not None
            for picture in chain([first], pictures):
                film.stdin.write(picture.tobytes())
            film.stdin.write(picture.tobytes() * rest)
        if film.returncode:
            errors.seek(0)
            reason = (errors.read().decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise StoreError(f"cannot write {path}: ffmpeg fails ({reason[:200]}); a .gif needs no ffmpeg")


def _gif(path: Path, pictures: Iterator[NDArray[np.uint8]], rate: float, rest: int) -> None:
    images = [Image.fromarray(picture) for picture in pictures]
    images = [image.resize((image.width * 2 // 3, image.height * 2 // 3), Image.Resampling.LANCZOS) for image in images]
    # One palette for all pictures, so that colours keep their meaning
    sample = np.vstack([np.asarray(images[k]) for k in (0, len(images) // 2, -1)])
    palette = Image.fromarray(sample).quantize(colors=256)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    pauses = [round(1000 / rate) * (1 + rest * (k + 1 == len(small))) for k in range(len(small))]
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=pauses, loop=0, optimize=False, comment=MARK.encode()
    )

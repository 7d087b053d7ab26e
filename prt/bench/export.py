"""``prt export``: a finished run as a film: a turntable, or a sequence of lightings, as PNG, EXR and MP4."""

import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from prt.bench.exr import write_exr
from prt.bench.playback import Playback, to_bytes
from prt.bench.run import say
from prt.cache import write_atomically
from prt.errors import PrtError
from prt.metrics.tonemap import exposure_of
from prt.progress import track

KINDS = ("turntable", "relight")
FORMATS = ("png", "exr", "mp4")


def main(
    run: Path, kind: str = "relight", frames: int = 48, size: int = 256, fps: int = 24,
    formats: Sequence[str] = ("png", "mp4"), output: Path | None = None, component: str | None = None,
    lighting: str | None = None,
) -> int:  # fmt: skip
    """Render the frames of a run and write them to ``output`` (by default ``<run>/export/<kind>``).

    All frames have the exposure of the first.

    Args:
        kind: ``turntable``: along the test cameras' way under one lighting; ``relight``: from the first test
            camera, the environment turns, the lamp moves, or the scene's variables do.

    Raises:
        PrtError: for a setting out of range, a run that is not done, MP4 without its package.
    """
    if kind not in KINDS:
        raise PrtError(f"--kind {kind!r} is not one of {', '.join(KINDS)}")
    wrong = [name for name in formats if name not in FORMATS]
    if wrong or not formats:
        raise PrtError(f"--formats {','.join(formats)}: choose from {', '.join(FORMATS)}")
    for name, value, least in (("frames", frames, 1), ("size", size, 8), ("fps", fps, 1)):
        if value < least:
            raise PrtError(f"--{name} {value} must be at least {least}")
    if "mp4" in formats:
        encoder()  # before minutes of rendering, not after
    play = Playback(run, component)
    folder = output or play.folder.path / "export" / kind
    light = play.lighting(lighting)
    views = play.turntable(frames, size) if kind == "turntable" else [play.view(size)] * frames
    turning = kind == "relight"
    exposure, pictures, seconds = 0.0, [], []
    for number, view in enumerate(track(views, f"frames of {play.name}", frames)):
        lit = play.free.moving(light, number / frames) if turning else light
        frame = play.frame(view, lit)
        exposure = exposure or exposure_of(frame.image.numpy())
        seconds.append(frame.seconds)
        pictures.append(to_bytes(frame.image, exposure))
        stem = folder / f"{play.component}_{number:04d}"
        if "exr" in formats:
            write_exr(stem.with_suffix(".exr"), frame.image)
        if "png" in formats:
            write_png(stem.with_suffix(".png"), pictures[-1])
    if "mp4" in formats:
        write_mp4(folder / f"{play.component}.mp4", pictures, fps)
    median = float(np.median(seconds))
    say(f"{frames} frames of {size} x {size}, {1e3 * median:.3g} ms of the method a frame")
    print(folder)
    return 0


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write bytes (H, W, 3); a reader never sees half a file.

    Raises:
        PrtError: if the folder cannot be written.
    """
    content = io.BytesIO()
    Image.fromarray(picture).save(content, "PNG")
    write_atomically(path, content.getvalue(), "--output")


def encoder():
    """The package that brings ffmpeg.

    Raises:
        PrtError: where it is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise PrtError(
            "MP4 needs the package imageio-ffmpeg: pip install 'prt[export]'; or choose --formats png,exr"
        ) from error
    return imageio_ffmpeg


def write_mp4(path: Path, pictures: Sequence[np.ndarray], fps: int) -> None:
    """H.264 that every player reads, (H, W, 3) bytes a frame; odd sizes lose a row or column.

    Raises:
        PrtError: if it cannot be written.
    """
    height, width = (side - side % 2 for side in pictures[0].shape[:2])
    temporary = path.with_suffix(".part.mp4")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        writer = encoder().write_frames(
            str(temporary), (width, height), fps=fps, codec="libx264", pix_fmt_out="yuv420p",
            macro_block_size=1, output_params=["-crf", "16", "-movflags", "+faststart"],
        )  # fmt: skip
        writer.send(None)
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture[:height, :width]))
        writer.close()
        os.replace(temporary, path)
    except OSError as error:
        raise PrtError(f"cannot write {path}: {' '.join(str(error).split())}") from error

"""Reading environment maps: Radiance ``.hdr`` and OpenEXR ``.exr``, to linear RGB."""

import re
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError

SUFFIXES = (".hdr", ".exr")


def read_image(path: Path) -> Float[Tensor, "H W 3"]:
    """The linear RGB values of an image file, float32, top row first.

    Raises:
        PrtError: if the file is missing, of another kind, or damaged.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise PrtError(f"cannot read environment map {path}: its suffix must be one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise PrtError(f"environment map not found: {path}")
    try:
        pixels = read_rgbe(path.read_bytes()) if suffix == ".hdr" else _read_exr(path)
    except (ValueError, IndexError, KeyError, RuntimeError, OSError) as error:
        raise PrtError(f"cannot read environment map {path}: {error}; replace the file") from error
    return torch.from_numpy(np.ascontiguousarray(pixels, dtype=np.float32))


def read_rgbe(blob: bytes) -> np.ndarray:
    """Decode a Radiance picture (Ward, "Real Pixels", Graphics Gems II): shared-exponent RGB, (H, W, 3).

    Flat and run-length encoded scanlines of the usual orientation (-Y +X); the header's EXPOSURE divides.

    Raises:
        ValueError: if it is something else, or cut short.
    """
    end = blob.find(b"\n\n")
    if not blob.startswith(b"#?") or end < 0:
        raise ValueError("no Radiance header")
    header = blob[:end].decode("latin-1")
    if "FORMAT=" in header and "FORMAT=32-bit_rle_rgbe" not in header:
        raise ValueError("only FORMAT=32-bit_rle_rgbe is known")
    size_end = blob.index(b"\n", end + 2)
    size = re.fullmatch(rb"-Y (\d+) \+X (\d+)", blob[end + 2 : size_end].strip())
    if size is None:
        raise ValueError(f"orientation {blob[end + 2 : size_end]!r} is not '-Y height +X width'")
    height, width = int(size[1]), int(size[2])
    data = np.frombuffer(blob, np.uint8, offset=size_end + 1)
    marker = data[:4].tolist()
    run_length = 8 <= width < 32768 and marker == [2, 2, width >> 8, width & 255]
    if run_length:
        rgbe = _decode_scanlines(data, height, width)
    elif data.size >= 4 * height * width:
        rgbe = data[: 4 * height * width].reshape(height, width, 4)
    else:
        raise ValueError("the file is cut short (or uses the old run-length encoding)")
    exposure = float(np.prod([float(x) for x in re.findall(r"^EXPOSURE=\s*(\S+)", header, re.M)]))
    scale = np.where(rgbe[..., 3] > 0, np.ldexp(1.0, rgbe[..., 3].astype(np.int32) - 136), 0.0)
    # no half step is added to the bytes: black stays black, as in Mitsuba's reader
    return rgbe[..., :3] * scale[..., None] / exposure


def _decode_scanlines(data: np.ndarray, height: int, width: int) -> np.ndarray:
    """Each scanline: 4 bytes of marker, then R, G, B, E rows, each as runs (count > 128) and literals."""
    out = np.empty((height, 4, width), np.uint8)
    at = 0
    for line in out:
        if data[at : at + 4].tolist() != [2, 2, width >> 8, width & 255]:
            raise ValueError("a scanline has no marker: the file is damaged")
        at += 4
        for row in line:
            x = 0
            while x < width:
                count = int(data[at])
                if count > 128:
                    count -= 128
                    values = data[at + 1 : at + 2]
                    at += 2
                else:
                    values = data[at + 1 : at + 1 + count]
                    at += 1 + count
                if count == 0 or x + count > width or at > data.size:
                    raise ValueError("a run leaves its scanline: the file is damaged")
                row[x : x + count] = values
                x += count
    return out.transpose(0, 2, 1)


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name.split(".")[-1].upper(): channel.pixels for name, channel in file.channels().items()}
    if all(name in channels for name in "RGB"):
        return np.stack([channels[name] for name in "RGB"], -1)
    if "Y" in channels:
        return np.repeat(np.asarray(channels["Y"])[..., None], 3, -1)
    raise ValueError(f"its channels {sorted(channels)} are neither R, G, B nor Y")

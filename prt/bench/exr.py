"""Linear images as OpenEXR files, 32-bit so that metrics recomputed from them are the same numbers."""

import os
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


def write_exr(path: Path, image: Float[Tensor, "H W 3"]) -> None:
    """Write linear radiance; a reader never sees half a file.

    Raises:
        PrtError: if the folder cannot be written.
    """
    import OpenEXR

    temporary = path.with_name(path.stem + ".part.exr")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = np.ascontiguousarray(image.detach().cpu().numpy().astype(np.float32))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        OpenEXR.File(header, {"RGB": pixels}).write(str(temporary))
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise PrtError(f"cannot write {path}: {error}; choose another run.folder or free the disk") from error


def read_exr(path: Path) -> Float[Tensor, "H W 3"]:
    """Read it back.

    Raises:
        PrtError: if the file is missing or damaged.
    """
    import OpenEXR

    if not path.exists():
        raise PrtError(f"image not found: {path}; it is kept only with run.images.save=true")
    try:
        with OpenEXR.File(str(path)) as file:
            return torch.from_numpy(np.ascontiguousarray(file.channels()["RGB"].pixels, dtype=np.float32))
    except (OSError, RuntimeError, KeyError) as error:
        raise PrtError(f"cannot read {path}: {error}; delete the run folder and run again") from error

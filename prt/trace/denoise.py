"""Open Image Denoise (Intel), through ``mitsuba-oidn``; the same on references and on path-traced methods."""

from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


def available() -> str | None:
    """None where the denoiser works, else why not."""
    try:
        import mitsuba_oidn  # noqa: F401
    except (ImportError, OSError) as error:
        return f"mitsuba-oidn cannot be loaded ({error}); pip install mitsuba-oidn"
    return None


def denoise(
    image: Float[Tensor, "H W 3"],
    albedo: Float[Tensor, "H W 3"] | None = None,
    normal: Float[Tensor, "H W 3"] | None = None,
    kind: Literal["RT", "RTLightmap"] = "RT",
) -> Float[Tensor, "H W 3"]:
    """Remove Monte Carlo noise from a linear radiance image of any component.

    Args:
        image: linear, unbounded. Negative values, which an image of differences may hold, are kept out of the
            filter and come back as zero: radiance is not negative.
        albedo: in [0, 1], zero where no surface is; noise-free (from the G-buffer).
        normal: world space, zero where no surface is; only used together with ``albedo``.
        kind: the filter: ``RT`` for images, ``RTLightmap`` for lightmaps, which takes no guides.

    Raises:
        PrtError: if the denoiser is missing, shapes differ, or the image holds NaN or infinity.
    """
    problem = available()
    if problem:
        raise PrtError(f"denoising was asked for, but {problem}; or switch denoising off")
    if normal is not None and albedo is None:
        raise PrtError("denoise normal=... needs albedo as well: the filter takes a normal only beside it")
    arrays = {}
    for name, value in (("image", image), ("albedo", albedo), ("normal", normal)):
        if value is None:
            continue
        if value.shape != image.shape or value.ndim != 3 or value.shape[2] != 3:
            raise PrtError(
                f"denoise {name} of shape {tuple(value.shape)}: all must be (H, W, 3), as the image"
            )
        if not bool(torch.isfinite(value).all()):
            raise PrtError(f"denoise {name} holds NaN or infinite values; find out where they began")
        arrays[name] = np.ascontiguousarray(value.detach().cpu().numpy(), dtype=np.float32)
    from prt.scene.mitsuba_setup import mitsuba

    mitsuba()  # before the extension, which shares Dr.Jit's thread pool
    import mitsuba_oidn

    colour = np.maximum(arrays["image"], 0)
    peak = float(colour.max(initial=0.0))
    if peak == 0.0:
        return torch.zeros_like(image, dtype=torch.float32)
    guides = {name: arrays[name] for name in ("albedo", "normal") if name in arrays}
    # the filter's own estimate of the exposure is the log average of luminance, which a mostly black image
    # (indirect light without background) drives astray; scale by the mean of what is lit instead
    scale = 0.18 / float(colour[colour.max(axis=2) > 0].mean())
    out = mitsuba_oidn.denoise(
        colour, **guides, hdr=True, clean_aux=bool(guides), input_scale=scale, filter=kind
    )
    return torch.from_numpy(np.maximum(np.asarray(out), 0)).to(image.device)

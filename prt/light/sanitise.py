"""Bad radiance in a lighting is refused by name, or mended where the user says so."""

import warnings

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


def sanitise(radiance: Float[Tensor, "*B 3"], name: str, mend: bool = False) -> Float[Tensor, "*B 3"]:
    """``radiance`` itself where every value is finite and not negative; black and very bright maps are valid.

    Args:
        radiance: a cubemap or an image, linear RGB in the last dimension.
        name: of the lighting, for the message.
        mend: NaN and negative become 0, +infinity the largest finite value of the map (0 without one), with a
            warning.

    Raises:
        PrtError: for a bad texel and ``mend=False``, or an empty or wrongly shaped map; names the lighting.
    """
    if radiance.ndim < 2 or radiance.shape[-1] != 3 or radiance.numel() == 0:
        raise PrtError(
            f"lighting {name!r} has shape {tuple(radiance.shape)}; RGB in the last dimension is needed"
        )
    counts = {
        "NaN": radiance.isnan(),
        "infinite": radiance.isinf(),
        "negative": (radiance < 0) & ~radiance.isinf(),
    }
    found = [f"{int(bad.any(-1).sum())} {kind}" for kind, bad in counts.items() if bad.any()]
    if not found:
        return radiance
    total = radiance[..., 0].numel()
    what = f"lighting {name!r} has {', '.join(found)} of {total} texels"
    if not mend:
        raise PrtError(
            f"{what}; radiance must be finite and not negative: mend the file or set lighting.mend=true"
        )
    warnings.warn(f"{what}; mended", stacklevel=2)
    finite = radiance[radiance.isfinite()]
    brightest = float(finite.max().clamp_min(0)) if finite.numel() else 0.0
    return torch.nan_to_num(radiance, nan=0.0, posinf=brightest, neginf=0.0).clamp_min(0)

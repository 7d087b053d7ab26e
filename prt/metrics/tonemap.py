"""From linear radiance to the sRGB image that perceptual metrics and figures look at."""

import numpy as np
from jaxtyping import Float

#: the percentile of the reference's brightness that the exposure maps to TARGET
PERCENTILE = 95.0
TARGET = 0.8


def exposure_of(reference: Float[np.ndarray, "H W 3"]) -> float:
    """The scale taken from a reference image, to be used for it and for everything compared with it.

    It maps the 95th percentile of the per-pixel maximum channel, over the pixels that are not black, to 0.8
    linear (0.906 in sRGB). Black pixels are left out because they are background in most views. 1.0 for an
    all-black reference.
    """
    brightest = np.asarray(reference, dtype=np.float64).max(axis=-1)
    lit = brightest[brightest > 0]
    return float(TARGET / np.percentile(lit, PERCENTILE)) if lit.size else 1.0


def srgb_oetf(linear: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The sRGB opto-electronic transfer function (IEC 61966-2-1) of values in [0, 1]."""
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def to_srgb(image: Float[np.ndarray, "H W 3"], exposure: float) -> Float[np.ndarray, "H W 3"]:
    """Scale by ``exposure``, clip to [0, 1], encode; float64 in [0, 1]."""
    return srgb_oetf(np.clip(np.asarray(image, dtype=np.float64) * exposure, 0.0, 1.0))

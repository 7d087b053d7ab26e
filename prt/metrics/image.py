"""What each image metric computes, on float64 arrays; their definitions in words stand in ``registry.py``.

Every function takes (prediction, reference), both (H, W, 3), finite, in the domain the registry states.
"""

import numpy as np
from jaxtyping import Float

Image = Float[np.ndarray, "H W 3"]

#: PSNR of identical images; keeps means and intervals finite (99 dB is far above any reference's noise floor)
PSNR_CAP = 99.0
#: the epsilon of MAPE, as a share of the reference's mean
MAPE_EPSILON = 0.01
#: side of scikit-image's Gaussian window at sigma 1.5
SSIM_WINDOW = 11


class MetricUnavailable(Exception):
    """The metric cannot be computed on this machine or this image; the message says why."""


def psnr(prediction: Image, reference: Image) -> float:
    mse = np.mean((prediction - reference) ** 2)
    return float(min(-10.0 * np.log10(mse), PSNR_CAP)) if mse > 0 else PSNR_CAP


def ssim(prediction: Image, reference: Image) -> float:
    """Structural similarity with the settings of Wang et al. 2004."""
    from skimage.metrics import structural_similarity

    if min(reference.shape[:2]) < SSIM_WINDOW:
        raise MetricUnavailable(f"SSIM needs images of at least {SSIM_WINDOW} pixels a side")
    return float(
        structural_similarity(
            prediction,
            reference,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1.0,
            channel_axis=-1,
        )
    )


def flip(prediction: Image, reference: Image) -> float:
    """Mean LDR-FLIP (Andersson et al. 2020), by its authors' own implementation."""
    return float(flip_map(prediction, reference).mean())


def flip_map(prediction: Image, reference: Image) -> Float[np.ndarray, "H W"]:
    """FLIP per pixel, in [0, 1], of two sRGB images; for error figures."""
    import flip_evaluator

    reference = np.ascontiguousarray(reference, dtype=np.float32)
    prediction = np.ascontiguousarray(prediction, dtype=np.float32)
    errors, _, _ = flip_evaluator.evaluate(reference, prediction, "LDR", applyMagma=False)
    return np.asarray(errors)[..., 0]


def mape(prediction: Image, reference: Image) -> float:
    # an all-black reference has no scale of its own: the epsilon then stands for a mean of 1
    epsilon = MAPE_EPSILON * (float(reference.mean()) or 1.0)
    return float(np.mean(np.abs(prediction - reference) / (np.abs(reference) + epsilon)))


def mae(prediction: Image, reference: Image) -> float:
    return float(np.mean(np.abs(prediction - reference)))


def rmse(prediction: Image, reference: Image) -> float:
    return float(np.sqrt(np.mean((prediction - reference) ** 2)))

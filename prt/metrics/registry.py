"""Metrics as data: name, direction, unit, domain and definition of each, and the one way to evaluate them.

Tables, charts and claims follow from these entries; nothing else knows which way is better.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.metrics import image
from prt.metrics.image import MetricUnavailable
from prt.metrics.lpips import lpips
from prt.metrics.tonemap import exposure_of, to_srgb

Direction = Literal["higher", "lower"]
BAD_PIXELS = "bad_pixels"


@dataclass(frozen=True)
class Metric:
    """One image metric.

    Attributes:
        name: as it stands in results files.
        label: as it stands in tables and on axes.
        direction: which way is better.
        unit: "" where the metric is a pure number.
        domain: "srgb" for images exposed, clipped and encoded to [0, 1]; "linear" for radiance.
        definition: one sentence.
        function: (prediction, reference) in that domain to a number; may raise ``MetricUnavailable``.
    """

    name: str
    label: str
    direction: Direction
    unit: str
    domain: Literal["srgb", "linear"]
    definition: str
    function: Callable[[image.Image, image.Image], float]


_ALL = (
    Metric(
        "psnr", "PSNR", "higher", "dB", "srgb",
        "Peak signal-to-noise ratio over all pixels and channels, data range 1, "
        f"capped at {image.PSNR_CAP:g} dB (identical images).",
        image.psnr,
    ),
    Metric(
        "ssim", "SSIM", "higher", "", "srgb",
        "Mean structural similarity over pixels and channels (scikit-image, Gaussian window of sigma 1.5, "
        "population covariance, data range 1).",
        image.ssim,
    ),
    Metric(
        "lpips", "LPIPS", "lower", "", "srgb",
        "Learnt perceptual distance of Zhang et al. 2018, AlexNet, version 0.1.",
        lpips,
    ),
    Metric(
        "flip", "FLIP", "lower", "", "srgb",
        "Mean LDR-FLIP of Andersson et al. 2020 (flip-evaluator) at 67 pixels per degree.",
        image.flip,
    ),
    Metric(
        "mape", "MAPE", "lower", "", "linear",
        "Mean over pixels and channels of |prediction - reference| / (|reference| + epsilon), as a fraction, "
        f"epsilon {image.MAPE_EPSILON:g} times the mean of the reference.",
        image.mape,
    ),
    Metric("mae", "MAE", "lower", "radiance", "linear", "Mean absolute error, all channels.", image.mae),
    Metric("rmse", "RMSE", "lower", "radiance", "linear", "Root of the mean squared error.", image.rmse),
)  # fmt: skip
METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL}


def evaluate(
    prediction: Float[np.ndarray, "H W 3"] | Float[Tensor, "H W 3"],
    reference: Float[np.ndarray, "H W 3"] | Float[Tensor, "H W 3"],
    names: Sequence[str] | None = None,
    exposure: float | None = None,
) -> dict[str, float]:
    """The named metrics of one image, and ``bad_pixels``.

    No pixel is dropped: pixels of the prediction with a NaN or infinite channel are counted in the extra key
    ``bad_pixels`` and enter every metric as black. A metric that cannot be computed here (no LPIPS weights,
    an image too small) is NaN, with its reason in one warning; never a made-up number.

    Args:
        prediction: linear radiance.
        reference: linear radiance, finite.
        names: keys of ``METRICS``; all by default.
        exposure: scale before the sRGB encoding; ``exposure_of(reference)`` by default.

    Raises:
        PrtError: for an unknown metric, unequal or wrong shapes, or a reference that is not finite.
    """
    chosen = [metric_of(name) for name in (METRICS if names is None else names)]
    predicted, truth = _array(prediction, "prediction"), _array(reference, "reference")
    if predicted.shape != truth.shape:
        raise PrtError(
            f"prediction is {predicted.shape} but reference is {truth.shape}; render both at one image size"
        )
    if not np.isfinite(truth).all():
        count = int((~np.isfinite(truth).all(axis=-1)).sum())
        raise PrtError(f"reference has {count} pixels that are NaN or infinite; render it again")

    bad = ~np.isfinite(predicted).all(axis=-1)
    predicted = np.where(bad[..., None], 0.0, predicted)
    exposure = exposure_of(truth) if exposure is None else exposure
    pairs = {"linear": (predicted, truth)}
    if any(metric.domain == "srgb" for metric in chosen):
        pairs["srgb"] = (to_srgb(predicted, exposure), to_srgb(truth, exposure))
    values = {metric.name: _value(metric, *pairs[metric.domain]) for metric in chosen}
    return values | {BAD_PIXELS: float(bad.sum())}


def metric_of(name: str) -> Metric:
    """The metric called ``name``.

    Raises:
        PrtError: if there is none; lists those there are.
    """
    if name not in METRICS:
        raise PrtError(f"unknown metric {name!r}; choose from {', '.join(METRICS)}")
    return METRICS[name]


def _array(value: np.ndarray | Tensor, what: str) -> Float[np.ndarray, "H W 3"]:
    array = value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise PrtError(f"{what} has shape {array.shape}; metrics take a non-empty image of shape (H, W, 3)")
    return array.astype(np.float64)


_warned: set[str] = set()


def _value(metric: Metric, prediction: image.Image, reference: image.Image) -> float:
    try:
        return metric.function(prediction, reference)
    except MetricUnavailable as error:
        reason = str(error)
        if reason not in _warned:
            _warned.add(reason)
            warnings.warn(f"{metric.label} is not reported (NaN): {reason}", stacklevel=3)
        return float("nan")

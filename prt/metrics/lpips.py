"""LPIPS v0.1 (Zhang et al. 2018), the learnt perceptual distance, on AlexNet or SqueezeNet 1.1 features.

The networks are written out here so that the weights alone are needed: from ``PRT_DATA/lpips``, or
torchvision's own download for the backbone with the heads that the ``lpips`` package ships.
"""

import functools
import importlib.util
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from safetensors.torch import load_file
from torch import Tensor

from prt.metrics.image import Image, MetricUnavailable
from prt.paths import data_folder

Weights = dict[str, Tensor]

#: AlexNet's own smallest input: below it the last feature maps vanish
SMALLEST = 63
# Mean and standard deviation of ImageNet, for inputs in [-1, 1] (the "scaling layer" that v0.1 added).
SHIFT = torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)
SCALE = torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)


def lpips(prediction: Image, reference: Image) -> float:
    """AlexNet LPIPS of two sRGB images in [0, 1].

    Raises:
        MetricUnavailable: if the weights are missing or the image is smaller than the network takes.
    """
    if min(reference.shape[:2]) < SMALLEST:
        raise MetricUnavailable(f"LPIPS needs images of at least {SMALLEST} pixels a side")
    reason = lpips_unavailable("alex")
    if reason:
        raise MetricUnavailable(reason)
    return float(distance(_signed(prediction), _signed(reference), "alex"))


def _signed(image: Image) -> Float[Tensor, "1 3 H W"]:
    """An image in [0, 1] as the batch in [-1, 1] that LPIPS is defined on."""
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))).float()[None] * 2 - 1


@torch.no_grad()
def distance(a: Float[Tensor, "N 3 H W"], b: Float[Tensor, "N 3 H W"], network: str) -> Float[Tensor, "N"]:
    """LPIPS of two batches of images in [-1, 1].

    At each tapped layer the features are normalised over channels; their squared differences are weighted
    by the learnt head, averaged over pixels, and summed over layers (Zhang et al. 2018, equation 1).
    """
    features, total = NETWORKS[network], torch.zeros(a.shape[0])
    weights = _weights(network)
    for level, (f, g) in enumerate(
        zip(features((a - SHIFT) / SCALE, weights), features((b - SHIFT) / SCALE, weights), strict=True)
    ):
        difference = (_unit(f) - _unit(g)) ** 2
        total += F.conv2d(difference, weights[f"lin{level}.weight"]).mean(dim=(1, 2, 3))
    return total


def _unit(features: Float[Tensor, "N C H W"]) -> Float[Tensor, "N C H W"]:
    return features / (features.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)


def _conv(x: Tensor, w: Weights, name: str, stride: int = 1, padding: int = 0) -> Tensor:
    return F.relu(F.conv2d(x, w[f"{name}.weight"], w[f"{name}.bias"], stride, padding))


def _alexnet(x: Float[Tensor, "N 3 H W"], w: Weights) -> list[Tensor]:
    """The five rectified convolutions of AlexNet (torchvision's numbering)."""
    x1 = _conv(x, w, "features.0", stride=4, padding=2)
    x2 = _conv(F.max_pool2d(x1, 3, 2), w, "features.3", padding=2)
    x3 = _conv(F.max_pool2d(x2, 3, 2), w, "features.6", padding=1)
    x4 = _conv(x3, w, "features.8", padding=1)
    x5 = _conv(x4, w, "features.10", padding=1)
    return [x1, x2, x3, x4, x5]


def _fire(x: Tensor, w: Weights, number: int) -> Tensor:
    x = _conv(x, w, f"features.{number}.squeeze")
    wide = _conv(x, w, f"features.{number}.expand3x3", padding=1)
    return torch.cat([_conv(x, w, f"features.{number}.expand1x1"), wide], dim=1)


def _squeezenet(x: Float[Tensor, "N 3 H W"], w: Weights) -> list[Tensor]:
    """The seven taps of SqueezeNet 1.1 that LPIPS uses (torchvision's numbering)."""

    def pool(y: Tensor) -> Tensor:
        return F.max_pool2d(y, 3, 2, ceil_mode=True)

    x1 = _conv(x, w, "features.0", stride=2)
    x2 = _fire(_fire(pool(x1), w, 3), w, 4)
    x3 = _fire(_fire(pool(x2), w, 6), w, 7)
    x4 = _fire(pool(x3), w, 9)
    x5 = _fire(x4, w, 10)
    x6 = _fire(x5, w, 11)
    return [x1, x2, x3, x4, x5, x6, _fire(x6, w, 12)]


NETWORKS = {"alex": _alexnet, "squeeze": _squeezenet}


def lpips_unavailable(network: str = "alex") -> str | None:
    """Why LPIPS cannot be computed here, or None where it can; may download the backbone (once)."""
    try:
        _weights(network)
    except MetricUnavailable as error:
        return str(error)
    return None


def _weights(network: str) -> Weights:
    folder = data_folder()
    return _load(network, folder / "lpips" / f"{network}.safetensors" if folder else None)


@functools.lru_cache(maxsize=4)
def _load(network: str, path: Path | None) -> Weights:
    if path is not None and path.exists():
        try:
            return load_file(path)
        except Exception as error:  # safetensors raises its own type on a damaged file
            reason = f"LPIPS weights {path} cannot be read ({error}); fetch the file again"
            raise MetricUnavailable(reason) from error
    if importlib.util.find_spec("torchvision") is None or importlib.util.find_spec("lpips") is None:
        expected = f"expected {path}" if path else "PRT_DATA is not set"
        raise MetricUnavailable(
            f"LPIPS has no weights: {expected}, and torchvision and lpips are not both installed; "
            "set PRT_DATA or `pip install prt[lpips]`"
        )
    got = _from_packages(network)
    if isinstance(got, str):
        raise MetricUnavailable(got)
    return got


# Kept, failure included: without a network every image would wait for another failed download.
@functools.lru_cache(maxsize=2)
def _from_packages(network: str) -> Weights | str:
    """The backbone through torchvision's download, the heads from the files of the ``lpips`` package.

    Returns the reason where that fails.
    """
    spec = importlib.util.find_spec("lpips")  # found, not imported: importing it would load every network
    heads = Path(spec.origin).parent / "weights" / "v0.1" / f"{network}.pth"
    name = {"alex": "alexnet", "squeeze": "squeezenet1_1"}[network]
    try:
        from torchvision import models  # pyright: ignore[reportMissingImports]

        backbone = models.get_model(name, weights="IMAGENET1K_V1").state_dict()
        learnt = torch.load(heads, map_location="cpu", weights_only=True)
    except Exception as error:  # network, disk or version trouble: all mean the same to the user
        return (
            f"LPIPS weights could not be got through torchvision and lpips ({error}); "
            f"put {network}.safetensors into PRT_DATA/lpips instead"
        )
    weights = {key: value for key, value in backbone.items() if key.startswith("features.")}
    return weights | {key.replace(".model.1.", "."): value for key, value in learnt.items()}

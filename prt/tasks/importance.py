"""Where training points matter: the statistics behind the sampling strategies of Raghavan 2023, figure 2."""

import torch
import torch.nn.functional as functional
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.scene.gbuffer import GBuffer


def specular(gbuffer: GBuffer) -> Float[Tensor, "N"]:
    """k_s (1 - sigma), averaged over the colours."""
    return gbuffer.specular.mean(dim=1) * (1 - gbuffer.roughness[:, 0])


def high_frequency(
    image: Float[Tensor, "H W 3"], hit: Bool[Tensor, "P"], radius: int = 2
) -> Float[Tensor, "N"]:
    """|I - lowpass(I)| at the hit pixels; the low-pass is a box over the hit pixels around each."""
    mask = hit.view(1, 1, *image.shape[:2]).float()
    mean = image.mean(dim=2)[None, None] * mask
    size = 2 * radius + 1
    total, weight = (functional.avg_pool2d(x, size, stride=1, padding=radius) for x in (mean, mask))
    return (mean - total / weight.clamp(min=1e-6)).abs()[0, 0].flatten()[hit]


def view_variance(
    position: Float[Tensor, "N 3"], radiance: Float[Tensor, "N 3"], view: Int[Tensor, "N"], cells: int = 48
) -> Float[Tensor, "N"]:
    """How much the radiance of one small cell of the surface varies between the views that see it."""
    low, high = position.min(dim=0).values, position.max(dim=0).values
    cell = ((position - low) / (high - low).max().clamp(min=1e-9) * (cells - 1)).long()
    cell = (cell[:, 0] * cells + cell[:, 1]) * cells + cell[:, 2]
    views = int(view.max()) + 1
    pair, pair_of_point = torch.unique(cell * views + view, return_inverse=True)
    seen = torch.bincount(pair_of_point).float()
    mean = torch.zeros(len(pair)).index_add_(0, pair_of_point, radiance.mean(dim=1)) / seen
    _, cell_of_pair = torch.unique(pair // views, return_inverse=True)
    count = torch.bincount(cell_of_pair).float()
    first = torch.zeros(len(count)).index_add_(0, cell_of_pair, mean) / count
    second = torch.zeros(len(count)).index_add_(0, cell_of_pair, mean.square()) / count
    variance = (second - first.square()).clamp(min=0)
    return variance[cell_of_pair][pair_of_point]

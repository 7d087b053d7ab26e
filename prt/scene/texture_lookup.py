"""Bilinear lookups in textures whose texel (i, j) has its centre at ((j + 0.5) / W, (i + 0.5) / H)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def corners(
    uv: Float[Tensor, "N 2"], height: int, width: int
) -> tuple[Int[Tensor, "N 4"], Float[Tensor, "N 4"]]:
    """The four texels around each place: flat index ``row * width + column``, and bilinear weight."""
    last = torch.tensor([width - 1, height - 1], dtype=uv.dtype, device=uv.device)
    place = (uv * (last + 1) - 0.5).clamp_min(0).minimum(last)
    low = place.floor()
    (x1, y1), (x0, y0) = (place - low).T, (1 - (place - low)).T
    (left, top), (right, bottom) = low.long().T, (low + 1).minimum(last).long().T
    index = torch.stack([t * width + s for t in (top, bottom) for s in (left, right)], dim=1)
    return index, torch.stack([y * x for y in (y0, y1) for x in (x0, x1)], dim=1)


def bilinear(
    texels: Float[Tensor, "T C"], size: tuple[int, int], uv: Float[Tensor, "N 2"]
) -> Float[Tensor, "N C"]:
    """Values of an H x W texture, its texels row by row, at places in [0, 1]^2."""
    index, share = corners(uv, *size)
    # the one torch operation that weighs and sums gathered rows without writing the rows down
    return torch.nn.functional.embedding_bag(index, texels, per_sample_weights=share, mode="sum")

"""Points spread evenly by area over triangles (Turk 1990, "Generating Random Points in Triangles")."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def by_area(
    area: Float[Tensor, "F"], random: Float[Tensor, "N 3"], strata: Tensor | None = None
) -> tuple[Int[Tensor, "N"], Float[Tensor, "N 2"]]:
    """Triangles and barycentric weights of their second and third corner.

    Args:
        area: of each triangle in any unit, float64, not all zero.
        random: even numbers in [0, 1), float64.
        strata: which of ``len(strata)`` equal shares of the whole area each point lies in; None: anywhere.
    """
    total = area.cumsum(0)
    place = random[:, 0] if strata is None else (strata + random[:, 0]) / len(strata)
    triangle = torch.searchsorted(total, place * total[-1]).clamp(max=len(total) - 1)
    root, share = random[:, 1].sqrt(), random[:, 2]
    return triangle, torch.stack([root * (1 - share), root * share], 1)


def triangle_areas(corners: Float[Tensor, "F 3 3"]) -> Float[Tensor, "F"]:
    """Areas, float64."""
    a, b, c = corners.double().unbind(1)
    return torch.linalg.cross(b - a, c - a).norm(dim=1) / 2

"""Places in regular grids, as features are interpolated from them."""

from jaxtyping import Float, Int
from torch import Tensor


def cells(x: Float[Tensor, "*N"], count: int) -> tuple[Int[Tensor, "*N"], Float[Tensor, "*N"]]:
    """Which of ``count`` cells of [0, 1] a value lies in and where in it; values outside are clamped."""
    place = x.clamp(0, 1) * count
    cell = place.long().clamp(max=count - 1)  # truncation is floor: nothing is negative
    return cell, place - cell

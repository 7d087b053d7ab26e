"""Frames about directions."""

import torch
from jaxtyping import Float
from torch import Tensor


def perpendicular(axis: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Two unit vectors that complete each unit axis to a frame.

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
    """
    x, y, z = axis.unbind(1)
    sign = torch.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1),
        torch.stack([b, sign + y * y * a, -y], 1),
    )

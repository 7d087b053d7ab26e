"""Fixed encodings of network inputs."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


def one_blob(x: Float[Tensor, "*N D"], bins: int) -> Float[Tensor, "*N DB"]:
    """One-blob encoding (Mueller et al. 2019, Neural Importance Sampling, section 4.3).

    Each value in [0, 1] becomes ``bins`` values: a Gaussian of standard deviation ``1 / bins`` around it,
    evaluated at the centres of the bins.
    """
    if not isinstance(bins, int) or bins < 1:
        raise PrtError(f"one-blob bins={bins!r} must be an integer of at least 1")
    centres = (torch.arange(bins, device=x.device, dtype=x.dtype) + 0.5) / bins
    return torch.exp(-0.5 * ((x[..., None] - centres) * bins).square()).flatten(-2)


def log_roughness(roughness: Tensor) -> Tensor:
    """log(25 sigma + 1) / log(26): more room for low roughness (Raghavan 2023, section 5)."""
    return torch.log1p(25 * roughness) / math.log(26)

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


def frequencies(x: Float[Tensor, "*N D"], octaves: int) -> Float[Tensor, "*N C"]:
    """Positional encoding (Mildenhall et al. 2020, NeRF, equation 4), ``C = D (1 + 2 octaves)``.

    The values themselves, then for each octave j from 0 the sines of ``2^j pi x``, then their cosines.

    Raises:
        PrtError: for a negative number of octaves.
    """
    if not isinstance(octaves, int) or octaves < 0:
        raise PrtError(f"positional encoding octaves={octaves!r} must be an integer of at least 0")
    parts = [x]
    for octave in range(octaves):
        angle = (2**octave * math.pi) * x
        parts += [angle.sin(), angle.cos()]
    return torch.cat(parts, dim=-1)


def log_roughness(roughness: Tensor) -> Tensor:
    """log(25 sigma + 1) / log(26): more room for low roughness (Raghavan 2023, section 5)."""
    return torch.log1p(25 * roughness) / math.log(26)

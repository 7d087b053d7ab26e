"""Fixed encodings of network inputs."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError

MAX_DEGREE = 4


def sh_encode(directions: Float[Tensor, "*N 3"], degree: int = 4) -> Float[Tensor, "*N C"]:
    """Real orthonormal spherical harmonics of the bands 0 to ``degree``: ``(degree + 1)**2`` values.

    ``degree`` is the maximum band l, so the paper's "spherical harmonics of maximum degree 4" (Raghavan 2023,
    section 5) are 25 values. (tiny-cuda-nn counts bands instead: its degree 4 stops at l = 3, 16 values; that
    is ``degree=3`` here.) Order: band by band, m from -l to l, without Condon-Shortley phase.

    Args:
        directions: unit vectors.

    Raises:
        PrtError: if ``degree`` is not 0 to 4.
    """
    if not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise PrtError(f"spherical harmonics degree={degree!r} must be an integer from 0 to {MAX_DEGREE}")
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    bands = [[0.5 * math.sqrt(1 / math.pi) * torch.ones_like(x)]]
    if degree >= 1:
        a = math.sqrt(3 / (4 * math.pi))
        bands.append([a * y, a * z, a * x])
    if degree >= 2:
        a, b = 0.5 * math.sqrt(15 / math.pi), 0.25 * math.sqrt(5 / math.pi)
        bands.append([a * x * y, a * y * z, b * (3 * zz - 1), a * x * z, 0.5 * a * (xx - yy)])
    if degree >= 3:
        a, b = 0.25 * math.sqrt(35 / (2 * math.pi)), 0.5 * math.sqrt(105 / math.pi)
        c, d = 0.25 * math.sqrt(21 / (2 * math.pi)), 0.25 * math.sqrt(7 / math.pi)
        bands.append([
            a * y * (3 * xx - yy), b * x * y * z, c * y * (5 * zz - 1), d * z * (5 * zz - 3),
            c * x * (5 * zz - 1), 0.5 * b * z * (xx - yy), a * x * (xx - 3 * yy),
        ])  # fmt: skip
    if degree >= 4:
        a, b = 0.75 * math.sqrt(35 / math.pi), 0.75 * math.sqrt(35 / (2 * math.pi))
        c, d = 0.75 * math.sqrt(5 / math.pi), 0.75 * math.sqrt(5 / (2 * math.pi))
        e = 3 / 16 * math.sqrt(1 / math.pi)
        bands.append([
            a * x * y * (xx - yy), b * y * z * (3 * xx - yy), c * x * y * (7 * zz - 1),
            d * y * z * (7 * zz - 3), e * (35 * zz * zz - 30 * zz + 3), d * x * z * (7 * zz - 3),
            0.5 * c * (xx - yy) * (7 * zz - 1), b * x * z * (xx - 3 * yy),
            0.25 * a * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ])  # fmt: skip
    return torch.stack([value for band in bands for value in band], -1)


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

"""Real orthonormal spherical harmonics of any degree.

Index ``l * l + l + m`` for degree l and order m = -l .. l; the polar axis is +z, there is no Condon-Shortley
sign: the first four are 0.2821, and 0.4886 times y, z, x. Degree counts from 0 and is the largest band: the
"maximum degree 4" of Raghavan 2023, section 5, are 25 values (tiny-cuda-nn counts bands: its degree 4 is 3).
"""

import functools
import math

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import texel_directions, texel_solid_angles

#: sub-texels a side over which the basis is averaged in a projection
_PARTS = 4


def sh_basis(directions: Float[Tensor, "N 3"], degree: int) -> Float[Tensor, "N K"]:
    """Values of all ``K = (degree + 1)^2`` harmonics up to ``degree`` at unit directions.

    The recurrence runs on normalised Legendre functions over sin^m(theta): nothing overflows, the pole is no
    special case (Sloan 2013, "Efficient Spherical Harmonic Evaluation").

    Raises:
        PrtError: if the degree is no integer of at least 0.
    """
    if not isinstance(degree, int) or degree < 0:
        raise PrtError(f"spherical harmonics degree={degree} must be 0 or more")
    x, y, z = directions.unbind(-1)
    out = directions.new_empty((*directions.shape[:-1], (degree + 1) ** 2))
    # (x + i y)^m = sin^m(theta) (cos(m phi) + i sin(m phi))
    real, imaginary = torch.ones_like(x), torch.zeros_like(x)
    diagonal = math.sqrt(1 / (4 * math.pi))
    for m in range(degree + 1):
        if m > 0:
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
            diagonal *= math.sqrt((2 * m + 1) / (2 * m))
        before, current = torch.zeros_like(z), torch.full_like(z, diagonal)
        for l in range(m, degree + 1):
            if l > m:
                a = math.sqrt((4 * l * l - 1) / (l * l - m * m))
                b = math.sqrt(((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
                before, current = current, a * (z * current - b * before)
            middle = l * l + l
            if m == 0:
                out[..., middle] = current
            else:
                out[..., middle + m] = math.sqrt(2) * current * real
                out[..., middle - m] = math.sqrt(2) * current * imaginary
    return out


@functools.lru_cache(maxsize=8)
def texel_basis(R: int, degree: int) -> Float[Tensor, "T K"]:
    """Integral of every harmonic over every texel, in steradians; float64."""
    fine = R * _PARTS
    basis = sh_basis(texel_directions(fine, torch.float64).reshape(-1, 3), degree)
    basis = basis * texel_solid_angles(fine, torch.float64).reshape(-1, 1)
    return basis.reshape(6, R, _PARTS, R, _PARTS, -1).sum((2, 4)).reshape(6 * R * R, -1)


def project(cubemap: Float[Tensor, "*B 6 R R C"], degree: int) -> Float[Tensor, "*B K C"]:
    """Coefficients ``integral of L(d) Y_k(d)`` over the sphere."""
    flat = cubemap.flatten(-4, -2)
    basis = texel_basis(cubemap.shape[-2], degree).to(flat)
    return basis.T @ flat


def evaluate(coeffs: Float[Tensor, "*B K C"], directions: Float[Tensor, "N 3"]) -> Float[Tensor, "*B N C"]:
    """The function of the coefficients at unit directions.

    Raises:
        PrtError: if the number of coefficients is no square.
    """
    K = coeffs.shape[-2]
    degree = math.isqrt(K) - 1
    if (degree + 1) ** 2 != K:
        raise PrtError(f"{K} spherical harmonics coefficients: their number must be (degree + 1)^2")
    return sh_basis(directions, degree) @ coeffs

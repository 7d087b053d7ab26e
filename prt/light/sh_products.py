"""Products of functions in spherical harmonics: the triple product tensor, and convolution with a lobe.

Real harmonics in the order of :mod:`prt.light.sh`; ``K = order^2`` coefficients for ``order`` bands.
"""

import functools
import math

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh import sh_basis

#: entries of the tensor smaller than this are rounding errors of zeros
_ZERO = 1e-9


def bands_of(count: int) -> int:
    """Number of bands of ``count`` coefficients.

    Raises:
        PrtError: if the number is no square.
    """
    order = math.isqrt(count)
    if order**2 != count or count < 1:
        raise PrtError(f"{count} spherical harmonics coefficients: their number must be order^2")
    return order


@functools.lru_cache(maxsize=8)
def triple_products(order: int) -> tuple[Int[Tensor, "3 E"], Float[Tensor, "E"]]:
    """The nonzero ``tau_ijk``, integrals of ``y_i y_j y_k`` over the sphere (Dhawal 2022, equation 2).

    Built once for each order by a product quadrature that is exact for the polynomials in question:
    Gauss-Legendre in z, evenly spaced angles around it.

    Returns:
        Indices i, j, k, and values, float64. For order 4 there are 353 of 4096.
    """
    degree = 3 * (order - 1)
    z, weight = np.polynomial.legendre.leggauss(degree // 2 + 1)
    angle = 2 * np.pi * np.arange(degree + 1) / (degree + 1)
    ring = np.sqrt(1 - z**2)[:, None]
    x, y = ring * np.cos(angle), ring * np.sin(angle)
    directions = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], -1).reshape(-1, 3)
    basis = sh_basis(torch.from_numpy(directions), order - 1)
    area = torch.from_numpy(np.repeat(weight, degree + 1) * 2 * np.pi / (degree + 1))
    dense = torch.einsum("n,ni,nj,nk->ijk", area, basis, basis, basis)
    index = (dense.abs() > _ZERO).nonzero().T
    return index, dense[tuple(index)]


def product_matrix(coeffs: Float[Tensor, "K C"]) -> Float[Tensor, "K K C"]:
    """Multiplication by a function as a matrix: ``M[k, i, c] = sum_j tau_ijk coeffs[j, c]`` (equation 2).

    ``M[..., c] @ t`` are the coefficients of the product of both functions, cut to the same bands.
    """
    (i, j, k), tau = triple_products(bands_of(len(coeffs)))
    matrix = coeffs.new_zeros((len(coeffs), len(coeffs), coeffs.shape[1]))
    terms = tau.to(coeffs)[:, None] * coeffs[j.to(coeffs.device)]
    return matrix.index_put_((k.to(coeffs.device), i.to(coeffs.device)), terms, accumulate=True)


def band_of(order: int) -> Int[Tensor, "K"]:
    """The band l of each coefficient."""
    return torch.arange(order).repeat_interleave(2 * torch.arange(order) + 1)


def phong_bands(exponent: Float[Tensor, "N"], order: int) -> Float[Tensor, "N order"]:
    """Factors per band by which convolution with the Phong lobe multiplies coefficients.

    The lobe is ``(s + 2) / (2 pi) max(0, cos)^s`` around the reflected direction, the normalisation of
    Lafortune and Willems 1994, which with the foreshortening keeps energy for a view along the normal. Its
    factors are ``(s + 2)`` times the integral of ``x^s P_l(x)`` over [0, 1], from a recurrence in l.
    """
    integrals = [1 / (exponent + 1), 1 / (exponent + 2)]
    for l in range(2, order):
        integrals.append(integrals[l - 2] * (exponent - l + 2) / (exponent + l + 1))
    return torch.stack(integrals[:order], dim=1) * (exponent + 2)[:, None]


def window(order: int, strength: float) -> Float[Tensor, "K"]:
    """Factors that damp the upper bands against ringing, ``1 / (1 + strength l^2 (l + 1)^2)``.

    The filter of least squared Laplacian (Sloan 2008, "Stupid Spherical Harmonics (SH) Tricks", appendix A7);
    0 changes nothing.

    Raises:
        PrtError: for a negative strength.
    """
    if not strength >= 0:
        raise PrtError(
            f"window={strength} must be 0 (none) or more; 0.01 damps the fourth band by a factor 2.4"
        )
    l = band_of(order).double()
    return (1 / (1 + strength * l**2 * (l + 1) ** 2)).float()

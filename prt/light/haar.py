"""Haar wavelets on cubemap faces: non-standard, orthonormal (Ng et al. 2003; Raghavan 2023, equation 3).

A face's R x R coefficients keep the Mallat layout: at every level the top-left quarter holds the coarser
image, the other three quarters the details along columns (right), rows (bottom) and both (bottom right). A
coefficient has the flat index of the texel in its place. Orthonormal over texels:
``sum_j T_j L_j = sum_k T_k L_k``.
"""

import math
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import direction_to_texel

Selection = Literal["magnitude", "area", "transport"]
SELECTIONS = ("magnitude", "area", "transport")


def haar2d(values: Float[Tensor, "*B"]) -> Float[Tensor, "*B"]:
    """Coefficients of maps ``(..., 6, R, R, C)`` or flat ``(..., 6 R R, C)``, in the same shape; any device.

    Raises:
        PrtError: if R is no power of two.
    """
    out, R = _faces(values)
    out = out.clone()
    n = R
    while n > 1:
        h = n // 2
        block = out[..., :n, :n, :]
        a, b = block[..., 0::2, 0::2, :], block[..., 0::2, 1::2, :]
        c, d = block[..., 1::2, 0::2, :], block[..., 1::2, 1::2, :]
        top, bottom = (a + b) * 0.5, (c + d) * 0.5
        top_change, bottom_change = (a - b) * 0.5, (c - d) * 0.5
        block[..., :h, :h, :] = top + bottom
        block[..., :h, h:, :] = top_change + bottom_change
        block[..., h:, :h, :] = top - bottom
        block[..., h:, h:, :] = top_change - bottom_change
        n = h
    return out.reshape(values.shape)


def inverse_haar2d(coeffs: Float[Tensor, "*B"]) -> Float[Tensor, "*B"]:
    """The maps of coefficients; inverse (and transpose) of :func:`haar2d`, same shapes."""
    out, R = _faces(coeffs)
    out = out.clone()
    n = 2
    while n <= R:
        h = n // 2
        block = out[..., :n, :n, :]
        mean, columns = block[..., :h, :h, :], block[..., :h, h:, :]
        rows, both = block[..., h:, :h, :], block[..., h:, h:, :]
        top, bottom = (mean + rows) * 0.5, (mean - rows) * 0.5
        top_change, bottom_change = (columns + both) * 0.5, (columns - both) * 0.5
        block[..., 0::2, 0::2, :] = top + top_change
        block[..., 0::2, 1::2, :] = top - top_change
        block[..., 1::2, 0::2, :] = bottom + bottom_change
        block[..., 1::2, 1::2, :] = bottom - bottom_change
        n *= 2
    return out.reshape(coeffs.shape)


forward, inverse = haar2d, inverse_haar2d


def haar2d_readable(face: Float[Tensor, "R R"]) -> Float[Tensor, "R R"]:
    """One face, one channel, as in the textbook: per level one step along every row, then along every column.

    The readable version of :func:`haar2d`; a test holds the two equal.
    """
    out = face.clone()
    n = out.shape[0]
    while n > 1:
        for i in range(n):
            out[i, :n] = _step(out[i, :n])
        for j in range(n):
            out[:n, j] = _step(out[:n, j])
        n //= 2
    return out


def _step(line: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
    """Sums of pairs, then differences of pairs, both over the square root of two."""
    first, second = line[0::2], line[1::2]
    return torch.cat([first + second, first - second]) / math.sqrt(2)


def support_size(index: Int[Tensor, "*K"], R: int) -> Int[Tensor, "*K"]:
    """Side, in texels, of the square where wavelet ``index`` is not zero."""
    n = _level(index, R)[0]
    return R // n


def wavelet_at(index: int | Int[Tensor, "K"], d: Float[Tensor, "N 3"], R: int) -> Float[Tensor, "..."]:
    """Values of single wavelets at directions.

    Orthonormal over texels: the squares of a wavelet's values at all 6 R R texels sum to one.

    Args:
        index: one flat index, or K of them.
        d: directions of any length.

    Returns:
        ``(N,)`` for one index, ``(N, K)`` for several.
    """
    _check_power(R)
    several = torch.as_tensor(index, device=d.device).reshape(-1)
    if several.numel() and (several.min() < 0 or several.max() >= 6 * R * R):
        raise PrtError(f"wavelet index out of range: allowed are 0 to {6 * R * R - 1} at resolution {R}")
    texel = direction_to_texel(d, R)
    face, row, column = (texel // (R * R))[:, None], (texel // R % R)[:, None], (texel % R)[:, None]
    n, place_row, place_column = _level(several, R)
    size = R // n
    inside = (face == several // (R * R)) & (row // size == place_row % n)
    inside &= column // size == place_column % n
    # a detail is positive in the first half of its support and negative in the second
    sign_row = torch.where((place_row >= n) & (row % size * 2 >= size), -1.0, 1.0)
    sign_column = torch.where((place_column >= n) & (column % size * 2 >= size), -1.0, 1.0)
    value = torch.where(inside, sign_row * sign_column / size, 0.0).to(d.dtype)
    return value[:, 0] if isinstance(index, int) else value


def top_k(
    coeffs: Float[Tensor, "*B T 3"],
    k: int,
    how: Selection = "magnitude",
    scale: Float[Tensor, "..."] | None = None,
) -> Int[Tensor, "*B k"]:
    """Indices of the k most important coefficients of lightings, the most important first.

    The rank of coefficient L_k is its Euclidean norm over RGB, times a weight:

    - ``magnitude``: 1, which minimises the squared error of the lighting ("unweighted", Ng et al. 2003).
    - ``area``: the area of the wavelet's support in texels ("area-weighted", Ng et al. 2003). The
      orthonormal wavelet of a square of side s responds to a linear ramp in proportion to s^2, so this is
      transport-weighting for smooth transport; it settles large-scale colours first (Raghavan 2023,
      section 6).
    - ``transport``: ``scale``, ``(T,)`` or ``(T, 3)`` (then applied per channel before the norm), such as the
      root mean square of recorded transport per wavelet.

    Ties go to the lower index, on every device.

    Raises:
        PrtError: if k is not in 1 .. T, ``how`` is unknown, or ``scale`` is missing or of another shape.
    """
    T = coeffs.shape[-2]
    if not 1 <= k <= T:
        raise PrtError(f"number of wavelets K={k} must be from 1 to {T}, the number of coefficients")
    return importance(coeffs, how, scale).sort(dim=-1, descending=True, stable=True).indices[..., :k]


def importance(
    coeffs: Float[Tensor, "*B T 3"], how: Selection = "magnitude", scale: Float[Tensor, "..."] | None = None
) -> Float[Tensor, "*B T"]:
    """What :func:`top_k` ranks coefficients by.

    Raises:
        PrtError: if ``how`` is unknown, or ``scale`` is missing or of another shape.
    """
    T = coeffs.shape[-2]
    if how not in SELECTIONS:
        raise PrtError(f"wavelet selection {how!r} is not one of {', '.join(SELECTIONS)}")
    if how == "transport":
        if scale is None or tuple(scale.shape) not in ((T,), (T, coeffs.shape[-1])):
            got = "none" if scale is None else tuple(scale.shape)
            raise PrtError(
                f"wavelet selection 'transport' needs a scale of shape ({T},) or ({T}, 3), got {got}"
            )
        weight = scale if scale.ndim == 2 else scale[:, None]
        return (coeffs * weight.to(coeffs)).norm(dim=-1)
    rank = coeffs.norm(dim=-1)
    if how == "area":
        R = resolution_of(T)
        rank = rank * support_size(torch.arange(T, device=coeffs.device), R).to(coeffs) ** 2
    return rank


def keep_only(coeffs: Float[Tensor, "*B T C"], index: Int[Tensor, "*B k"]) -> Float[Tensor, "*B T C"]:
    """The coefficients with all but those of ``index`` set to zero (the truncated lighting)."""
    where = index[..., None].expand(*index.shape, coeffs.shape[-1])
    return torch.zeros_like(coeffs).scatter(-2, where, coeffs.gather(-2, where))


def resolution_of(T: int) -> int:
    """R of a flat lighting of ``T = 6 R R`` texels.

    Raises:
        PrtError: if T is not 6 times the square of a power of two.
    """
    R = math.isqrt(T // 6)
    if 6 * R * R != T:
        raise PrtError(f"a flat cubemap has 6 R R texels with R a power of two, got {T}")
    _check_power(R)
    return R


def _level(index: Int[Tensor, "*K"], R: int) -> tuple[Tensor, Tensor, Tensor]:
    """(n, row, column): the wavelet's sub-band has n x n places; row and column in the Mallat layout."""
    row, column = index // R % R, index % R
    n = torch.ones_like(index)
    for power in range(1, R.bit_length() - 1):
        n = torch.where(torch.maximum(row, column) >= 2**power, 2**power, n)
    return n, row, column


def _faces(values: Tensor) -> tuple[Tensor, int]:
    """A view ``(..., 6, R, R, C)`` of maps given so or flat."""
    shape = values.shape
    if len(shape) >= 4 and shape[-4] == 6 and shape[-3] == shape[-2]:
        _check_power(shape[-2])
        return values, shape[-2]
    R = resolution_of(shape[-2])
    return values.reshape(*shape[:-2], 6, R, R, shape[-1]), R


def _check_power(R: int) -> None:
    if R < 1 or R & (R - 1):
        raise PrtError(f"cubemap resolution {R} must be a power of two (Haar halves it at every level)")

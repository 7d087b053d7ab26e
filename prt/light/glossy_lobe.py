"""The GGX lobe in spherical harmonics: how it blurs incident light, and what share of it it reflects.

Classical transfer (Sloan, Kautz and Snyder 2002, section 4) takes a glossy BRDF for a lobe of one shape about
the reflected direction. Here that shape is the lobe of GGX seen along the normal, and its strength at other
angles is that of GGX with Schlick's Fresnel factor.
"""

import functools

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

#: roughnesses, and cosines, that are tabulated, and points of the quadrature over a lobe
NODES, POINTS = 33, 4096


def lobe_bands(roughness: Float[Tensor, "N 1"], order: int) -> Float[Tensor, "N order"]:
    """Factors per band by which convolution with the lobe multiplies coefficients; 1 in band 0.

    Args:
        roughness: sigma, the square root of GGX alpha; 0 is a mirror, of factors 1.
        order: bands.
    """
    table = _table(order).to(roughness)
    place = roughness[:, 0].clamp(0, 1) * (NODES - 1)
    node = place.long().clamp_max(NODES - 2)
    return torch.lerp(table[node], table[node + 1], (place - node)[:, None])


@functools.lru_cache(maxsize=8)
def _table(order: int) -> Float[Tensor, "nodes order"]:
    """:func:`lobe_bands` at evenly spaced roughnesses.

    Half vectors are drawn as GGX is distributed, times the cosine (Walter 2007, equation 35): along the
    normal that makes the BRDF times the cosine of the light just Smith's shadowing of the light's direction.
    """
    alpha = np.linspace(0, 1, NODES)[:, None] ** 2
    u = (np.arange(POINTS) + 0.5)[None] / POINTS
    half = (1 - u) / (1 + (alpha**2 - 1) * u)  # squared cosine
    cosine = 2 * half - 1
    weight = _smith(cosine, alpha)
    legendre = [np.ones_like(cosine), cosine]
    for l in range(2, order):
        legendre.append(((2 * l - 1) * cosine * legendre[l - 1] - (l - 1) * legendre[l - 2]) / l)
    sums = np.stack([(weight * values).sum(1) for values in legendre[:order]], 1)
    return torch.from_numpy(sums / sums[:, :1]).float()


def lobe_above(roughness: Float[Tensor, "N 1"], cosine: Float[Tensor, "N"], order: int) -> Float[Tensor, "N"]:
    """Share of the lobe that is above the surface, in the same bands: what it makes of a bright hemisphere.

    Light below the surface is zero, so a blurred value must be divided by this: :func:`lobe_reflectance`
    already knows that a lobe loses there.

    Args:
        cosine: of the angle between normal and reflected direction.
    """
    x, weight = np.polynomial.legendre.leggauss(order + 2)
    x, weight = (x + 1) / 2, weight / 2
    total, before, last = torch.zeros_like(cosine), torch.ones_like(cosine), cosine
    bands = lobe_bands(roughness, order)
    for l in range(order):
        integral = float((weight * np.polynomial.legendre.Legendre.basis(l)(x)).sum())
        total = total + (2 * l + 1) / 2 * integral * bands[:, l] * before
        before, last = last, ((2 * l + 3) * cosine * last - (l + 1) * before) / (l + 2)
    return total


def lobe_reflectance(
    specular: Float[Tensor, "N 3"], roughness: Float[Tensor, "N 1"], cosine: Float[Tensor, "N"]
) -> Float[Tensor, "N 3"]:
    """Share of constant light that the lobe reflects: GGX, Smith's shadowing, Schlick's Fresnel factor.

    ``specular * a + b``, both from a table (Karis 2013, "Real Shading in Unreal Engine 4"): more than
    ``specular`` at grazing angles. Black stays black, for it means that there is no such lobe.

    Args:
        specular: reflectance along the normal.
        roughness: sigma; ``cosine``: of the angle between normal and viewer.
    """
    table = _reflectances().to(roughness)
    places = torch.stack([roughness[:, 0], cosine], 1).clamp(0, 1) * (NODES - 1)
    node = places.long().clamp_max(NODES - 2)
    (i, j), (x, y) = node.unbind(1), (places - node).unbind(1)
    rows = [torch.lerp(table[i + k, j], table[i + k, j + 1], y[:, None]) for k in (0, 1)]
    scale, bias = torch.lerp(rows[0], rows[1], x[:, None]).unbind(1)
    return torch.where(specular > 0, specular * scale[:, None] + bias[:, None], 0)


@functools.lru_cache(maxsize=1)
def _reflectances() -> Float[Tensor, "nodes nodes 2"]:
    """Scale and bias by roughness and cosine, half vectors drawn as in :func:`_table`."""
    side = int(POINTS**0.5)
    u, angle = (np.arange(side) + 0.5) / side, np.pi * (np.arange(side) + 0.5) / side  # both halves are alike
    n_v = np.linspace(1e-3, 1, NODES)[:, None, None]
    out = np.empty((NODES, NODES, 2))
    for row, sigma in enumerate(np.linspace(0, 1, NODES)):
        alpha = sigma**2
        n_h = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))[:, None]
        v_h = n_v * n_h + np.sqrt((1 - n_v**2) * (1 - n_h**2)) * np.cos(angle)
        n_l = 2 * v_h * n_h - n_v
        shadowing = _smith(n_v, alpha) * _smith(n_l, alpha)
        share = np.where((n_l > 0) & (v_h > 0), shadowing * v_h / (n_h * n_v), 0)
        schlick = (1 - v_h.clip(0, 1)) ** 5
        out[row] = np.stack([(share * (1 - schlick)).mean((1, 2)), (share * schlick).mean((1, 2))], 1)
    return torch.from_numpy(out).float()


def _smith(cosine: np.ndarray, alpha: float | np.ndarray) -> np.ndarray:
    """Share of microfacets that are seen from a direction (Walter 2007, equation 34); 0 from below."""
    tangent = 1 / cosine.clip(1e-9) ** 2 - 1
    return np.where(cosine > 0, 2 / (1 + np.sqrt(1 + alpha**2 * tangent)), 0)


def cosine_bands(order: int) -> Float[Tensor, "order"]:
    """Factors of the cosine over pi: from incident light to what a white diffuse surface sends on.

    Ramamoorthi and Hanrahan 2001: 1, 2/3, 1/4, 0, -1/24, ...
    """
    x, weight = np.polynomial.legendre.leggauss(order + 2)
    x, weight = (x + 1) / 2, weight / 2
    values = [np.polynomial.legendre.Legendre.basis(l)(x) for l in range(order)]
    return torch.tensor([float(2 * (weight * x * value).sum()) for value in values])

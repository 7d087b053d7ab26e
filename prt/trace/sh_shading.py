"""Shading by transfer vectors in spherical harmonics (Dhawal 2022, equations 2 and 3), for every storage.

A transfer vector holds ``T_i``, integrals of ``V(d) max(0, n.d) y_i(d) / pi`` over the sphere: under radiance
1 from everywhere, an open place reflects its albedo. (The paper leaves out the 1 / pi.)
"""

import dataclasses
import math

from jaxtyping import Float
from torch import Tensor
from typing_extensions import Self

from prt.light.sh import project, sh_basis
from prt.light.sh_products import band_of, bands_of, phong_bands, product_matrix, window
from prt.scene.gbuffer import GBuffer

#: exponents beyond it are a mirror to any lighting of few bands
SHARPEST = 1e5


@dataclasses.dataclass
class ShCode:
    """A lighting, encoded once.

    Attributes:
        coefficients: of the lighting, linear RGB.
        matrix: multiplication by it, ``matrix[k, i]`` (the light matrix of Ng 2004).
    """

    coefficients: Float[Tensor, "K 3"]
    matrix: Float[Tensor, "K K 3"]

    @classmethod
    def of(cls, coefficients: Float[Tensor, "K 3"]) -> Self:
        """With the matrix that follows from the coefficients."""
        return cls(coefficients, product_matrix(coefficients))


def encode(lighting: Float[Tensor, "6 R R 3"], order: int, windowing: float = 0.0) -> ShCode:
    """Project an environment to ``order`` bands; ``windowing`` as in :func:`prt.light.sh_products.window`."""
    coefficients = project(lighting.float(), order - 1)
    return ShCode.of(window(order, windowing).to(coefficients)[:, None] * coefficients)


def exponent_of(roughness: Float[Tensor, "N 1"]) -> Float[Tensor, "N"]:
    """Phong exponent ``2 / alpha^2 - 2`` of a roughness, the square root of alpha (Walter 2007)."""
    return (2 / roughness[:, 0].clamp_min(1e-4) ** 4 - 2).clamp(0, SHARPEST)


def roughness_of(exponent: float) -> float:
    """The inverse of :func:`exponent_of`."""
    return (2 / (exponent + 2)) ** 0.25


def shade(transfer: Float[Tensor, "N K"], gbuffer: GBuffer, code: ShCode) -> Float[Tensor, "N 3"]:
    """Linear radiance: the diffuse part by equation 3, the glossy one by equation 2; it may ring below zero.

    Glossy: the product of lighting and transfer, convolved with the Phong lobe of the point's roughness and
    read at the reflected direction.
    """
    out = gbuffer.diffuse * (transfer @ code.coefficients)
    if bool((gbuffer.specular > 0).any()):
        out = out + gbuffer.specular * glossy(transfer, gbuffer.wr, exponent_of(gbuffer.roughness), code)
    return out


def glossy(
    transfer: Float[Tensor, "N K"],
    reflected: Float[Tensor, "N 3"],
    exponent: Float[Tensor, "N"],
    code: ShCode,
) -> Float[Tensor, "N 3"]:
    """Radiance of a Phong lobe of reflectance 1 (equation 2)."""
    order = bands_of(transfer.shape[1])
    lobe = phong_bands(exponent, order)[:, band_of(order).to(exponent.device)]
    weight = math.pi * lobe * sh_basis(reflected, order - 1)
    K = len(code.matrix)
    product = (transfer @ code.matrix.permute(1, 0, 2).reshape(K, 3 * K)).view(-1, K, 3)
    return (weight[:, :, None] * product).sum(1)

"""The network of Raghavan 2023: wavelet coefficients of light transport from a CP-factored feature field.

    h_k(x) = sum_m S_m[x] W_m[k] U_m                                   (Eq. 7)
    T_k(x, wo) = scale_k * f(h_k(x), wr, n, rho; Theta)                (Eq. 4)

``scale_k`` is 1 in the paper; here it can be the root mean square of the recorded transport per wavelet, so
that the network's target has unit variance for every wavelet.

Two forms of the same arithmetic. :meth:`WaveletTransport.coefficients_readable` follows the equations.
:meth:`WaveletTransport.hidden` folds the first layer: with V = U A_h (A_h the columns of the first layer
that read h), the pre-activation of pixel p and wavelet k is S_p diag(W_k) V + g_p, where diag(W_k) V is
computed once per light and g_p, the part of the inputs that knows no wavelet, once per pixel.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prt.nn.direction_encodings import CubemapEncoding, DirectionEncoding
from prt.nn.hashgrid import Corners, HashGrid
from prt.nn.mlp import Mlp
from prt.nn.vertex_features import VertexFeatures
from prt.nn.wavelet_texture import WaveletTexture


class PixelInputs(NamedTuple):
    """What the network knows of a pixel before it knows a wavelet.

    Attributes:
        space: S_m[x], times the learnt factor of the direction where there is one.
        features: the other inputs of f: of direction, normal and roughness, k_d and k_s (section 5).
    """

    space: Float[Tensor, "N M"]
    features: Float[Tensor, "N F"]


class WaveletTransport(nn.Module):
    """T_k(x, wo) for every wavelet k of a cubemap.

    Args:
        grid: the spatial factors S_m, in space or on vertices; its output size is M.
        texture: the wavelet factors W_m, 6 R R wavelets.
        directions: encoding of reflected direction, normal and roughness.
        width: neurons of each of the two hidden layers.
        scale: per-wavelet output scale, (wavelets,) or None for 1.
    """

    scale: Tensor

    def __init__(
        self,
        grid: HashGrid | VertexFeatures,
        texture: WaveletTexture,
        directions: DirectionEncoding | CubemapEncoding,
        width: int,
        scale: Tensor | None = None,
    ):
        super().__init__()
        self.grid, self.directions, self.width = grid, directions, width
        terms = grid.out_features
        self.texture = texture
        self.feature = nn.Parameter(torch.eye(terms) + torch.randn(terms, terms) / terms**0.5 * 0.1)
        self.mlp = Mlp(terms + directions.outputs + 6, width, 2, 3)
        with torch.no_grad():
            # no transport at first: random coefficients of 64 wavelets would add up to noise
            self.mlp.layers[2].weight.mul_(0.1)
        self.register_buffer("scale", torch.ones(texture.wavelets) if scale is None else scale)

    @property
    def terms(self) -> int:
        return self.grid.out_features

    def inputs(self, gbuffer, places: Corners | None = None) -> PixelInputs:
        """The inputs of the pixels of a G-buffer; ``places``: what ``grid.locate`` says of them, if known."""
        return self.joined(self.grid.lookup(self.grid.locate(gbuffer) if places is None else places), gbuffer)

    def joined(self, space: Float[Tensor, "N M"], gbuffer) -> PixelInputs:
        """The inputs of pixels whose features in space are known."""
        factor = self.directions.factor(gbuffer.wr)
        encoded = self.directions(gbuffer.wr, gbuffer.normal, gbuffer.roughness)
        features = torch.cat([encoded, gbuffer.diffuse, gbuffer.specular], dim=1)
        return PixelInputs(space if factor is None else space * factor, features)

    def coefficients_readable(self, pixel: PixelInputs, k: Int[Tensor, "K"]) -> Float[Tensor, "N K 3"]:
        """Eqs. 4 and 7 as printed."""
        field = torch.einsum("nm,km,ml->nkl", pixel.space, self.texture(k), self.feature)
        inputs = torch.cat([field, pixel.features[:, None, :].expand(-1, len(k), -1)], dim=2)
        return self.mlp(inputs) * self.scale[k][None, :, None]

    def fold(self, k: Int[Tensor, "K"]) -> Float[Tensor, "M KH"]:
        """diag(W_k) V for the wavelets k, side by side: once per light."""
        first = self.mlp.layers[0].weight[:, : self.terms]
        folded = self.feature @ first.T
        return torch.einsum("km,mh->mkh", self.texture(k), folded).reshape(self.terms, -1)

    def per_pixel(self, features: Float[Tensor, "N F"]) -> Float[Tensor, "N H"]:
        """g_p: the part of the first layer that knows no wavelet."""
        layer = self.mlp.layers[0]
        return features @ layer.weight[:, self.terms :].T + layer.bias

    def hidden(self, pixel: PixelInputs, folded: Float[Tensor, "M KH"]) -> Float[Tensor, "NK H"]:
        """Activations of the last hidden layer for every pixel and wavelet, from the folded first layer.

        The large arrays have the precision of ``folded``.
        """
        kind, pixels = folded.dtype, pixel.space.shape[0]
        first = (pixel.space.to(kind) @ folded).view(pixels, -1, self.width)
        first = torch.relu_(first + self.per_pixel(pixel.features).to(kind)[:, None, :])
        second = self.mlp.layers[1]
        return torch.relu_(
            torch.addmm(second.bias.to(kind), first.view(-1, self.width), second.weight.T.to(kind))
        )

    def coefficients(
        self, pixel: PixelInputs, k: Int[Tensor, "K"], precision: torch.dtype = torch.float32
    ) -> Float[Tensor, "N K 3"]:
        """The same as :meth:`coefficients_readable` through the folded form; used in training.

        Args:
            precision: of the matrix products and hidden activations; the result is float32.
        """
        hidden = self.hidden(pixel, self.fold(k).to(precision))
        last = self.mlp.layers[2]
        out = torch.addmm(last.bias.to(precision), hidden, last.weight.T.to(precision))
        return out.view(pixel.space.shape[0], len(k), 3).float() * self.scale[k][None, :, None]

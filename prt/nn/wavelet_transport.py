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

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prt.light.sh import sh_basis
from prt.nn.encodings import log_roughness
from prt.nn.hashgrid import HashGrid
from prt.nn.mlp import Mlp
from prt.nn.wavelet_texture import WaveletTexture


def surface_features(
    wr: Tensor, normal: Tensor, diffuse: Tensor, specular: Tensor, roughness: Tensor, degree: int
) -> Float[Tensor, "N F"]:
    """The inputs of f besides h_k: SH of wr, normal, k_d, k_s, log-mapped roughness (section 5)."""
    return torch.cat([sh_basis(wr, degree), normal, diffuse, specular, log_roughness(roughness)], dim=1)


class WaveletTransport(nn.Module):
    """T_k(x, wo) for every wavelet k of a cubemap.

    Args:
        grid: the spatial factors S_m; its output size is M.
        texture: the wavelet factors W_m, 6 R R wavelets.
        width: neurons of each of the two hidden layers.
        degree: largest SH band of the reflected direction.
        scale: per-wavelet output scale, (wavelets,) or None for 1.
    """

    scale: Tensor

    def __init__(
        self, grid: HashGrid, texture: WaveletTexture, width: int, degree: int, scale: Tensor | None = None
    ):
        super().__init__()
        self.grid, self.degree, self.width = grid, degree, width
        terms = grid.out_features
        self.texture = texture
        self.feature = nn.Parameter(torch.eye(terms) + torch.randn(terms, terms) / terms**0.5 * 0.1)
        inputs = terms + (degree + 1) ** 2 + 10
        self.mlp = Mlp(inputs, width, 2, 3)
        with (
            torch.no_grad()
        ):  # no transport at first: random coefficients of 64 wavelets would add up to noise
            self.mlp.layers[2].weight.mul_(0.1)
        self.register_buffer("scale", torch.ones(texture.wavelets) if scale is None else scale)

    @property
    def terms(self) -> int:
        return self.grid.out_features

    def features(self, gbuffer) -> Float[Tensor, "N F"]:
        """:func:`surface_features` of a G-buffer."""
        return surface_features(
            gbuffer.wr, gbuffer.normal, gbuffer.diffuse, gbuffer.specular, gbuffer.roughness, self.degree
        )

    def coefficients_readable(
        self, position: Float[Tensor, "N 3"], features: Float[Tensor, "N F"], k: Int[Tensor, "K"]
    ) -> Float[Tensor, "N K 3"]:
        """Eqs. 4 and 7 as printed."""
        space = self.grid(position)
        field = torch.einsum("nm,km,ml->nkl", space, self.texture(k), self.feature)
        inputs = torch.cat([field, features[:, None, :].expand(-1, len(k), -1)], dim=2)
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

    def hidden(
        self, space: Float[Tensor, "N M"], features: Float[Tensor, "N F"], folded: Float[Tensor, "M KH"]
    ) -> Float[Tensor, "NK H"]:
        """Activations of the last hidden layer for every pixel and wavelet, from the folded first layer.

        The large arrays have the precision of ``folded``.
        """
        kind, pixels = folded.dtype, space.shape[0]
        first = (space.to(kind) @ folded).view(pixels, -1, self.width)
        first = torch.relu_(first + self.per_pixel(features).to(kind)[:, None, :])
        second = self.mlp.layers[1]
        return torch.relu_(
            torch.addmm(second.bias.to(kind), first.view(-1, self.width), second.weight.T.to(kind))
        )

    def coefficients(
        self,
        space: Float[Tensor, "N M"],
        features: Float[Tensor, "N F"],
        k: Int[Tensor, "K"],
        precision: torch.dtype = torch.float32,
    ) -> Float[Tensor, "N K 3"]:
        """The same as :meth:`coefficients_readable` through the folded form; used in training.

        Args:
            precision: of the matrix products and hidden activations; the result is float32.
        """
        hidden = self.hidden(space, features, self.fold(k).to(precision))
        last = self.mlp.layers[2]
        out = torch.addmm(last.bias.to(precision), hidden, last.weight.T.to(precision))
        return out.view(space.shape[0], len(k), 3).float() * self.scale[k][None, :, None]

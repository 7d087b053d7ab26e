"""The network of ``basis_neural``: coefficients of a pixel's transport in a light basis, in one evaluation.

What a diffuse surface sends on does not depend on where it is seen from, and what a glossy one mirrors is
about what its mirror ray meets. Both are built in: a diffuse part that never sees a direction, times the
diffuse colour, and a specular part that sees the place that the mirror ray meets, times the specular one.
Without that structure a network of this kind fits the views it has seen and fails others.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from prt.light.sh import sh_basis
from prt.nn.encodings import log_roughness
from prt.nn.hashgrid import HashGrid
from prt.nn.mlp import Mlp


class BasisNetwork(nn.Module):
    """a_m(x, wo) for every term m of a light basis.

    Args:
        grid: features of the place.
        mirrored: features of the place that the mirror ray meets, or None: the network sees wr alone.
        width, hidden_layers: of both parts.
        degree: largest SH band of the reflected direction.
        scale: root mean square of each term's coefficients, what the outputs are multiplied by.
    """

    scale: Tensor

    def __init__(
        self, grid: HashGrid, mirrored: HashGrid | None, width: int, hidden_layers: int, degree: int,
        scale: Float[Tensor, "M"],
    ):  # fmt: skip
        super().__init__()
        self.grid, self.mirrored, self.degree, self.terms = grid, mirrored, degree, len(scale)
        place = grid.out_features
        self.diffuse = Mlp(place + 3, width, hidden_layers, 3 * self.terms)
        seen = (degree + 1) ** 2 + 3 + 2 + (mirrored.out_features + 1 if mirrored is not None else 0)
        self.specular = Mlp(place + seen, width, hidden_layers, 3 * self.terms)
        with torch.no_grad():
            for part in (self.diffuse, self.specular):
                part.layers[-1].weight.mul_(0.1)
        self.register_buffer("scale", scale.clone())

    def inputs(
        self, gbuffer, mirror: Float[Tensor, "N 3"] | None = None, met: Float[Tensor, "N 1"] | None = None
    ) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N S"]]:
        """What the diffuse and the specular part see of N points.

        Args:
            mirror: where their mirror rays arrive; ``met``: 1 where that is a surface, 0 where they leave.
        """
        place = self.grid(gbuffer.position)
        cosine = (gbuffer.normal * gbuffer.wr).sum(dim=1, keepdim=True)
        rough = log_roughness(gbuffer.roughness)
        seen = [place, sh_basis(gbuffer.wr, self.degree), gbuffer.normal, cosine, rough]
        if self.mirrored is not None:
            seen += [self.mirrored(mirror) * met, met]
        return torch.cat([place, gbuffer.normal], dim=1), torch.cat(seen, dim=1)

    def coefficients(
        self, gbuffer, mirror: Float[Tensor, "N 3"] | None = None, met: Float[Tensor, "N 1"] | None = None
    ) -> Float[Tensor, "N M 3"]:
        """a of N points."""
        diffuse, specular = self.inputs(gbuffer, mirror, met)
        d, s = self.diffuse(diffuse), self.specular(specular)
        both = gbuffer.diffuse[:, None] * d.view(-1, self.terms, 3)
        both = both + gbuffer.specular[:, None] * s.view(-1, self.terms, 3)
        return both * self.scale[:, None]

    def fold(self, code: Float[Tensor, "M 3"]) -> list[tuple[Float[Tensor, "3 H"], Float[Tensor, "3"]]]:
        """The last layers of both parts, summed over the terms with a lighting's weights: once per light.

        A pixel then costs no more with many terms than with few.
        """
        weight = code * self.scale[:, None]
        found = []
        for part in (self.diffuse, self.specular):
            last = part.layers[-1]
            rows = last.weight.view(self.terms, 3, -1)
            bias = last.bias.view(self.terms, 3)
            found.append((torch.einsum("mch,mc->ch", rows, weight), (bias * weight).sum(dim=0)))
        return found

    def radiance(
        self,
        gbuffer,
        folded: list[tuple[Float[Tensor, "3 H"], Float[Tensor, "3"]]],
        mirror: Float[Tensor, "N 3"] | None = None,
        met: Float[Tensor, "N 1"] | None = None,
    ) -> Float[Tensor, "N 3"]:
        """Radiance of N points under the lighting that was folded: ``coefficients`` times its code."""
        out = []
        for part, x, (weight, bias) in zip(
            (self.diffuse, self.specular), self.inputs(gbuffer, mirror, met), folded, strict=True
        ):
            for layer in part.layers[:-1]:
                x = torch.relu(layer(x))
            out.append(torch.nn.functional.linear(x, weight, bias))
        return gbuffer.diffuse * out[0] + gbuffer.specular * out[1]

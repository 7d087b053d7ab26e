"""A lightmap as a weighted sum of basis elements, sampled at places in it (Belcour 2022, section 5.2).

The readable version of the fragment shader in :mod:`prt.methods.blend_shader`; CPU and GPU.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.texture_lookup import corners

#: blend whole lightmaps up to this many texels per point, and only the points' texels beyond it; one CPU core
#: takes as long for either at 8 texels per point with 64 elements, 16 with 16, 30 with 4
TEXELS_PER_POINT = 8


def sample(lightmaps: Float[Tensor, "n H W"], uv: Float[Tensor, "N 2"]) -> Float[Tensor, "n N"]:
    """Bilinear look-up, clamped to the edge.

    Args:
        lightmaps: texel (row i, column j) has its centre at uv = ((j + 0.5) / W, (i + 0.5) / H) and there
            exactly its value.
        uv: places, [0, 1]; beyond it the edge goes on.
    """
    grid = (2 * uv - 1)[None, None]
    return F.grid_sample(lightmaps[None], grid, "bilinear", "border", align_corners=False)[0, :, 0]


def blend(
    basis: Float[Tensor, "n H W"] | Float[Tensor, "n H W C"],
    coefficients: Float[Tensor, "n 3"],
    uv: Float[Tensor, "N 2"],
    gamma: float = 1.0,
) -> Float[Tensor, "N 3"]:
    """:meth:`Blender.blend` for a basis that is used once."""
    return Blender(basis).blend(coefficients, uv, gamma)


class Blender:
    """A basis prepared to be blended often.

    Sampling and blending are linear, so either may come first. Blending whole lightmaps reads every texel of
    every element once and leaves three channels to sample; sampling first reads four texels of every element
    per point, from a second copy of the basis made at the first need. The counts decide, the result is the
    same to rounding.

    Args:
        basis: n elements, element 0 the mean. One channel (n, H, W) or (n, H, W, 1) serves all three
            colours (section 5.2); with three channels the colours are part of the basis.

    Raises:
        PrtError: for another shape.
    """

    def __init__(self, basis: Float[Tensor, "n H W"] | Float[Tensor, "n H W C"]):
        basis = with_channels(basis)
        self.size = (basis.shape[1], basis.shape[2])
        # one plane per channel; for a single channel this is the caller's memory, not a copy
        self.planes: Float[Tensor, "C n HW"] = basis.permute(3, 0, 1, 2).flatten(2).contiguous()
        self._texels: Float[Tensor, "C HW n"] | None = None

    def blend(
        self, coefficients: Float[Tensor, "n 3"], uv: Float[Tensor, "N 2"], gamma: float = 1.0
    ) -> Float[Tensor, "N 3"]:
        """sum_k c_k B_k(uv), channel c with column c of the coefficients.

        Args:
            uv: as in :func:`sample`.
            gamma: the inverse gamma correction (section 5.3): a value other than 1 clamps the sum at 0 and
                raises it to this power. With 1 negative sums stay: they are ringing, and are measured.

        Raises:
            PrtError: for coefficients of another number than the basis, or gamma not above 0.
        """
        check(coefficients, self.planes.shape[1], gamma)
        height, width = self.size
        few_texels = height * width <= TEXELS_PER_POINT * len(uv)
        total = self.blend_first(coefficients, uv) if few_texels else self.sample_first(coefficients, uv)
        return total if gamma == 1 else total.clamp_min(0) ** gamma

    def blend_first(
        self, coefficients: Float[Tensor, "n 3"], uv: Float[Tensor, "N 2"]
    ) -> Float[Tensor, "N 3"]:
        """The sum at the places, by way of the whole lightmap; without the gamma correction."""
        lightmap = self._weights(coefficients) @ self.planes
        return sample(lightmap.view(3, *self.size), uv).T

    def sample_first(
        self, coefficients: Float[Tensor, "n 3"], uv: Float[Tensor, "N 2"]
    ) -> Float[Tensor, "N 3"]:
        """The sum at the places, by way of every element there; without the gamma correction."""
        if self._texels is None:  # the elements of a texel side by side: a point reads four runs of memory
            self._texels = self.planes.transpose(1, 2).contiguous()
        index, share = corners(uv, *self.size)
        # the one torch operation that weighs and sums gathered rows without writing the rows down
        elements = [F.embedding_bag(index, t, per_sample_weights=share, mode="sum") for t in self._texels]
        weights = self._weights(coefficients)
        return torch.cat([e @ w.T for e, w in zip(elements, weights, strict=True)], dim=1)

    def _weights(self, coefficients: Float[Tensor, "n 3"]) -> Float[Tensor, "C 3/C n"]:
        """For each channel of the basis, the coefficients of the colours it serves."""
        return coefficients.T.reshape(len(self.planes), -1, len(coefficients))


def with_channels(basis: Float[Tensor, "n H W"] | Float[Tensor, "n H W C"]) -> Float[Tensor, "n H W C"]:
    """The basis with its channels as the last dimension, one of them where it has none.

    Raises:
        PrtError: unless it is (n, H, W), (n, H, W, 1) or (n, H, W, 3), with nothing empty.
    """
    full = basis[..., None] if basis.ndim == 3 else basis
    if full.ndim != 4 or full.shape[3] not in (1, 3) or full.numel() == 0:
        raise PrtError(
            f"a lightmap basis of shape {tuple(basis.shape)} is not (n, H, W), (n, H, W, 1) or (n, H, W, 3)"
        )
    return full


def check(coefficients: Float[Tensor, "n 3"], elements: int, gamma: float) -> None:
    """Refuse coefficients that do not fit a basis of so many elements, and an impossible gamma.

    Raises:
        PrtError: naming both shapes, or the gamma.
    """
    if coefficients.shape != (elements, 3):
        raise PrtError(
            f"coefficients of shape {tuple(coefficients.shape)} do not fit a basis of {elements} elements; "
            f"they must be ({elements}, 3), one column per colour"
        )
    if not gamma > 0:
        raise PrtError(f"gamma={gamma} must be above 0; 1 is linear, 2.2 the usual")

"""What a lightmap asks of an asset: where its texels lie, where light is measured, what a pixel shows."""

import dataclasses
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.scene.gbuffer import GBuffer
from prt.scene.view import View

#: distance from the surface at which rays start, in radii of the asset
OFFSET = 1e-4


def texel_centres(texel: Int[Tensor, "N"], size: tuple[int, int]) -> Float[Tensor, "N 2"]:
    """Places in an H x W lightmap of the middles of texels, given by their flat index."""
    height, width = size
    return torch.stack([(texel % width + 0.5) / width, (texel // width + 0.5) / height], 1)


def map_view(centre: Sequence[float], size: tuple[int, int]) -> View:
    """The view of a lightmap that is looked at as an image: it has no camera, only a size."""
    x, y, z = centre
    height, width = size
    return View((x, y, z), (x, y, z + 1.0), width=width, height=height)


@dataclasses.dataclass
class Sites:
    """S places on an asset whose light, averaged texel by texel, fills a lightmap of H x W texels.

    Attributes:
        texel: flat index ``row * W + column`` of the texel each belongs to, ascending.
        position: on the surface (of a hair: on its round surface), world units.
        normal: unit, outwards.
        size: (H, W).
    """

    texel: Int[Tensor, "S"]
    position: Float[Tensor, "S 3"]
    normal: Float[Tensor, "S 3"]
    size: tuple[int, int]


@dataclasses.dataclass
class MeasurePoints:
    """P points where direct light is measured: the fake G-buffer of Belcour 2022, section 4.3.

    Attributes:
        position: world units.
        normal: unit.
        albedo: linear RGB share of the light that is sent on; 1 on a hull.
        group: which of the measurements each belongs to, (P,) in [0, M): supersampling averages a group.
    """

    position: Float[Tensor, "P 3"]
    normal: Float[Tensor, "P 3"]
    albedo: Float[Tensor, "P 3"]
    group: Int[Tensor, "P"]


@dataclasses.dataclass
class AtlasGBuffer(GBuffer):
    """A G-buffer whose ``uv`` is the place in the asset's lightmap.

    ``uv`` lies in [0, 1]^2, texel (row i, column j) of an H x W lightmap has its centre at
    ``((j + 0.5) / W, (i + 0.5) / H)``.

    Attributes:
        triangle: of the asset's mesh (``SurfaceAsset.mesh``), -1 where it is not made of triangles.
        barycentric: weights of the triangle's second and third corner.
        supersample: samples along each side of a pixel: ``view`` has that many more pixels a side than the
            images that :meth:`image` makes.
    """

    triangle: Int[Tensor, "N"] = dataclasses.field(kw_only=True)
    barycentric: Float[Tensor, "N 2"] = dataclasses.field(kw_only=True)
    supersample: int = dataclasses.field(default=1, kw_only=True)

    FIELDS = (*GBuffer.FIELDS, "triangle", "barycentric")

    def image(self, values: Float[Tensor, "N C"]) -> Float[Tensor, "H W C"]:
        """Means over the samples of each pixel; samples that hit nothing are zero."""
        fine, many = super().image(values), self.supersample
        if many == 1:
            return fine
        height, width, channels = fine.shape
        return fine.view(height // many, many, width // many, many, channels).mean((1, 3))


@dataclasses.dataclass
class TriangleMesh:
    """All triangles of an asset as one mesh, world space.

    Attributes:
        position, normal: per vertex; normals are unit, those of the faces where a shape has none of its own
            (its vertices are then not shared).
        face: vertex indices.
        shape: which of the asset's shapes each triangle belongs to.
    """

    position: Float[Tensor, "V 3"]
    normal: Float[Tensor, "V 3"]
    face: Int[Tensor, "F 3"]
    shape: Int[Tensor, "F"]

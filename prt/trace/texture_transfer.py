"""Transfer stored in a texture over a mesh's atlas (Iwanicki and Sloan 2009; the baseline of Dhawal 2022)."""

from jaxtyping import Float
from torch import Tensor

from prt.trace.surface import MeshSurface
from prt.trace.transfer import bake


def texture_transfer(
    surface: MeshSurface, order: int, directions: int, seed: int, label: str = ""
) -> Float[Tensor, "T K"]:
    """Transfer vectors of the H W texels of the surface's atlas, row by row.

    One point stands for each texel that shows a part of the surface; the others take the value of the nearest
    one, so that bilinear lookups never reach an empty texel.
    """
    asset = surface.asset
    texels = asset.texel_gbuffer()
    values = bake(surface, texels.position, texels.normal, order, directions, seed, label)
    return values[asset.fill]

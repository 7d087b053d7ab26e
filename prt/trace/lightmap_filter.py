"""Removing the noise of a lightmap: neighbours in the map of an atlas, else neighbours in space."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.scene.lightmap_points import Sites
from prt.trace.denoise import denoise

#: texels of hair that share their paths
NEIGHBOURS = 16


def filtered(asset: Any, values: Float[Tensor, "C 3"], sites: Sites) -> Float[Tensor, "C 3"]:
    """The lightmap's C covered texels with less noise.

    Surfaces: Open Image Denoise's lightmap filter, seams padded. Assets whose neighbouring texels are no
    neighbours (hair: ``asset.filterable`` is False): the mean of each texel's :data:`NEIGHBOURS` nearest in
    space, itself included, as if they shared their paths.

    Raises:
        PrtError: from the denoiser, where that is missing.
    """
    if asset.filterable:
        image = values[asset.fill].view(*asset.size, 3)
        return denoise(image, kind="RTLightmap").view(-1, 3)[asset.covered]
    return values[nearest_texels(sites, min(NEIGHBOURS, len(values)))].mean(1)


def nearest_texels(sites: Sites, count: int) -> Int[Tensor, "C count"]:
    """For each covered texel the nearest by the middle of its places, as indices into the covered ones."""
    from scipy.spatial import cKDTree

    texel, index = sites.texel.unique(return_inverse=True)
    middle = torch.zeros((len(texel), 3)).index_add_(0, index, sites.position)
    middle /= torch.bincount(index)[:, None]
    _, nearest = cKDTree(middle.numpy()).query(middle.numpy(), k=[*range(1, count + 1)])
    return torch.from_numpy(nearest).long()

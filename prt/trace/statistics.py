"""What recorded transport says about the wavelets: how large their coefficients are."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.light import haar
from prt.scene.gbuffer import GBuffer
from prt.trace.transport import Transport


def wavelet_scale(transport: Transport, gbuffer: GBuffer, cells: int = 12) -> Float[Tensor, "T"]:
    """Root mean square of the transport coefficients per wavelet, sigma_k, averaged over the three colours.

    A single recorded row is mostly Monte Carlo noise at the fine wavelets, and noise must not count as
    transport. Rows are therefore averaged over clusters of points that lie close together and reflect into
    about the same direction, which lowers the noise power by the size of the cluster, and sigma_k is taken
    over the clusters, weighted by their sizes.

    Args:
        gbuffer: the points of the transport's rows.
        cells: clusters along the longest side of the points' bounding box.
    """
    power = torch.zeros(6 * transport.resolution**2)
    for rows in cluster_rows(transport, gbuffer, cells):
        power += rows.square().sum(dim=0)
    return (power / (3 * len(gbuffer))).clamp(min=1e-20).sqrt()


def cluster_rows(transport: Transport, gbuffer: GBuffer, cells: int) -> Iterator[Float[Tensor, "C T"]]:
    """Wavelet coefficients of the mean rows of clusters, colour by colour: all three at once are large.

    A row is weighted by the root of the number of its points: its square counts as often as they do.
    """
    wavelets = 6 * transport.resolution**2
    cluster = clusters(gbuffer, cells)
    size = torch.bincount(cluster)
    place = cluster[transport.pixel_of_sample()] * wavelets + transport.texel
    for channel in range(3):
        rows = torch.bincount(place, transport.weight[:, channel], minlength=len(size) * wavelets).float()
        # the sum over a cluster divided by sqrt(size)
        rows = rows.view(len(size), wavelets, 1) / size.sqrt()[:, None, None]
        yield haar.forward(rows)[:, :, 0]


def clusters(gbuffer: GBuffer, cells: int) -> Int[Tensor, "N"]:
    """The cluster of every point: the cell it lies in and the cubemap face its wr points through."""
    low, high = gbuffer.position.min(dim=0).values, gbuffer.position.max(dim=0).values
    cell = ((gbuffer.position - low) / (high - low).max().clamp(min=1e-9) * (cells - 1e-3)).long()
    axis = gbuffer.wr.abs().argmax(dim=1)
    negative = gbuffer.wr.gather(1, axis[:, None])[:, 0] < 0
    key = ((cell[:, 0] * cells + cell[:, 1]) * cells + cell[:, 2]) * 6 + 2 * axis + negative
    return torch.unique(key, return_inverse=True)[1]

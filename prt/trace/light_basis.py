"""A basis of lightings made for one scene: prior-weighted principal components of its recorded transport.

Wavelet coefficients of transport are weighted by what lightings usually have there (the root mean square of
the training lightings, s_k), and the right singular vectors V of those rows are kept. A pixel then needs M
numbers, a_m = sum_k T_k s_k V_km, and a lighting M numbers, c_m = sum_k V_km L_k / s_k; radiance is their dot
product. Under the prior every c_m has about unit variance: an error of a_m is an error of the image.
"""

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light import haar
from prt.scene.gbuffer import GBuffer
from prt.trace.statistics import cluster_rows
from prt.trace.transport import Transport

#: least weight of a wavelet, as a share of the largest: lightings may hold what no training lighting did
LEAST = 1e-4
#: passes of the randomised singular value decomposition, and vectors beside those that are kept
PASSES, SPARE = 4, 24
#: clusters along the longest side of the points' bounding box
CELLS = 16


@dataclasses.dataclass
class LightBasis:
    """M lighting patterns.

    Attributes:
        patterns: relighting transport with pattern m gives a_m; flat.
        projection: a lighting times this gives its c_m; per channel.
        energy: share of the weighted transport's energy that the first so many patterns hold.
    """

    patterns: Float[Tensor, "M T"]
    projection: Float[Tensor, "T M"]
    energy: Float[Tensor, "M"]

    @property
    def terms(self) -> int:
        return len(self.patterns)

    def project(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "M 3"]:
        """c of a lighting."""
        return self.projection.T @ lighting.reshape(-1, 3)

    def kept(self, lighting: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
        """The lighting that the basis sees: transport gives the same for it as ``a . c``."""
        return (self.patterns.T @ self.project(lighting)).reshape(lighting.shape)


def prior_weighted_basis(
    transport: Transport, gbuffer: GBuffer, lightings: Float[Tensor, "n T 3"], terms: int
) -> LightBasis:
    """The M patterns that lose the least of recorded transport under lightings like the given ones.

    Single rows are mostly Monte Carlo noise; they are averaged over clusters of points that lie close
    together and reflect into about the same direction (:func:`prt.trace.statistics.cluster_rows`).

    Raises:
        PrtError: for more terms than there are texels.
    """
    total = 6 * transport.resolution**2
    if not 1 <= terms <= total:
        raise PrtError(f"method.terms={terms} must be from 1 to {total}, the texels of the lighting")
    weight = prior_weights(lightings)
    rows = torch.cat(list(cluster_rows(transport, gbuffer, CELLS))) * weight
    # a fixed start: equal transport gives an equal basis
    with torch.random.fork_rng():
        torch.manual_seed(0)
        _, values, vectors = torch.svd_lowrank(rows, min(terms + SPARE, *rows.shape), niter=PASSES)
    vectors = vectors[:, :terms]
    energy = values.square().cumsum(0)[: vectors.shape[1]] / rows.square().sum()
    patterns = haar.inverse((vectors * weight[:, None])[None])[0].T.contiguous()
    projection = haar.inverse((vectors / weight[:, None])[None])[0].contiguous()
    return LightBasis(patterns, projection, energy)


def prior_weights(lightings: Float[Tensor, "n T 3"]) -> Float[Tensor, "T"]:
    """s_k: root mean square of the wavelet coefficients of lightings, nowhere quite zero."""
    weight = haar.forward(lightings).square().mean(dim=(0, 2)).sqrt()
    return weight.clamp(min=LEAST * float(weight.max()))

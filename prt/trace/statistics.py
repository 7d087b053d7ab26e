"""What recorded transport says about the wavelets: how large their coefficients are."""

import torch
from jaxtyping import Float
from torch import Tensor

from prt.light import haar
from prt.trace.transport import Transport


def wavelet_scale(transport: Transport, rows: int, generator: torch.Generator, chunk: int = 256) -> Float[Tensor, "T"]:
    """Root mean square of the transport coefficients per wavelet, sigma_k, over randomly chosen rows.

    The samples of a row are split into two independent halves a and b, and sigma_k^2 = mean of T_k^a T_k^b:
    the Monte Carlo noise of the halves is independent, so it does not count as transport (the mean of T_k^2
    would put a floor of noise under the fine wavelets). Averaged over the three colours. Where the estimate
    is below a hundredth of the mean over the wavelets of equal support it is raised to that.
    """
    resolution = transport.resolution
    chosen = torch.randperm(transport.pixels, generator=generator)[:rows]
    total = torch.zeros(6 * resolution**2)
    for part in chosen.split(chunk):
        some = transport.rows(part)
        first = torch.rand(len(some.texel), generator=generator) < 0.5
        halves = []
        for side in (first, ~first):
            half = Transport(resolution, some.offsets, some.texel, some.weight * side[:, None] * 2, some.bounces)
            texels = half.dense().view(-1, 6, resolution, resolution, 3)
            halves.append(haar.forward(texels).view(len(part), -1, 3))
        total += (halves[0] * halves[1]).mean(dim=2).sum(dim=0)
    power = total / len(chosen)
    support = haar.support_size(torch.arange(len(power)), resolution)
    sums = torch.zeros(resolution + 1).index_add_(0, support, power.clamp(min=0))
    mean = sums / torch.bincount(support, minlength=resolution + 1).clamp(min=1)
    return torch.maximum(power, 0.01 * mean[support]).clamp(min=1e-20).sqrt()

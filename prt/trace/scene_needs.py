"""What a scene and its lighting ask of a model, measured without training anything.

Each figure says how small a model can be: how many wavelets or harmonics hold the lighting, how many patterns
the transport, how much of the light is indirect, how much of the image is glossy.
"""

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from prt.light import haar
from prt.light.cubemap import texel_solid_angles
from prt.light.sh import project
from prt.scene.gbuffer import GBuffer
from prt.trace.light_basis import CELLS, prior_weights
from prt.trace.statistics import cluster_rows
from prt.trace.transport import Transport

#: bands of spherical harmonics that are tried
HIGHEST_DEGREE = 15
#: rows of transport kept beside the terms looked for; passes of the randomised decomposition
TERMS, PASSES = 512, 4
#: below this roughness a surface is called glossy, below that a near-mirror (sigma, the root of GGX alpha)
GLOSSY, MIRROR = 0.6, 0.25
#: least specular reflectance that counts
SPECULAR = 0.05


def fewest(kept: Float[Tensor, "n"], loss: float) -> int | None:
    """The first place, from 1, at which at most ``loss`` of the energy is missing, or None."""
    enough = (kept >= 1 - loss).nonzero()
    return int(enough[0]) + 1 if len(enough) else None


def wavelet_energy(
    lightings: Float[Tensor, "n 6 R R 3"], scale: Float[Tensor, "T"] | None = None
) -> Float[Tensor, "T"]:
    """Mean share of a lighting's energy in its so many largest wavelets.

    Args:
        scale: of transport at every wavelet; energy is then that of what the transport makes of the lighting.
    """
    squares = haar.forward(lightings).flatten(1, 3).square().sum(dim=2)
    if scale is not None:
        squares = squares * scale.square()
    kept = squares.sort(dim=1, descending=True).values.cumsum(dim=1)
    return (kept / kept[:, -1:].clamp(min=1e-30)).mean(dim=0)


def harmonic_energy(lightings: Float[Tensor, "n 6 R R 3"]) -> Float[Tensor, "D"]:
    """Mean share of a lighting's energy in harmonics up to degree 0, 1, ..."""
    coefficients = project(lightings.double(), HIGHEST_DEGREE).square().sum(dim=2)
    angles = texel_solid_angles(lightings.shape[2], torch.float64)
    total = (lightings.double().square() * angles[..., None]).sum(dim=(1, 2, 3, 4))
    bands = [coefficients[:, : (degree + 1) ** 2].sum(dim=1) for degree in range(HIGHEST_DEGREE + 1)]
    return (torch.stack(bands, dim=1) / total[:, None].clamp(min=1e-30)).mean(dim=0).float()


def transport_energy(
    transport: Transport, gbuffer: GBuffer, lightings: Float[Tensor, "n T 3"], seed: int = 0
) -> Float[Tensor, "M"]:
    """Share of the energy of prior-weighted transport in its so many best patterns; noise is not counted.

    A record is split into two halves by its samples. Patterns are found in one, and energies are products of
    both: noise, which is independent, adds nothing to them. What is left over falls as it should.
    """
    first, second = halves(transport, seed)
    weight = prior_weights(lightings)
    rows = [torch.cat(list(cluster_rows(part, gbuffer, CELLS))) * weight for part in (first, second)]
    return shared_energy(*rows)


def shared_energy(first: Float[Tensor, "N T"], second: Float[Tensor, "N T"]) -> Float[Tensor, "M"]:
    """Share of the energy common to two noisy copies of the same rows in its so many best patterns."""
    total = float((first * second).sum())
    with torch.random.fork_rng():
        torch.manual_seed(0)
        _, _, vectors = torch.svd_lowrank(first, min(TERMS, *first.shape), niter=PASSES)
    products = ((first @ vectors) * (second @ vectors)).sum(dim=0)
    return (products.cumsum(0) / total).clamp(max=1.0)


def halves(transport: Transport, seed: int) -> tuple[Transport, Transport]:
    """The samples of a record in two records of half as many, of the same mean each."""
    generator = torch.Generator().manual_seed(seed)
    mine = torch.rand(len(transport.texel), generator=generator) < 0.5
    doubled = dataclasses.replace(transport, weight=2 * transport.weight)
    return doubled.samples(mine), doubled.samples(~mine)


def surface_shares(gbuffer: GBuffer) -> dict[str, float]:
    """Shares of the pixels that are glossy, and that are near-mirrors."""
    if len(gbuffer) == 0:
        return {"glossy": 0.0, "mirror": 0.0}
    shiny = gbuffer.specular.mean(dim=1) > SPECULAR
    rough = gbuffer.roughness[:, 0]
    return {
        "glossy": float((shiny & (rough < GLOSSY)).float().mean()),
        "mirror": float((shiny & (rough < MIRROR)).float().mean()),
    }


def surface_cells(gbuffer: GBuffer, width: float) -> int:
    """Cells of a grid of this width that hold a visible point: the rows a level needs without collisions."""
    cell = (gbuffer.position / width).floor().long()
    cell = cell - cell.amin(dim=0)
    size = cell.amax(dim=0) + 1
    return len(torch.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]))

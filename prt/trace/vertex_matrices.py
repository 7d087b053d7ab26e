"""Transfer matrices of places on a surface: from distant lighting to the indirect light that arrives there.

Both are in spherical harmonics (Sloan, Kautz and Snyder 2002, section 4.2, glossy transfer): row i, column j
is the part of harmonic i that arrives, from surfaces, at a place of a scene lit by harmonic j.
"""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.light.cubemap import texel_solid_angles
from prt.light.sh import sh_basis, texel_basis
from prt.scene.frames import perpendicular
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.cubemap_emitter import TexelSampler
from prt.trace.record import EMPTY, follow
from prt.trace.sh_transfer import hammersley


def incident_matrices(
    mi_scene: Any,
    origin: Float[Tensor, "V 3"],
    normal: Float[Tensor, "V 3"],
    degree: int,
    paths: int,
    max_depth: int,
    resolution: int,
    seed: int,
    sampler: TexelSampler | None = None,
) -> Float[Tensor, "V 3 K K"]:
    """Matrices of places, one for each colour, estimated by path tracing with the scene's own materials.

    Paths begin evenly over the hemisphere; what leaves the scene at once is direct light and left out. Where
    a path leaves, the harmonics of the lighting are averaged over the texel it leaves through: of a
    cubemap of that resolution nothing is lost.

    Args:
        mi_scene: whatever its emitters, they are not looked at.
        origin, normal: where rays start, off the surface already, and the middle of their hemisphere.
        degree: the largest of both, K = (degree + 1)^2.
        paths: of each place.
        max_depth: surface bounces of a path, of which the first is what it meets from here.
        resolution: R of the lighting.
        seed: of directions and paths.
        sampler: of next-event directions, in scenes that paths leave hardly (``record.prior_sampler``).
    """
    mi = mitsuba()
    count, K = len(origin), (degree + 1) ** 2
    shift = torch.rand((count, 1, 2), generator=torch.Generator().manual_seed(seed))
    directions = hemisphere_directions(normal, paths, shift)
    starts = origin[:, None].expand(directions.shape).reshape(-1, 3)
    rng = mi.load_dict({"type": "independent"})
    rng.seed(seed, count * paths)
    ray = mi.Ray3f(_columns(mi.Point3f, starts), _columns(mi.Vector3f, directions.reshape(-1, 3)))
    texel, weight, bounces = follow(mi_scene, ray, rng, count * paths, max_depth, resolution, sampler)

    lit = (texel != EMPTY) & (bounces >= 1)
    samples = lit.view(count, -1).sum(1).tolist()
    path = lit.nonzero()[:, 0]
    outgoing = (texel_basis(resolution, degree) / texel_solid_angles(resolution).view(-1, 1)).float()
    # weights are summed over a hemisphere of paths, each for its share of 2 pi
    weight = weight[lit] * (2 * math.pi / paths)
    out = torch.zeros((count, 3, K, K))
    parts = zip(path.split(samples), texel[lit].split(samples), weight.split(samples), strict=True)
    for place, (paths_here, texels, weights) in enumerate(parts):
        arriving = sh_basis(directions.view(-1, 3)[paths_here], degree)
        leaving = weights.T[:, :, None] * outgoing[texels.long()]
        out[place] = arriving.T @ leaving
    return out


def hemisphere_directions(
    normal: Float[Tensor, "V 3"], count: int, shift: Float[Tensor, "V 1 2"]
) -> Float[Tensor, "V count 3"]:
    """Unit directions evenly over the hemisphere about each normal: a Hammersley set, moved by ``shift``."""
    u = hammersley(count, shift)
    height, angle = u[..., :1], 2 * math.pi * u[..., 1:]
    radius = (1 - height**2).clamp_min(0).sqrt()
    tangent, other = perpendicular(normal)
    along = radius * angle.cos() * tangent[:, None] + radius * angle.sin() * other[:, None]
    return along + height * normal[:, None]


def _columns(kind: Any, rows: Float[Tensor, "N 3"]) -> Any:
    return kind(np.ascontiguousarray(rows.numpy().T, dtype=np.float32))

"""Training environments with one lamp or sun added, of any size, colour and place.

Few photographed rooms have a lamp as strong as a sun, and none has it everywhere: what a scene answers to a
single bright texel would never be trained, while test maps hold suns. Recorded transport relights a training
point under any environment at no cost, so such lights need no rendering.
"""

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import mean_radiance, texel_directions

#: angular radius of a lamp, in texels, log-uniform: a small window. Radiance recorded towards a single texel
#: is too noisy to train on, and what a short fit learns of transport is no finer
RADIUS = (1.5, 6.0)
#: share of the environment's light that comes from the lamp, uniform
SHARE = (0.2, 0.85)
#: darkest colour channel of a lamp over its brightest, uniform from here to one
TINT = 0.5


def checked_lamps(count: int) -> int:
    """The setting ``lighting.lamps`` of an environment set.

    Raises:
        PrtError: if it is negative.
    """
    if count < 0:
        raise PrtError(f"lighting.lamps={count} must be at least 0")
    return count


def fingerprint(count: int) -> dict[str, Any]:
    """Plain JSON that determines what :func:`with_lamps` adds, for cache keys; nothing for no lamps."""
    settings = {"count": count, "radius": list(RADIUS), "share": list(SHARE), "tint": TINT}
    return {"lamps": settings} if count else {}


def lamp_directions(count: int, generator: torch.Generator) -> Float[Tensor, "n 3"]:
    """Unit directions spread uniformly over the sphere."""
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)


def with_lamps(environments: Float[Tensor, "m 6 R R 3"], count: int, seed: int) -> Float[Tensor, "n 6 R R 3"]:
    """``count`` of the environments, drawn at random, each with one lamp of its own; unit mean radiance.

    A lamp is a lobe ``exp((cos - 1) / radius^2)`` about its direction. A black environment gives the lamp
    alone.
    """
    generator = torch.Generator().manual_seed(seed)
    resolution = environments.shape[2]
    texels = texel_directions(resolution)
    rooms = torch.randint(len(environments), (count,), generator=generator).tolist()
    directions = lamp_directions(count, generator)
    radii, shares, tints = (torch.rand((count, n), generator=generator) for n in (1, 1, 3))
    out = []
    for room, direction, radius, share, tint in zip(rooms, directions, radii, shares, tints, strict=True):
        width = RADIUS[0] * (RADIUS[1] / RADIUS[0]) ** float(radius) * math.pi / (2 * resolution)
        lobe = torch.exp((texels @ direction - 1) / width**2)
        lamp = unit(lobe[..., None] * (TINT + (1 - TINT) * tint))
        part = SHARE[0] + (SHARE[1] - SHARE[0]) * float(share)
        out.append((1 - part) * unit(environments[room]) + part * lamp)
    return torch.stack(out) if out else environments[:0]


def unit(environment: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
    """Scaled to unit mean radiance over sphere and colours; black stays black."""
    return environment / mean_radiance(environment).mean().clamp_min(1e-12)

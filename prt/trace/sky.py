"""Clear skies: Mitsuba's ``sunsky`` (Hosek and Wilkie 2012, 2013) above a diffuse ground, as cubemaps."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.light.cubemap import direction_to_texel, texel_directions, texel_solid_angles
from prt.scene.mitsuba_setup import mitsuba

#: apparent diameter of the sun in degrees (the plugin's own default)
SUN_APERTURE = 0.5358
#: sub-texels a side for the sky, samples a side for the sun's disc
SKY_PARTS, SUN_PARTS = 4, 48


def random_sky(seed: int, R: int) -> Float[Tensor, "6 R R 3"]:
    """Sky number ``seed``: random sun, haze, ground and share of the sun that clouds let through."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(0, 2 * math.pi), math.asin(rng.uniform(0.05, 0.95))
    sun = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.sin(elevation),
            math.cos(elevation) * math.sin(azimuth),
        ]
    )
    ground = np.array([0.2, 0.18, 0.12]) * rng.uniform(0.3, 2.5) * rng.uniform(0.8, 1.25, 3)
    # a sun that fills one texel leaves little for other wavelets: most skies have it veiled
    return sky(R, sun, turbidity=rng.uniform(2, 9), ground=ground, sun_scale=rng.uniform(0, 1) ** 2)


def sky(
    R: int, sun: np.ndarray, turbidity: float, ground: np.ndarray, sun_scale: float
) -> Float[Tensor, "6 R R 3"]:
    """Radiance of sky, sun and ground.

    The sky is averaged over sub-texels; the sun, smaller than a sub-texel, is integrated over its own disc
    and put into the texels it covers with its energy kept.

    Args:
        sun: unit direction towards the sun, y up.
        turbidity: haze, 1 (clear) to 10.
        ground: diffuse reflectance of the ground, RGB.
        sun_scale: factor on the sun's radiance.
    """
    mi = mitsuba()
    common = {
        "type": "sunsky",
        "sun_direction": sun.tolist(),
        "turbidity": turbidity,
        "sun_aperture": SUN_APERTURE,
        "albedo": float(ground.mean()),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
    }
    d = texel_directions(R * SKY_PARTS, torch.float64)
    parts = evaluate(mi.load_dict({**common, "sun_scale": 0.0}), d.reshape(-1, 3))
    out = parts.reshape(6, R, SKY_PARTS, R, SKY_PARTS, 3).mean((2, 4))
    angle = texel_solid_angles(R, torch.float64)
    if sun_scale > 0:
        disc, part = sun_disc(torch.from_numpy(sun))
        light = evaluate(mi.load_dict({**common, "sky_scale": 0.0, "sun_scale": sun_scale}), disc) * part
        energy = torch.zeros((6 * R * R, 3), dtype=torch.float64)
        energy.index_add_(0, direction_to_texel(disc, R), light)
        out = out + energy.reshape(6, R, R, 3) / angle[..., None]
    directions = texel_directions(R, torch.float64)
    irradiance = (out * (directions[..., 1].clamp_min(0) * angle)[..., None]).sum((0, 1, 2))
    below = (d.reshape(6, R, SKY_PARTS, R, SKY_PARTS, 3)[..., 1] < 0).double().mean((2, 4))
    out = out + below[..., None] * irradiance * torch.from_numpy(ground) / math.pi
    return out.float()


def evaluate(emitter, d: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
    """Radiance an environment emitter sends from directions ``d``."""
    mi = mitsuba()
    si = mi.SurfaceInteraction3f()
    si.wi = -mi.Vector3f(*(mi.Float(np.ascontiguousarray(x, np.float32)) for x in d.numpy().T))
    return torch.from_numpy(np.array(emitter.eval(si)).T.astype(np.float64))


def sun_disc(sun: Float[Tensor, "3"]) -> tuple[Float[Tensor, "N 3"], float]:
    """Directions spread evenly over the sun's disc, and the solid angle each stands for."""
    place = (torch.arange(SUN_PARTS, dtype=torch.float64) + 0.5) / SUN_PARTS
    cosine = math.cos(math.radians(SUN_APERTURE / 2))
    height, phi = torch.meshgrid(1 - place * (1 - cosine), 2 * math.pi * place, indexing="ij")
    side = torch.linalg.cross(sun, torch.tensor([0.3, 0.1, -0.9], dtype=torch.float64))
    side = side / side.norm()
    other = torch.linalg.cross(sun, side)
    radius = (1 - height * height).clamp_min(0).sqrt()
    d = height[..., None] * sun + radius[..., None] * (
        phi.cos()[..., None] * side + phi.sin()[..., None] * other
    )
    return d.reshape(-1, 3), 2 * math.pi * (1 - cosine) / SUN_PARTS**2

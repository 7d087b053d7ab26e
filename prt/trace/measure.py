"""Direct light at measurement points: the fake G-buffer of Belcour 2022, section 4.3, with traced shadows.

Point, spot and directional lights cost one shadow ray a point. For environments the visibility of every
point is found once and kept as a matrix from the texels of a small cubemap: a new one is one product.
"""

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.cubemap import texel_directions, texel_solid_angles
from prt.light.local import LightRig
from prt.scene.lightmap_points import OFFSET, MeasurePoints
from prt.trace.rig import LitAsset

#: texels a side of the cubemap that visibility is kept for; finer environments are averaged down to it
SKY = 16


class Meter:
    """Measures M values of direct light on an asset.

    Args:
        asset: what is measured on.
        count: M; ``supersample`` points are shaded for each and averaged (section 5.1).
        seed: of the places.

    Raises:
        PrtError: for counts out of range or an asset without surface.
    """

    def __init__(self, asset: Any, count: int, supersample: int, seed: int = 0):
        for name, value, most in (("points", count, 65536), ("supersample", supersample, 64)):
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= most:
                raise PrtError(f"method.{name}={value!r} must be a whole number from 1 to {most}")
        self.asset, self.count, self.supersample, self.seed = asset, count, supersample, seed
        self._points: dict[int, MeasurePoints] = {}
        self._lit: dict[int, LitAsset] = {}
        self._sky: dict[int, Tensor] = {}

    def points(self, pose: int = 0) -> MeasurePoints:
        """The points of a pose."""
        if pose not in self._points:
            self._points[pose] = self.asset.measure_points(self.count, self.supersample, self.seed, pose)
        return self._points[pose]

    @property
    def nbytes(self) -> int:
        """Position, normal, albedo and group of every point, in bytes."""
        return self.count * self.supersample * (9 * 4 + 4)

    def __call__(self, rig: LightRig) -> Float[Tensor, "M 3"]:
        """Mean direct radiance sent on by the points of each group: albedo times irradiance over pi."""
        points, lit = self.points(rig.pose), self._lit_asset(rig.pose)
        arriving = torch.zeros_like(points.position)
        origin = points.position + OFFSET * self.asset.radius * points.normal
        for light in rig.lights:
            to_light, distance, irradiance = light.incident(points.position)
            cosine = (to_light * points.normal).sum(1)
            near = ((cosine > 0) & (irradiance.amax(dim=1) > 0)).nonzero()[:, 0]
            if len(near) == 0:
                continue
            shadow = lit.occluded(origin[near], to_light[near], distance[near])
            seen = near[~shadow]
            arriving[seen] += cosine[seen, None] * irradiance[seen]
        if rig.environment is not None:
            sky = averaged(rig.environment).reshape(-1, 3)
            arriving += self._visibility(rig.pose) @ sky
        sent = points.albedo * arriving / math.pi
        if self.supersample == 1:
            return sent[points.group.argsort()]
        mean = torch.zeros((self.count, 3)).index_add_(0, points.group, sent)
        return mean / self.supersample

    def _lit_asset(self, pose: int) -> LitAsset:
        if pose not in self._lit:
            self._lit[pose] = LitAsset(self.asset, pose)
        return self._lit[pose]

    def _visibility(self, pose: int) -> Float[Tensor, "P T"]:
        """Cosine times solid angle of the cubemap's texels that each point sees."""
        if pose not in self._sky:
            points, lit = self.points(pose), self._lit_asset(pose)
            directions = texel_directions(SKY).reshape(-1, 3)
            weights = texel_solid_angles(SKY).reshape(-1)
            origin = points.position + OFFSET * self.asset.radius * points.normal
            rows = []
            for at, normal in zip(origin.split(256), points.normal.split(256), strict=True):
                cosine = (normal @ directions.T).clamp_min(0)
                which = cosine.nonzero()
                far = torch.full((len(which),), math.inf)
                shadow = lit.occluded(at[which[:, 0]], directions[which[:, 1]], far)
                seen = torch.zeros_like(cosine)
                seen[which[:, 0], which[:, 1]] = (~shadow).float()
                rows.append(cosine * seen * weights)
            self._sky[pose] = torch.cat(rows)
        return self._sky[pose]


def averaged(environment: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 S S 3"]:
    """A cubemap at the resolution visibility is kept for: solid-angle weighted means, or repeated texels."""
    resolution = environment.shape[1]
    if resolution == SKY:
        return environment
    if resolution < SKY:
        times = SKY // resolution
        return environment.repeat_interleave(times, 1).repeat_interleave(times, 2)
    times = resolution // SKY
    weight = texel_solid_angles(resolution)[..., None]

    def sums(values: Tensor) -> Tensor:
        return values.view(6, SKY, times, SKY, times, -1).sum((2, 4))

    return sums(environment * weight) / sums(weight)

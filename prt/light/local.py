"""Local and distant lights as plain data, and the light they send to a point without asking what is between.

A :class:`LightRig` is one lighting configuration: any number of point, spot and directional lights, an
environment or none, and the pose of the asset it shines on (Belcour 2022, section 4.1: one pair of direct and
indirect light is made per configuration).
"""

import dataclasses
import hashlib
import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError

KINDS = ("point", "spot", "directional")
Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class LocalLight:
    """One light without extent.

    Attributes:
        kind: ``point``, ``spot`` or ``directional``.
        color: linear RGB radiant intensity in W/sr (point and spot) or irradiance on a surface facing it in
            W/m^2 (directional).
        position: world units; a directional light has none.
        direction: unit, the way the light travels; a point light has none.
        cutoff, beam: half angles in degrees where a spot ends and where it begins to fall off.
    """

    kind: str
    color: Vector
    position: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (0.0, -1.0, 0.0)
    cutoff: float = 30.0
    beam: float = 22.5

    def __post_init__(self):
        if self.kind not in KINDS:
            raise PrtError(f"light kind {self.kind!r} is not one of {', '.join(KINDS)}")
        if not all(math.isfinite(c) and c >= 0 for c in self.color):
            raise PrtError(f"light color {self.color} must be finite and not negative")
        if not all(math.isfinite(c) for c in self.position):
            raise PrtError(f"light position {self.position} must be finite")
        if self.kind != "point" and not abs(math.hypot(*self.direction) - 1) < 1e-3:
            raise PrtError(f"light direction {self.direction} of a {self.kind} light must have length 1")
        if self.kind == "spot" and not 0 < self.beam <= self.cutoff < 90:
            raise PrtError(f"spot light: 0 < beam={self.beam} <= cutoff={self.cutoff} < 90 degrees must hold")

    def incident(
        self, position: Float[Tensor, "N 3"]
    ) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N"], Float[Tensor, "N 3"]]:
        """Unit directions to the light, distances (infinite: directional), irradiance on a facing surface."""
        color = position.new_tensor(self.color)
        axis = position.new_tensor(self.direction)
        if self.kind == "directional":
            distance = position.new_full((len(position),), math.inf)
            return -axis.expand_as(position), distance, color.expand_as(position)
        away = position.new_tensor(self.position) - position
        distance = away.norm(dim=1).clamp_min(1e-9)
        to_light = away / distance[:, None]
        strength = distance**-2
        if self.kind == "spot":
            strength = strength * self._falloff((-(to_light * axis).sum(1)).clamp(-1, 1))
        return to_light, distance, strength[:, None] * color

    def _falloff(self, cosine: Float[Tensor, "N"]) -> Float[Tensor, "N"]:
        """Mitsuba's spot: full within ``beam``, then linear in the angle down to zero at ``cutoff``."""
        cutoff, beam = math.radians(self.cutoff), math.radians(self.beam)
        slope = (cutoff - cosine.acos()) / max(cutoff - beam, 1e-9)
        return torch.where(cosine >= math.cos(beam), 1.0, slope.clamp(0.0, 1.0))


@dataclasses.dataclass(frozen=True)
class LightRig:
    """One lighting configuration.

    Attributes:
        lights: local and directional lights.
        environment: a cubemap of radiance, or None.
        pose: which keyframe of an animated asset is lit.
    """

    lights: tuple[LocalLight, ...] = ()
    environment: Float[Tensor, "6 R R 3"] | None = None
    pose: int = 0

    def scaled(self, factor: float) -> "LightRig":
        """All of it so many times brighter."""
        lights = tuple(
            dataclasses.replace(light, color=tuple(factor * c for c in light.color)) for light in self.lights
        )
        environment = None if self.environment is None else factor * self.environment
        return LightRig(lights, environment, self.pose)

    def to(self, device: Any) -> "LightRig":
        """Itself: a few numbers are no matter of devices."""
        return self

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON, for cache keys."""
        sky = self.environment
        return {
            "lights": [dataclasses.asdict(light) for light in self.lights],
            "environment": None if sky is None else hashlib.sha256(sky.numpy().tobytes()).hexdigest(),
            "pose": self.pose,
        }

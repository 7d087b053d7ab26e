"""A camera pose with the size of its image."""

import dataclasses
import math


@dataclasses.dataclass(frozen=True)
class View:
    """A pinhole camera in world space.

    Attributes:
        origin, target, up: three floats each, world units.
        fov: horizontal field of view in degrees.
        width, height: image size in pixels.
    """

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = 45.0
    width: int = 64
    height: int = 64

    @property
    def half_width(self) -> float:
        """Half the image's width on a plane at unit distance: the tangent of half the field of view."""
        return math.tan(math.radians(self.fov) / 2)

    def resized(self, width: int, height: int) -> "View":
        """The same pose with another image size (the vertical field of view follows the aspect)."""
        return dataclasses.replace(self, width=width, height=height)

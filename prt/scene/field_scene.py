"""What all scenes that are signed distance fields share."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.scene import Scene, Trajectory

Distance = Callable[[Float[Tensor, "N 3"]], Float[Tensor, "N"]]
Corner = tuple[float, float, float]
#: cells a side of the grid that is searched for a zero set, and points evaluated together
PROBE, CHUNK = 64, 1 << 16


class FieldScene(Scene):
    """One opaque, diffuse object of one colour, bounded by the zero set of :attr:`distance`.

    Args:
        cameras, name, max_depth, record: as in :class:`~prt.scene.scene.Scene`.
        albedo: linear RGB in [0, 1].

    Raises:
        PrtError: if a setting is out of range.
    """

    #: the distance as an expression (:class:`prt.scene.sdf.Sdf`), where it is one
    sdf: Any = None

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str,
        max_depth: int,
        record: Literal["bsdf", "nee"],
        albedo: Sequence[float],
    ):
        super().__init__(name, cameras, max_depth, record)
        self.albedo = numbers("albedo", albedo)
        if not all(0.0 <= part <= 1.0 for part in self.albedo):
            raise PrtError(f"scene.albedo={list(self.albedo)} must lie between 0 and 1; give linear RGB")

    @property
    def distance(self) -> Distance:
        """From points (N, 3) to distances (N,), negative inside, no greater than the true ones."""
        raise NotImplementedError

    def without_surface(self, least: float, most: float) -> str:
        """What to say where distances in the box lie between these and none is zero."""
        raise NotImplementedError

    def description(self) -> dict[str, Any]:
        """There is none.

        Raises:
            PrtError: always.
        """
        raise PrtError(
            f"scene {self.name} is a signed distance field, it has no shapes for Mitsuba; "
            "use task=relight_direct, or a mesh scene"
        )

    def check(self) -> None:
        """Look for a zero set on a grid of 64^3 points in the box, its cells' centres.

        Raises:
            PrtError: for distances that are NaN, or that do not change sign in the box.
        """
        distance, (low, high) = self.distance, self.bounds
        middles = (torch.arange(PROBE) + 0.5) / PROBE
        axes = [a + (b - a) * middles for a, b in zip(low, high, strict=True)]
        with torch.no_grad():
            values = torch.cat([distance(part) for part in torch.cartesian_prod(*axes).split(CHUNK)])
        if values.isnan().any():
            raise PrtError(f"scene {self.name}: the distance is NaN inside scene.bounds; guard its roots")
        least, most = float(values.min()), float(values.max())
        if not least < 0.0 < most:
            raise PrtError(self.without_surface(least, most))


def numbers(name: str, value: Any) -> Corner:
    """Three finite numbers of a setting.

    Raises:
        PrtError: naming the setting.
    """
    try:
        if isinstance(value, (str, bytes)) or any(isinstance(part, (str, bool)) for part in value):
            raise TypeError
        x, y, z = (float(part) for part in value)
    except (TypeError, ValueError):
        raise PrtError(f"scene.{name}={value!r} must be 3 numbers; give [x, y, z]") from None
    if not all(math.isfinite(part) for part in (x, y, z)):
        raise PrtError(f"scene.{name}={value!r} must be finite; give 3 numbers")
    return x, y, z

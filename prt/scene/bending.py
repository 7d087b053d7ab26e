"""A twisted column beside a coloured wall that bends, as an asset animated by random keyframes."""

import copy
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from prt.errors import PrtError
from prt.scene.deform import bend, deformed
from prt.scene.panels import block
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import MeshData, diffuse, to_mesh, twisted_column_mesh, twosided, unit_setting

RADIUS, HEIGHT = 0.3, 1.5
#: bent further than this the column's inner side would fold, or its top touch the wall
STEEPEST = 60.0


class Bending(Scene):
    """A column on a plate, bent sideways by a random angle to a random side in every keyframe.

    Args:
        keyframes: how many there are; the first ones of a longer list are those of a shorter.
        seed: of the keyframes.
        bend: range of the angle by which the top leans over, degrees, within 0 and 60; drawn evenly, as is
            the side it leans to, from the whole turn.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "bending",
        max_depth: int = 8,
        record: Literal["bsdf", "nee"] = "bsdf",
        keyframes: int = 8,
        seed: int = 0,
        bend: Sequence[float] = (0.0, 60.0),
    ):
        super().__init__(name, cameras, max_depth, record)
        for key, value, low in (("keyframes", keyframes, 1), ("seed", seed, 0)):
            if isinstance(value, bool) or not isinstance(value, int) or value < low:
                raise PrtError(f"scene.{key}={value!r} must be an integer of at least {low}")
        if isinstance(bend, str) or not isinstance(bend, Sequence) or len(bend) != 2:
            raise PrtError(
                f"scene.bend={bend!r} must be a list of 2 angles between 0 and {STEEPEST:g} degrees"
            )
        low, high = (unit_setting("bend", angle, 0.0, STEEPEST) for angle in bend)
        if low > high:
            raise PrtError(f"scene.bend={[low, high]} must rise: give the smaller angle first")
        rows = np.random.default_rng(seed).uniform((low, 0.0), (high, 360.0), (keyframes, 2))
        #: angle and side of every keyframe, degrees
        self.bends = [(float(angle), float(side)) for angle, side in rows]
        self.poses, self.pose = keyframes, 0

    def posed(self, pose: int) -> "Bending":
        super().posed(pose)
        if pose == self.pose:
            return self
        other = copy.copy(self)
        other.pose = int(pose)
        other.__dict__.pop("_bounds", None)
        return other

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "bending",
            "geometry_version": self.geometry_version,
            "bends": [list(pair) for pair in self.bends],
            "bend": list(self.bends[self.pose]),
        }

    def description(self) -> dict[str, Any]:
        plate = block((-1.3, -0.06, -1.2), (1.3, 0.0, 1.2), without=("bottom",))
        wall = block((-1.3, 0.0, -1.2), (-1.22, 1.6, 0.9), without=("bottom",))
        return {
            "plate": to_mesh("plate", plate, twosided(diffuse((0.62, 0.60, 0.56)))),
            "wall": to_mesh("wall", wall, twosided(diffuse((0.63, 0.10, 0.06)))),
            "column": to_mesh(
                "column", column(*self.bends[self.pose]), twosided(diffuse((0.66, 0.62, 0.55)))
            ),
        }


def column(angle: float, side: float) -> MeshData:
    """The column bent by ``angle`` degrees to ``side`` (see :func:`~prt.scene.deform.bend`)."""
    straight = twisted_column_mesh(RADIUS, HEIGHT, lobes=5, depth=0.28, turns=0.4)
    return deformed(straight, bend(angle, side, HEIGHT))

"""A furnished room, open at the front and the top, with a wall mirror whose roughness is a setting."""

from collections.abc import Sequence
from typing import Any, Literal

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import (
    diffuse,
    glossy,
    glossy_plastic,
    rough_metal,
    superquadric_mesh,
    to_mesh,
    torus_mesh,
    twosided,
    unit_setting,
    vase_mesh,
)

#: roughness below which the mirror is perfectly smooth
SMOOTHEST = 0.001


class MirrorRoom(Scene):
    """A room 3.2 units wide, 2.4 deep and 1.8 high: mirror on the back wall, table, chest, lamp stand, ball.

    Args:
        mirror_roughness: sigma = sqrt(GGX alpha), 0.01 to 1; anything below 0.001 means a smooth mirror.
        floor_roughness: sigma of the floor's glossy varnish.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "mirror_room",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        mirror_roughness: float = 0.15,
        floor_roughness: float = 0.45,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.mirror_roughness = unit_setting("mirror_roughness", mirror_roughness)
        if SMOOTHEST <= self.mirror_roughness < 0.01:
            raise PrtError(
                f"scene.mirror_roughness={mirror_roughness!r} must lie between 0.01 and 1; "
                "set it to 0 for a smooth mirror"
            )
        self.floor_roughness = unit_setting("floor_roughness", floor_roughness, 0.05)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "mirror_room",
            "geometry_version": self.geometry_version,
            "mirror_roughness": self.mirror_roughness,
            "floor_roughness": self.floor_roughness,
        }

    def description(self) -> dict[str, Any]:
        transform = mitsuba().ScalarTransform4f
        wood, oak = diffuse((0.30, 0.17, 0.08)), glossy((0.42, 0.25, 0.12), 0.4, 0.6)

        def plane(
            at: Sequence[float],
            axis: Sequence[float],
            angle: float,
            half: Sequence[float],
            bsdf: dict[str, Any],
        ) -> dict[str, Any]:
            to_world = transform().translate(list(at)).rotate(list(axis), angle).scale([*half, 1])
            return {"type": "rectangle", "to_world": to_world, "bsdf": twosided(bsdf)}

        def block(
            at: Sequence[float], half: Sequence[float], bsdf: dict[str, Any], turn: float = 0.0
        ) -> dict[str, Any]:
            to_world = transform().translate(list(at)).rotate([0, 1, 0], turn).scale(list(half))
            return {"type": "cube", "to_world": to_world, "bsdf": twosided(bsdf)}

        content: dict[str, Any] = {
            "floor": plane(
                (0, 0, 0), (1, 0, 0), -90, (1.6, 1.2), glossy((0.33, 0.22, 0.14), self.floor_roughness, 0.8)
            ),
            "back": plane((0, 0.9, -1.2), (0, 1, 0), 0, (1.6, 0.9), diffuse((0.62, 0.62, 0.58))),
            # the side walls end before the floor does, so that slanted views look in past them
            "left": plane((-1.6, 0.9, -0.35), (0, 1, 0), 90, (0.85, 0.9), diffuse((0.16, 0.30, 0.42))),
            "right": plane((1.6, 0.9, -0.35), (0, 1, 0), -90, (0.85, 0.9), diffuse((0.60, 0.42, 0.16))),
            "mirror": plane(
                (0.1, 0.95, -1.17), (0, 1, 0), 0, (1.0, 0.62), rough_metal("Ag", self.mirror_roughness)
            ),
            "rug": plane((0.05, 0.004, 0.25), (1, 0, 0), -90, (0.95, 0.6), diffuse((0.45, 0.08, 0.10))),
            "chest": block((-1.25, 0.3, -0.55), (0.28, 0.3, 0.4), oak),
            "ball": {
                "type": "sphere",
                "center": [-1.2, 0.78, -0.5],
                "radius": 0.18,
                "bsdf": twosided(glossy_plastic((0.75, 0.30, 0.04), 0.25)),
            },
            "pouf": to_mesh(
                "pouf",
                superquadric_mesh(0.27, 0.9, 0.45).on_ground().moved(turn=15.0, to=(-0.55, 0.004, 0.55)),
                twosided(diffuse((0.10, 0.45, 0.40))),
            ),
            "vase": to_mesh(
                "vase",
                vase_mesh(0.13, 0.42).moved(to=(0.62, 0.5, -0.2)),
                twosided(glossy((0.55, 0.06, 0.30), 0.3, 0.7)),
            ),
            "knot": to_mesh(
                "knot",
                torus_mesh(0.11, 0.045, 64, 24).on_ground().moved(to=(0.25, 0.5, -0.05)),
                twosided(rough_metal("Au", 0.35)),
            ),
            "table": block((0.45, 0.475, -0.15), (0.45, 0.025, 0.3), oak),
        }
        for number, (x, z) in enumerate(((0.06, -0.39), (0.84, -0.39), (0.06, 0.09), (0.84, 0.09))):
            content[f"leg_{number}"] = block((x, 0.225, z), (0.025, 0.225, 0.025), wood)
        for side, (at, half) in {
            "top": ((0.1, 1.6, -1.17), (1.06, 0.03, 0.03)),
            "bottom": ((0.1, 0.3, -1.17), (1.06, 0.03, 0.03)),
            "west": ((-0.93, 0.95, -1.17), (0.03, 0.62, 0.03)),
            "east": ((1.13, 0.95, -1.17), (0.03, 0.62, 0.03)),
        }.items():
            content[f"frame_{side}"] = block(at, half, wood)
        return content

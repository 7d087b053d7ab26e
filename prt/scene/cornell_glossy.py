"""A Cornell box open at the front and the top, with a glossy floor and a rough-metal sphere."""

from collections.abc import Sequence
from typing import Any, Literal

from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import diffuse, glossy, rough_metal, twosided, unit_setting


class CornellGlossy(Scene):
    """Floor, back wall and two coloured walls about 2 units wide; light enters from +z and from above.

    Args:
        floor_roughness, sphere_roughness, box_roughness: sigma = sqrt(GGX alpha).
        floor_specular, floor_metallic: specular level and metallic share of the floor's principled BSDF.
        sphere_metal: Au, Ag, Cu or Al.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "cornell_glossy",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        floor_roughness: float = 0.25,
        floor_specular: float = 1.0,
        floor_metallic: float = 0.35,
        sphere_roughness: float = 0.3,
        sphere_metal: str = "Ag",
        box_roughness: float = 0.4,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.floor_roughness = unit_setting("floor_roughness", floor_roughness, 0.05)
        self.floor_specular = unit_setting("floor_specular", floor_specular)
        self.floor_metallic = unit_setting("floor_metallic", floor_metallic)
        self.sphere_roughness = unit_setting("sphere_roughness", sphere_roughness, 0.0)
        self.sphere_metal = sphere_metal
        self.box_roughness = unit_setting("box_roughness", box_roughness, 0.05)
        rough_metal(sphere_metal, self.sphere_roughness)  # an unknown metal is refused now, not at rendering

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "cornell_glossy",
            "geometry_version": self.geometry_version,
            "floor_roughness": self.floor_roughness,
            "floor_specular": self.floor_specular,
            "floor_metallic": self.floor_metallic,
            "sphere_roughness": self.sphere_roughness,
            "sphere_metal": self.sphere_metal,
            "box_roughness": self.box_roughness,
        }

    def description(self) -> dict[str, Any]:
        transform = mitsuba().ScalarTransform4f

        def wall(
            at: Sequence[float],
            axis: Sequence[float],
            angle: float,
            half: Sequence[float],
            bsdf: dict[str, Any],
        ) -> dict[str, Any]:
            to_world = transform().translate(list(at)).rotate(list(axis), angle).scale([*half, 1])
            return {"type": "rectangle", "to_world": to_world, "bsdf": twosided(bsdf)}

        return {
            "floor": wall(
                (0, 0, 0),
                (1, 0, 0),
                -90,
                (1, 1),
                glossy((0.36, 0.34, 0.31), self.floor_roughness, self.floor_specular, self.floor_metallic),
            ),
            "back": wall((0, 1, -1), (0, 1, 0), 0, (1, 1), diffuse((0.72, 0.70, 0.66))),
            # the side walls end before the floor does, so that slanted views look in past them
            "left": wall((-1, 1, -0.25), (0, 1, 0), 90, (0.75, 1), diffuse((0.63, 0.065, 0.05))),
            "right": wall((1, 1, -0.25), (0, 1, 0), -90, (0.75, 1), diffuse((0.14, 0.45, 0.091))),
            "sphere": {
                "type": "sphere",
                "center": [-0.42, 0.42, -0.25],
                "radius": 0.42,
                "bsdf": twosided(rough_metal(self.sphere_metal, self.sphere_roughness)),
            },
            "box": {
                "type": "cube",
                "to_world": transform()
                .translate([0.45, 0.5, -0.4])
                .rotate([0, 1, 0], -20)
                .scale([0.28, 0.5, 0.28]),
                "bsdf": twosided(glossy((0.75, 0.55, 0.25), self.box_roughness, 0.7)),
            },
            "ball": {
                "type": "sphere",
                "center": [0.2, 0.18, 0.42],
                "radius": 0.18,
                "bsdf": twosided(glossy((0.12, 0.25, 0.6), self.box_roughness, 0.7)),
            },
        }

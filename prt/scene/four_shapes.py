"""Four curved shapes of different materials round a metal ring that casts a caustic on a glossy ground.

The procedural counterpart of Raghavan 2023's FOUR ANIMALS: it needs no data.
"""

from typing import Any, Literal

from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import (
    diffuse,
    glossy,
    glossy_plastic,
    ground_description,
    ring_description,
    rough_metal,
    superquadric_mesh,
    to_mesh,
    torus_mesh,
    twisted_column_mesh,
    twosided,
    unit_setting,
    vase_mesh,
)


class FourShapes(Scene):
    """A twisted column, a vase, a rounded box and a torus about a ring, all within 2 units of the origin.

    Args:
        ground_roughness, ring_roughness, column_roughness, box_roughness: sigma = sqrt(GGX alpha).
        ring_metal, column_metal: Au, Ag, Cu or Al.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "four_shapes",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        ground_roughness: float = 0.3,
        ring_roughness: float = 0.32,
        ring_metal: str = "Au",
        column_roughness: float = 0.4,
        column_metal: str = "Cu",
        box_roughness: float = 0.3,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.ground_roughness = unit_setting("ground_roughness", ground_roughness, 0.05)
        self.ring_roughness = unit_setting("ring_roughness", ring_roughness)
        self.column_roughness = unit_setting("column_roughness", column_roughness)
        self.box_roughness = unit_setting("box_roughness", box_roughness, 0.05)
        self.ring_metal, self.column_metal = ring_metal, column_metal
        for metal in (ring_metal, column_metal):
            rough_metal(metal, 0.5)  # an unknown metal is refused now, not at rendering

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "four_shapes",
            "geometry_version": self.geometry_version,
            "ground_roughness": self.ground_roughness,
            "ring_roughness": self.ring_roughness,
            "ring_metal": self.ring_metal,
            "column_roughness": self.column_roughness,
            "column_metal": self.column_metal,
            "box_roughness": self.box_roughness,
        }

    def description(self) -> dict[str, Any]:
        column = twisted_column_mesh(0.36, 1.25)
        vase = vase_mesh(0.4, 1.05)
        box = superquadric_mesh(0.4, 0.35, 0.35).on_ground()
        torus = torus_mesh(0.36, 0.17).on_ground()
        return {
            "ground": ground_description(roughness=self.ground_roughness),
            "ring": ring_description(
                center=(0.0, 0.0, 0.0), roughness=self.ring_roughness, metal=self.ring_metal
            ),
            "column": to_mesh(
                "column",
                column.moved(turn=20.0, to=(-0.85, 0.0, -0.75)),
                twosided(rough_metal(self.column_metal, self.column_roughness)),
            ),
            "vase": to_mesh(
                "vase", vase.moved(to=(0.9, 0.0, -0.7)), twosided(glossy_plastic((0.08, 0.25, 0.55), 0.3))
            ),
            "box": to_mesh(
                "box",
                box.moved(turn=30.0, to=(-0.9, 0.0, 0.8)),
                twosided(glossy((0.6, 0.1, 0.07), self.box_roughness, 0.6)),
            ),
            "torus": to_mesh("torus", torus.moved(to=(0.85, 0.0, 0.85)), twosided(diffuse((0.55, 0.6, 0.3)))),
        }

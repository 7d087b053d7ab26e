"""An armadillo with a cube before a wall on a glossy ground, after the ARMADILLO scene of Raghavan 2023."""

from typing import Any, Literal

from prt.paths import data_file
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import diffuse, glossy, ground_description, twosided, unit_setting
from prt.scene.standing_mesh import standing_mesh


class Armadillo(Scene):
    """A mostly diffuse scene: colour bleeds onto the walls, the ground reflects the claws.

    Args:
        ground_roughness, armadillo_roughness: sigma = sqrt(GGX alpha).
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range, or where the mesh is missing (when it is first needed).
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "armadillo",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        ground_roughness: float = 0.35,
        armadillo_roughness: float = 0.5,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.ground_roughness = unit_setting("ground_roughness", ground_roughness, 0.05)
        self.armadillo_roughness = unit_setting("armadillo_roughness", armadillo_roughness, 0.05)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "armadillo",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file("meshes/armadillo.ply")),
            "ground_roughness": self.ground_roughness,
            "armadillo_roughness": self.armadillo_roughness,
        }

    def description(self) -> dict[str, Any]:
        transform = mitsuba().ScalarTransform4f
        skin = twosided(glossy((0.25, 0.40, 0.16), self.armadillo_roughness))
        return {
            "ground": ground_description(size=8.0, roughness=self.ground_roughness),
            "wall": {
                "type": "cube",
                "to_world": transform().translate([0.0, 1.1, -1.3]).scale([2.2, 1.1, 0.08]),
                "bsdf": twosided(diffuse((0.70, 0.68, 0.63))),
            },
            "side_wall": {
                "type": "cube",
                "to_world": transform().translate([-1.75, 0.8, -0.3]).scale([0.08, 0.8, 0.95]),
                "bsdf": twosided(diffuse((0.62, 0.13, 0.08))),
            },
            "cube": {
                "type": "cube",
                "to_world": transform().translate([0.95, 0.4, -0.45]).rotate([0, 1, 0], 28).scale(0.4),
                "bsdf": twosided(diffuse((0.15, 0.30, 0.62))),
            },
            "armadillo": standing_mesh(data_file("meshes/armadillo.ply"), 1.5, (-0.25, -0.1), 15.0, skin),
        }

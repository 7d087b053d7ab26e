"""Four animals about a metal ring on a glossy ground, after the FOUR ANIMALS scene of Raghavan 2023."""

from typing import Any, Literal

from prt.paths import data_file
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import (
    diffuse,
    glossy,
    ground_description,
    ring_description,
    rough_metal,
    twosided,
    unit_setting,
)
from prt.scene.standing_mesh import standing_mesh


class FourAnimals(Scene):
    """Lion, elephant, horse and camel head from ``PRT_DATA/meshes``, each about one unit tall.

    Args:
        ground_roughness, ring_roughness, metal_roughness, gloss_roughness: sigma = sqrt(GGX alpha) of the
            ground, the ring, the copper horse and the coated elephant and lion.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range, or where the meshes are missing (when they are first needed).
    """

    geometry_version = 1
    MESHES = ("lion", "elephant", "horse", "camelhead")

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "four_animals",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        ground_roughness: float = 0.3,
        ring_roughness: float = 0.3,
        metal_roughness: float = 0.4,
        gloss_roughness: float = 0.3,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.ground_roughness = unit_setting("ground_roughness", ground_roughness, 0.05)
        self.ring_roughness = unit_setting("ring_roughness", ring_roughness)
        self.metal_roughness = unit_setting("metal_roughness", metal_roughness)
        self.gloss_roughness = unit_setting("gloss_roughness", gloss_roughness, 0.05)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "four_animals",
            "geometry_version": self.geometry_version,
            "meshes": [file_digest(data_file(f"meshes/{name}.ply")) for name in self.MESHES],
            "ground_roughness": self.ground_roughness,
            "ring_roughness": self.ring_roughness,
            "metal_roughness": self.metal_roughness,
            "gloss_roughness": self.gloss_roughness,
        }

    def description(self) -> dict[str, Any]:
        lion, elephant, horse, camel = (data_file(f"meshes/{name}.ply") for name in self.MESHES)
        gold_brown, grey_blue, sand = (0.50, 0.27, 0.09), (0.22, 0.30, 0.42), (0.62, 0.42, 0.27)
        # The lion is a head, open at the neck: it leans back and stands a little way into the ground.
        return {
            "ground": ground_description(size=9.0, roughness=self.ground_roughness),
            "ring": ring_description(radius=0.5, roughness=self.ring_roughness),
            "lion": standing_mesh(
                lion,
                0.9,
                (-1.05, 0.45),
                150.0,
                twosided(glossy(gold_brown, self.gloss_roughness)),
                tilt=50.0,
                sink=0.05,
            ),
            "elephant": standing_mesh(
                elephant, 1.1, (-0.7, -0.95), 20.0, twosided(glossy(grey_blue, self.gloss_roughness, 0.8))
            ),
            "horse": standing_mesh(
                horse, 1.1, (0.85, -0.85), -25.0, twosided(rough_metal("Cu", self.metal_roughness))
            ),
            "camel": standing_mesh(camel, 0.7, (1.0, 0.55), -60.0, twosided(diffuse(sand))),
        }

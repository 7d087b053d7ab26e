"""The bust of Nefertiti, opaque and diffuse, on a plinth, in the place of a head with hair."""

from typing import Any, Literal

from prt.paths import data_file
from prt.scene.panels import block
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import diffuse, to_mesh, twosided, unit_setting
from prt.scene.standing_mesh import standing_mesh


class Head(Scene):
    """A bust 1.5 units tall on a plinth whose top is at y = 0; stands in for the ROZA of Dhawal 2022.

    The mesh is closed. It stands a little way in the plinth: scans do not end in a plane.

    Args:
        albedo: of the bust, in [0, 0.95].
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range, or where the mesh is missing (when it is first needed).
    """

    geometry_version = 1
    MESH = "meshes/nefertiti.ply"

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "head",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        albedo: float = 0.75,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.albedo = unit_setting("albedo", albedo, 0.0, 0.95)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "head",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file(self.MESH)),
            "albedo": self.albedo,
        }

    def description(self) -> dict[str, Any]:
        clay = twosided(diffuse([self.albedo * part for part in (1.0, 0.82, 0.66)]))
        # the file's up axis is +z
        bust = standing_mesh(data_file(self.MESH), 1.5, (0.0, 0.0), 0.0, clay, tilt=-90.0, sink=0.02)
        plinth = block((-0.5, -0.14, -0.44), (0.5, 0.0, 0.5))
        return {"bust": bust, "plinth": to_mesh("plinth", plinth, twosided(diffuse((0.34, 0.37, 0.42))))}

"""A lion's head on a plinth just large enough to carry it, for light from one direction."""

from typing import Any, Literal

from prt.paths import data_file
from prt.scene.closing import capped, mesh_data
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import block
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import diffuse, to_mesh, twosided, unit_setting
from prt.scene.standing_mesh import standing_mesh


class Lion(Scene):
    """One diffuse object with deep folds: its light comes from itself, its dark side shows light that leaks.

    The mesh is a head that is open at the neck; the hole is closed, so that no light gets inside.

    Args:
        albedo: of the lion, in [0, 0.95].
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range, or where the mesh is missing (when it is first needed).
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "lion",
        max_depth: int = 8,
        record: Literal["bsdf", "nee"] = "bsdf",
        albedo: float = 0.7,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.albedo = unit_setting("albedo", albedo, 0.0, 0.95)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "lion",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file("meshes/lion.ply")),
            "albedo": self.albedo,
        }

    def description(self) -> dict[str, Any]:
        path = data_file("meshes/lion.ply")
        warm = twosided(diffuse([self.albedo * part for part in (1.0, 0.84, 0.62)]))
        standing = standing_mesh(path, 1.2, (0.0, 0.0), 180.0, warm, tilt=45.0, sink=0.06)
        head = capped(mesh_data(mitsuba().load_dict(standing)), f"mesh {path}")
        plinth = block((-0.5, -0.14, -0.5), (0.5, 0.0, 0.5))
        return {
            "lion": to_mesh("lion", head, warm),
            "plinth": to_mesh("plinth", plinth, twosided(diffuse((0.6, 0.58, 0.55)))),
        }

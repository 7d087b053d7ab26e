"""A teapot with cups, saucers, a sugar bowl and spoons on a tray, after the TEASET of Dhawal 2022."""

from pathlib import Path
from typing import Any, Literal

from prt.paths import data_file
from prt.scene.closing import capped, mesh_data
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.rounded import rounded
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import MeshData, diffuse, to_mesh, twosided
from prt.scene.standing_mesh import standing_mesh
from prt.scene.tableware import biscuit_plate, cup, saucer, spoon, sugar_bowl, tea, top_at_axis, tray

#: where each cup stands (x, z), and the side its handle is on, degrees
CUPS = (((-0.88, 0.6), 200.0), ((0.02, 1.02), -60.0), ((0.98, 0.45), 20.0))
#: where each spoon begins (x, z), and how it is turned, degrees
SPOONS = (((-0.33, 0.72), -112.0), ((0.46, 0.62), -52.0))
BISCUITS = (0.16, 0.0, -1.2)
PORCELAIN, METAL = (0.74, 0.72, 0.68), (0.5, 0.5, 0.52)


class Teaset(Scene):
    """The teapot is read from ``PRT_DATA/meshes``, everything else is procedural; the tray's top is at y = 0.

    All solids are closed. Shadows are hard where things touch and soft under the spout and the handles.

    Args:
        as in :class:`Scene`.

    Raises:
        PrtError: where the mesh is missing (when it is first needed).
    """

    geometry_version = 1
    MESH = "meshes/teapot.ply"
    TALL, AT, TURN = 0.84, (-0.2, -0.42), -28.0

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "teaset",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
    ):
        super().__init__(name, cameras, max_depth, record)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "teaset",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file(self.MESH)),
        }

    def description(self) -> dict[str, Any]:
        parts = {"teapot": (self._teapot(data_file(self.MESH)), (0.2, 0.38, 0.48)), **tableware()}
        return {name: to_mesh(name, mesh, twosided(diffuse(color))) for name, (mesh, color) in parts.items()}

    def _teapot(self, path: Path) -> MeshData:
        """The file's 2256 triangles show their corners: each becomes 16, and the openings are closed."""
        standing = standing_mesh(path, self.TALL, self.AT, self.TURN, diffuse(PORCELAIN), tilt=-90.0)
        return capped(rounded(mesh_data(mitsuba().load_dict(standing)), levels=2), f"mesh {path}")


def tableware() -> dict[str, tuple[MeshData, tuple[float, float, float]]]:
    """All but the teapot: geometry, world units, and reflectance by name."""
    found = {"tray": (tray(1.7), (0.34, 0.2, 0.11))}
    bowl, sugar = sugar_bowl()
    at = (0.88, 0.0, -0.68)
    found["sugar_bowl"] = (bowl.moved(turn=50.0, to=at), (0.2, 0.38, 0.48))
    found["sugar"] = (sugar.moved(to=at), (0.86, 0.85, 0.82))
    flat, biscuits = biscuit_plate()
    found["plate"] = (flat.moved(to=BISCUITS), PORCELAIN)
    found["biscuits"] = (biscuits.moved(to=BISCUITS), (0.62, 0.4, 0.2))
    plate = saucer()
    well = top_at_axis(plate)
    for i, ((x, z), turn) in enumerate(CUPS):
        found[f"saucer_{i}"] = (plate.moved(to=(x, 0.0, z)), PORCELAIN)
        found[f"cup_{i}"] = (cup().moved(turn=turn, to=(x, well, z)), PORCELAIN)
        found[f"tea_{i}"] = (tea().moved(to=(x, well, z)), (0.3, 0.12, 0.04))
    for i, ((x, z), turn) in enumerate(SPOONS):
        found[f"spoon_{i}"] = (spoon().moved(turn=turn, to=(x, 0.0, z)), METAL)
    return found

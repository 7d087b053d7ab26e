"""An elephant in an open niche under a cloth: outside light gets in and bounces from coloured walls."""

from typing import Any, Literal

import numpy as np

from prt.paths import data_file
from prt.scene.deform import deformed
from prt.scene.panels import block
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import MeshData, diffuse, superquadric_mesh, to_mesh, twosided, unit_setting
from prt.scene.standing_mesh import standing_mesh


class Alcove(Scene):
    """Floor, back wall, a red wall on the left and a blue cloth above; stands in for Belcour's Viking scene.

    Open to the front and to the right.

    Args:
        elephant_albedo: of the elephant, in [0, 0.95].
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range, or where the mesh is missing (when it is first needed).
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "alcove",
        max_depth: int = 8,
        record: Literal["bsdf", "nee"] = "bsdf",
        elephant_albedo: float = 0.6,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.elephant_albedo = unit_setting("elephant_albedo", elephant_albedo, 0.0, 0.95)

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "alcove",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file("meshes/elephant.ply")),
            "elephant_albedo": self.elephant_albedo,
        }

    def description(self) -> dict[str, Any]:
        elephant = data_file("meshes/elephant.ply")
        skin = tuple(self.elephant_albedo * part for part in (1.0, 0.94, 0.86))
        # sides that no camera sees are left out: they would take texels from those that are
        parts = {
            "floor": (
                block((-1.1, -0.08, -0.9), (1.2, 0.0, 1.0), without=("bottom", "left", "back")),
                (0.62, 0.58, 0.50),
            ),
            "back": (
                block((-1.1, 0.0, -0.98), (1.2, 1.95, -0.9), without=("bottom", "left", "back")),
                (0.70, 0.68, 0.63),
            ),
            "side": (
                block((-1.18, 0.0, -0.9), (-1.1, 1.75, 0.8), without=("bottom", "left", "back")),
                (0.63, 0.10, 0.06),
            ),
            "cloth": (_cloth(), (0.10, 0.28, 0.62)),
        }
        return {
            **{name: to_mesh(name, mesh, twosided(diffuse(color))) for name, (mesh, color) in parts.items()},
            "elephant": standing_mesh(elephant, 1.5, (-0.05, -0.05), 18.0, twosided(diffuse(skin))),
        }


def _cloth() -> MeshData:
    """A closed rounded sheet over the rear half of the niche, in folds that hang lower to the front."""
    half, at = np.array([1.13, 0.035, 0.62]), np.array([0.02, 1.88, -0.36])

    def hang(position: np.ndarray) -> np.ndarray:
        x, y, z = (half * position + at).T
        front = (z - at[2]) / half[2]
        return np.stack(
            [x, y + 0.05 * np.cos(2.2 * np.pi * x) * (0.6 + 0.4 * front) - 0.06 * front, z], axis=1
        )

    return deformed(superquadric_mesh(1.0, 0.25, 0.5, columns=96, rows=32), hang)

"""A closed mesh filled with a thick medium: light enters, scatters many times and leaves elsewhere."""

from collections.abc import Sequence
from typing import Any, Literal

from prt.errors import PrtError
from prt.paths import data_file
from prt.scene.closing import mesh_data, open_edges
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.shapes import rgb, unit_setting
from prt.scene.standing_mesh import standing_mesh


class TranslucentMesh(Scene):
    """One mesh with an index-matched boundary (BSDF ``null``) and a homogeneous medium inside.

    Args:
        mesh: a PLY or OBJ file below ``PRT_DATA``; closed.
        height: once it stands, world units.
        turn, tilt: degrees, as in :func:`~prt.scene.standing_mesh.standing_mesh`.
        mean_free_path: mean distance between two scattering events, as a share of the height.
        albedo: share of the light that a scattering event keeps, linear RGB, each in [0, 1).
        anisotropy: mean cosine g of the Henyey-Greenstein phase function, in [-0.9, 0.9]; 0 is isotropic.
        max_depth: scattering events that are traced; light in a thick medium takes tens of them.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range; where the mesh is missing or not closed (when it is first
            needed).
    """

    geometry_version = 1
    medium = "volume"

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "nefertiti",
        max_depth: int = 48,
        record: Literal["bsdf", "nee"] = "bsdf",
        mesh: str = "meshes/nefertiti.ply",
        height: float = 1.6,
        turn: float = 0.0,
        tilt: float = 0.0,
        mean_free_path: float = 0.03,
        albedo: Sequence[float] = (0.98, 0.95, 0.9),
        anisotropy: float = 0.0,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.mesh = str(mesh)
        self.height = unit_setting("height", height, 0.01, 100.0)
        self.turn = unit_setting("turn", turn, -360.0, 360.0)
        self.tilt = unit_setting("tilt", tilt, -360.0, 360.0)
        self.mean_free_path = unit_setting("mean_free_path", mean_free_path, 0.001, 10.0)
        if isinstance(albedo, str) or not isinstance(albedo, Sequence) or len(albedo) != 3:
            raise PrtError(f"scene.albedo={albedo!r} must be a list of 3 numbers between 0 and 0.9999")
        self.albedo = [unit_setting("albedo", part, 0.0, 0.9999) for part in albedo]
        self.anisotropy = unit_setting("anisotropy", anisotropy, -0.9, 0.9)
        self._closed = False

    def fingerprint(self) -> dict[str, Any]:
        return {
            "scene": "translucent_mesh",
            "geometry_version": self.geometry_version,
            "mesh": file_digest(data_file(self.mesh)),
            "height": self.height,
            "turn": self.turn,
            "tilt": self.tilt,
            "mean_free_path": self.mean_free_path,
            "albedo": self.albedo,
            "anisotropy": self.anisotropy,
        }

    def description(self) -> dict[str, Any]:
        path = data_file(self.mesh)
        shape = standing_mesh(path, self.height, (0.0, 0.0), self.turn, {"type": "null"}, self.tilt)
        if not self._closed:
            holes = len(open_edges(mesh_data(mitsuba().load_dict(shape))))
            if holes:
                raise PrtError(f"mesh {path} has {holes} open edges; a medium needs a closed one, close it")
            self._closed = True
        phase = {"type": "hg", "g": self.anisotropy} if self.anisotropy else {"type": "isotropic"}
        medium = {
            "type": "homogeneous",
            "sigma_t": 1.0 / (self.mean_free_path * self.height),
            "albedo": rgb(self.albedo),
            "phase": phase,
        }
        return {"body": {**shape, "interior": medium}}

"""The table of the dining room with its chairs and what stands on it, without the room about it."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from prt.scene.deform import deformed
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_nodes import children
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Trajectory
from prt.scene.shapes import MeshData, diffuse, lathe_mesh, to_mesh, twosided

#: shapes of the file that are left out: the room, its floor (one that is no larger than needed takes its
#: place), the lamps, whose cables would hang from nothing, and a sheet within the table top
ROOM = ("Walls_*", "FloorTiles", "SkirtWood", "Artwork", "None", "FrostedGlass_*", "BlackPaint_0001")
LAMPS = ("WhitePlastic_0001", "WhitePlastic_0002", "WhitePlastic_0003", "WhitePlastic_0004")
#: reflectance by the file's shape, or by its BSDF
COLORS = {
    "WhitePlasticBSDF": (0.74, 0.72, 0.68),
    "ChromeBSDF": (0.45, 0.3, 0.18),
    "BlackRubberBSDF": (0.08, 0.08, 0.08),
    "BlackPaintBSDF": (0.12, 0.13, 0.15),
    "WhiteMarbleBSDF": (0.42, 0.27, 0.15),
    "GoldBSDF": (0.62, 0.42, 0.12),
    "CeramicBSDF": (0.8, 0.79, 0.76),
    "RoughMetalBSDF": (0.5, 0.5, 0.52),
    "PaintedCeramicBSDF": (0.24, 0.36, 0.56),
}
FLOOR, PLAIN = (0.5, 0.46, 0.41), (0.5, 0.5, 0.5)
#: the file's place of the origin (under the middle of the table, where the chairs' feet end), and its unit
ORIGIN, UNIT = (-0.61, -1.4125, -1.82), 0.4


class DiningTable(MitsubaScene):
    """Table, six chairs and tableware of ``scenes/dining-room`` on an oval floor at y = 0, 3.9 units wide.

    Environments light it from all sides. Materials are diffuse, one colour for each of the file's.

    Args:
        path: the scene's file, as in :class:`MitsubaScene`.
        others: as in :class:`Scene`.

    Raises:
        PrtError: where the file or one of its meshes is missing, or it is another scene (when it is first
            needed).
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "dining_table",
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
        path: str = "scenes/dining-room/scene.xml",
    ):
        super().__init__(name, path, cameras, max_depth, record, open=(*ROOM, *LAMPS))

    def fingerprint(self) -> dict[str, Any]:
        return {**super().fingerprint(), "scene": "dining_table", "geometry_version": self.geometry_version}

    def description(self) -> dict[str, Any]:
        """A shape for each one of the file's, in the order of their names: merged ones come in any order."""
        mi = mitsuba()
        state = self._parse()
        self._strip(state)
        self._files(state)
        place = mi.ScalarTransform4f().scale(UNIT).translate([-v for v in ORIGIN])
        found = {}
        for _, index in children(state.root):
            node = state.nodes[index]
            if node.type != mi.ObjectType.Shape:
                continue
            name, props = node.props.id(), node.props
            bsdfs = [state.nodes[i].props.id() for _, i in children(node)]
            color = next((COLORS[key] for key in (name, *bsdfs) if key in COLORS), PLAIN)
            own = np.array(props["to_world"].matrix) if "to_world" in props else np.eye(4)
            found[name] = {
                "type": props.plugin_name(),
                "filename": props["filename"],
                "face_normals": bool(props["face_normals"]) if "face_normals" in props else False,
                "to_world": place @ mi.ScalarTransform4f(own),
                "bsdf": twosided(diffuse(color)),
            }
        floor = to_mesh("floor", _floor((1.95, 1.45), 0.06), twosided(diffuse(FLOOR)))
        return {"floor": floor, **dict(sorted(found.items()))}


def _floor(half_extents: Sequence[float], thickness: float) -> MeshData:
    """An oval slab with rounded edges, its top at y = 0, world units."""
    profile = [(0, 0), (0.7, 0), (0.97, 0), (0.99, 0.1), (1, 0.5), (0.99, 0.9), (0.97, 1), (0.7, 1), (0, 1)]
    wide, deep = half_extents
    slab = lathe_mesh(profile, 1.0, thickness, columns=120, rows=32).moved(to=(0.0, -thickness, 0.0))
    return deformed(slab, lambda position: position * np.array([wide, 1.0, deep]))

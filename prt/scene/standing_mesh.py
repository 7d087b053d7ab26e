"""A triangle mesh from a file, scaled to a height and stood on the ground."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba

PLUGINS = {".ply": "ply", ".obj": "obj"}


def standing_mesh(
    path: Path,
    height: float,
    at: Sequence[float],
    turn: float,
    bsdf: dict[str, Any],
    tilt: float = 0.0,
    sink: float = 0.0,
) -> dict[str, Any]:
    """A Mitsuba shape dict of the mesh, its lowest point on y = 0, the middle of its footprint at ``at``.

    Vertex normals that the file lacks are computed when Mitsuba loads it.

    Args:
        path: a PLY or OBJ file whose up axis is +y.
        height: of the mesh once it stands, world units.
        at: x and z of the middle of its bounding box.
        turn: about +y, degrees, after ``tilt``.
        tilt: about +x, degrees, before it is measured and set down.
        sink: share of the height that stands below the ground (closes the open neck of a bust).

    Raises:
        PrtError: for another file type, or a mesh without vertices or with no finite extent.
    """
    mi = mitsuba()
    plugin = PLUGINS.get(path.suffix.lower())
    if plugin is None:
        raise PrtError(f"mesh {path} is not one of {', '.join(PLUGINS)}; convert it")
    try:
        params = mi.traverse(mi.load_dict({"type": plugin, "filename": str(path)}))
        vertices = np.array(params["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    except Exception as error:
        raise PrtError(
            f"cannot read mesh {path}: {' '.join(str(error).split())}; restore the file"
        ) from error
    transform = mi.ScalarTransform4f
    rotation = transform().rotate([0, 1, 0], turn) @ transform().rotate([1, 0, 0], tilt)
    turned = vertices @ np.array(rotation.matrix, dtype=np.float64)[:3, :3].T
    low, high = (turned.min(0), turned.max(0)) if len(turned) else (np.zeros(3), np.zeros(3))
    tall = high[1] - low[1]
    if not np.isfinite(tall) or tall <= 0.0:
        raise PrtError(f"mesh {path} has {len(vertices)} vertices and no height; replace the file")
    scale = height / tall
    middle = (low + high) / 2
    move = [at[0] - scale * middle[0], -scale * low[1] - sink * height, at[1] - scale * middle[2]]
    to_world = transform().translate([float(v) for v in move]).scale(float(scale)) @ rotation
    return {"type": plugin, "filename": str(path), "to_world": to_world, "bsdf": bsdf}

"""Flat panels and blocks as triangle meshes whose corners are exact, so that what meets leaves no crack."""

from collections.abc import Collection, Sequence

import numpy as np

from prt.scene.shapes import MeshData

#: outward normal of each side of a block, and the two edges that span it, counter-clockwise from outside
SIDES = {
    "right": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "left": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "top": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
    "bottom": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "front": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "back": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
}


def panel(corner: Sequence[float], along: Sequence[float], up: Sequence[float]) -> MeshData:
    """A parallelogram of two triangles that faces ``along x up``.

    Args:
        corner: where it begins, world units.
        along, up: its edges from there, world units.
    """
    start, first, second = (np.asarray(v, dtype=np.float64) for v in (corner, along, up))
    normal = np.cross(first, second)
    return MeshData(
        position=np.stack([start, start + first, start + first + second, start + second]),
        normal=np.tile(normal / np.linalg.norm(normal), (4, 1)),
        uv=np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),
        face=np.array([[0, 1, 2], [0, 2, 3]]),
    )


def block(low: Sequence[float], high: Sequence[float], without: Collection[str] = ()) -> MeshData:
    """A box with flat outward normals, its sides side by side in texture space.

    Args:
        low, high: opposite corners, world units.
        without: sides left out (right, left, top, bottom, front, back): those that no one can see would
            only take up room in a lightmap.
    """
    near, far = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    middle, half = (near + far) / 2, (far - near) / 2
    found = []
    for place, (side, (normal, along, up)) in enumerate(SIDES.items()):
        if side in without:
            continue
        n, a, b = (np.asarray(v, dtype=np.float64) * half for v in (normal, along, up))
        part = panel(middle + n - a - b, 2 * a, 2 * b)
        # the corners themselves, not sums that round differently from side to side
        exact = np.where(part.position < middle, near, far)
        cell = np.array([place % 3, place // 3])
        uv = (part.uv + cell) / np.array([3.0, 2.0])
        found.append(MeshData(exact, part.normal, uv, part.face))
    return joined(found)


def joined(meshes: Sequence[MeshData]) -> MeshData:
    """Several meshes as one, in this order; no vertices are shared between them."""
    first = np.cumsum([0, *(len(mesh.position) for mesh in meshes)])
    return MeshData(
        position=np.concatenate([mesh.position for mesh in meshes]),
        normal=np.concatenate([mesh.normal for mesh in meshes]),
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        face=np.concatenate([mesh.face + start for mesh, start in zip(meshes, first, strict=False)]),
    )

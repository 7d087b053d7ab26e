"""Whether a triangle mesh is closed, and lids for the holes of one that is not."""

from typing import Any

import numpy as np
from jaxtyping import Int

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import joined
from prt.scene.shapes import MeshData


def mesh_data(shape: Any) -> MeshData:
    """Vertices and faces of a ``mi.Mesh`` with vertex normals, world units; uv is 0 where it has none."""
    params = mitsuba().traverse(shape)

    def rows(key: str, columns: int) -> np.ndarray:
        return np.array(params[key]).reshape(-1, columns)

    position = rows("vertex_positions", 3).astype(np.float64)
    return MeshData(
        position=position,
        normal=rows("vertex_normals", 3).astype(np.float64),
        uv=rows("vertex_texcoords", 2).astype(np.float64)
        if shape.has_vertex_texcoords()
        else np.zeros((len(position), 2)),
        face=rows("faces", 3).astype(np.int64),
    )


def open_edges(data: MeshData) -> Int[np.ndarray, "E 2"]:
    """Edges of one face only, in that face's direction, as vertex indices; vertices at one place are one.

    An edge that two faces run through in the same direction, or that more than two share, counts as open
    too: such a mesh encloses nothing.
    """
    _, first, weld = np.unique(data.position, axis=0, return_index=True, return_inverse=True)
    face = weld.reshape(-1)[data.face]
    edges = np.concatenate([face[:, [0, 1]], face[:, [1, 2]], face[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    count = len(first)
    key, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    known, often = np.unique(key, return_counts=True)
    lone = ~np.isin(back, known) | (often[np.searchsorted(known, key)] > 1)
    return first[edges[lone]]


def capped(data: MeshData, what: str = "mesh") -> MeshData:
    """The mesh with a flat-shaded fan over each hole, so that it encloses a volume.

    Args:
        data: faces wound counter-clockwise seen from outside; no edge shared by more than two faces.
        what: the name of the mesh, for the error.

    Raises:
        PrtError: if the rims of the holes are no simple loops.
    """
    edges = open_edges(data)
    following = {int(a): int(b) for a, b in edges}
    if len(following) != len(edges) or set(following) != set(following.values()):
        raise PrtError(f"{what}: its {len(edges)} open edges form no simple loops; close its holes by hand")
    lids = []
    while following:
        start, after = following.popitem()
        loop = [start, after]
        while loop[-1] != start:
            loop.append(following.pop(loop[-1]))
        # against the rim's own direction: neighbours run through a shared edge in opposite ones
        rim = data.position[loop[:0:-1]]
        centre = rim.mean(axis=0)
        normal = np.cross(rim - centre, np.roll(rim, -1, axis=0) - centre).sum(axis=0)
        around = np.arange(len(rim))
        lids.append(
            MeshData(
                position=np.concatenate([rim, centre[None]]),
                normal=np.tile(normal / np.linalg.norm(normal), (len(rim) + 1, 1)),
                uv=np.zeros((len(rim) + 1, 2)),
                face=np.stack([around, np.roll(around, -1), np.full(len(rim), len(rim))], axis=1),
            )
        )
    return joined([data, *lids])

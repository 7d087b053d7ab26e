"""A coarse smooth mesh with more triangles that follow its vertex normals."""

import numpy as np

from prt.scene.shapes import MeshData

#: how far new vertices move from the flat triangle to the curved one (Boubekeur and Alexa 2008 advise 3/4)
SHARE = 0.75


def rounded(data: MeshData, levels: int = 1) -> MeshData:
    """Each triangle split into four, ``levels`` times, its new vertices moved out by Phong tessellation.

    A new vertex depends on the two ends of its edge only, so what was closed stays closed; vertices keep
    their places. Texture coordinates are the means of the ends'.

    Args:
        data: with smooth vertex normals and one vertex per place (edges that are meant to be sharp open up).
    """
    for _ in range(levels):
        data = _split(data)
    return data


def _split(data: MeshData) -> MeshData:
    face, count = data.face, len(data.position)
    # the edges opposite to corners 2, 0, 1
    ends = np.sort(np.stack([face, np.roll(face, -1, axis=1)], axis=2), axis=2)
    edges, which = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    ab, bc, ca = (count + which.reshape(-1, 3)).T
    a, b, c = face.T

    p, q = data.position[edges[:, 0]], data.position[edges[:, 1]]
    m, n = data.normal[edges[:, 0]], data.normal[edges[:, 1]]
    flat = (p + q) / 2
    lift = (((p - flat) * m).sum(1, keepdims=True) * m + ((q - flat) * n).sum(1, keepdims=True) * n) / 2
    normal = m + n
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return MeshData(
        position=np.concatenate([data.position, flat + SHARE * lift]),
        normal=np.concatenate([data.normal, normal]),
        uv=np.concatenate([data.uv, data.uv[edges].mean(axis=1)]),
        face=np.concatenate(
            [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        ),
    )

"""Meshes fine enough to store something at their vertices: long edges are halved until none is left."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.lightmap_points import TriangleMesh

#: texels of the lightmap that an asset asks for and nothing here looks at
TEXELS = 64


def fine_mesh(scene: Any, longest: float, most: int, setting: str) -> TriangleMesh:
    """All triangles of a scene, world space, with no edge longer than ``longest`` (world units).

    Analytic shapes are converted (:func:`prt.scene.meshes.as_meshes`). Vertices are those of the files, not
    welded: where a file doubles them, at creases and seams of its textures, what is stored may jump.

    Args:
        most: vertices at most.
        setting: what asks for the length, for the error message.

    Raises:
        PrtError: for a scene that is not made of triangles, or that needs more vertices.
    """
    asset = scene.asset(TEXELS)
    if not hasattr(asset, "mesh"):
        raise PrtError(
            f"scene={scene.name} is not made of triangles, so nothing can be stored at its vertices; "
            "choose another scene or method"
        )
    return subdivided(asset.mesh(), longest, most, setting)


def subdivided(mesh: TriangleMesh, longest: float, most: int, setting: str = "longest") -> TriangleMesh:
    """The same surface with no edge longer than ``longest``.

    In each pass all edges that are too long get a vertex in the middle, and a triangle falls into two, three
    or four by how many of its own did. Whether an edge is halved depends on that edge alone, so neighbours
    agree and there are no T-junctions: what is interpolated is continuous. Normals are interpolated.

    Raises:
        PrtError: where that takes more than ``most`` vertices; a length that is no positive number.
    """
    if not longest > 0:
        raise PrtError(f"{setting}: edges of length {longest} at most; it must be above 0")
    position, normal, face, shape = mesh.position, mesh.normal, mesh.face, mesh.shape
    while True:
        start, end = face.flatten(), face.roll(-1, 1).flatten()  # edge k runs from corner k to k + 1
        long = (position[start] - position[end]).norm(dim=1) > longest
        if not bool(long.any()):
            return TriangleMesh(position, normal, face, shape)
        ends = torch.stack([start[long], end[long]], 1).sort(1).values
        pairs, which = torch.unique(ends, dim=0, return_inverse=True)
        if len(position) + len(pairs) > most:
            raise PrtError(
                f"{setting} asks for edges of at most {longest:.3g}, which takes more than {most} vertices; "
                "raise it, or the number of vertices that is allowed"
            )
        middle = torch.full((len(long),), -1)
        middle[long] = len(position) + which
        between = normal[pairs].sum(1)
        # of opposite normals there is no middle: either will do
        between = torch.where(between.norm(dim=1, keepdim=True) > 1e-6, between, normal[pairs[:, 0]])
        normal = torch.cat([normal, torch.nn.functional.normalize(between, dim=1)])
        position = torch.cat([position, position[pairs].mean(1)])
        face, parent = _split(position, face, middle.view(-1, 3))
        shape = shape[parent]


def _split(
    position: Float[Tensor, "V 3"], face: Int[Tensor, "F 3"], middle: Int[Tensor, "F 3"]
) -> tuple[Int[Tensor, "G 3"], Int[Tensor, "G"]]:
    """Triangles with new vertices on some edges (-1: none) as triangles, and which each is a part of."""
    halved = middle >= 0
    count = halved.sum(1)
    # turn so that a lone new vertex lies on the first edge, and a lone old edge is the last one
    turn = torch.where(count == 2, (~halved).int().argmax(1) + 1, halved.int().argmax(1)) % 3
    order = (torch.arange(3) + turn[:, None]) % 3
    (a, b, c), (ab, bc, ca) = face.gather(1, order).unbind(1), middle.gather(1, order).unbind(1)
    # of the two diagonals of what is left of a triangle with two new vertices, the shorter
    short = (position[a] - position[bc]).norm(dim=1) <= (position[ab] - position[c]).norm(dim=1)
    two = count == 2
    parts = [
        (count == 0, (a, b, c)),
        (count == 1, (a, ab, c)), (count == 1, (ab, b, c)),
        (two, (ab, b, bc)),
        (two & short, (a, ab, bc)), (two & short, (a, bc, c)),
        (two & ~short, (a, ab, c)), (two & ~short, (ab, bc, c)),
        (count == 3, (a, ab, ca)), (count == 3, (ab, b, bc)), (count == 3, (ca, bc, c)),
        (count == 3, (ab, bc, ca)),
    ]  # fmt: skip
    faces = torch.cat([torch.stack(corners, 1)[mask] for mask, corners in parts])
    return faces, torch.cat([mask.nonzero()[:, 0] for mask, _ in parts])

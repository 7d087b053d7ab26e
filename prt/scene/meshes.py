"""The shapes of a scene as triangle meshes, and as one mesh."""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.shapes import MeshData, to_mesh

#: cells along the first and second texture coordinate
CELLS = {"Rectangle": (1, 1), "Disk": (8, 64), "Sphere": (96, 48), "Cylinder": (64, 8)}


def as_meshes(shapes: list[Any]) -> list[Any]:
    """The same shapes, analytic ones as ``mi.Mesh`` with their own BSDF and interior.

    Rectangles are exact; disks, spheres and cylinders get the cells of :data:`CELLS`.

    Raises:
        PrtError: for a shape that is no surface made of triangles (curves, signed distance grids).
    """
    mi = mitsuba()
    # not is_mesh(): Mitsuba says so of its rectangle, which has no vertices to ask for
    return [shape if "vertex_positions" in mi.traverse(shape) else _mesh_of(shape) for shape in shapes]


def _mesh_of(shape: Any) -> Any:
    mi = mitsuba()
    kind = shape.class_name()
    makers = {"Rectangle": _rectangle, "Disk": _disk, "Sphere": _sphere, "Cylinder": _cylinder}
    if kind not in makers:
        raise PrtError(
            f"shape {shape.id()!r} is a {kind}, which has no lightmap here; allowed are triangle meshes, "
            f"{', '.join(name.lower() for name in makers)}, cube and hair scenes of their own"
        )
    columns, rows = CELLS[kind]
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    position, normal = makers[kind](u.ravel(), v.ravel())
    corner = np.arange(rows * (columns + 1)).reshape(rows, columns + 1)[:, :-1].ravel()
    face = np.concatenate([
        np.stack([corner, corner + 1, corner + columns + 2], 1),
        np.stack([corner, corner + columns + 2, corner + columns + 1], 1),
    ])  # fmt: skip
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=float).reshape(4, 4)
    world = position @ matrix[:3, :3].T + matrix[:3, 3]
    normal = normal @ np.linalg.inv(matrix[:3, :3])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if shape.has_flipped_normals():
        normal = -normal
    a, b, c = (world[face[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    flipped = (area * normal[face[:, 0]]).sum(1) < 0
    face[flipped] = face[flipped][:, ::-1]
    face = face[np.linalg.norm(area, axis=1) > 1e-14]
    data = MeshData(world, normal, np.stack([u.ravel(), v.ravel()], 1), face)
    mesh = to_mesh(shape.id(), data, shape.bsdf(), shape.interior_medium())
    mesh.set_id(shape.id())  # what errors call it
    return mesh


def _rectangle(u, v):
    return np.stack([2 * u - 1, 2 * v - 1, 0 * u], 1), np.tile([0.0, 0.0, 1.0], (len(u), 1))


def _disk(u, v):
    angle = 2 * math.pi * v
    return np.stack([u * np.cos(angle), u * np.sin(angle), 0 * u], 1), np.tile([0.0, 0, 1], (len(u), 1))


def _sphere(u, v):
    around, down = 2 * math.pi * u, math.pi * v
    p = np.stack([np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)], 1)
    return p, p


def _cylinder(u, v):
    around = 2 * math.pi * u
    n = np.stack([np.cos(around), np.sin(around), 0 * u], 1)
    return n + np.stack([0 * u, 0 * u, v], 1), n


def one_mesh(meshes: list[Any]) -> tuple[TriangleMesh, Float[Tensor, "F 3 2"] | None]:
    """All triangles as one mesh, and their own texture coordinates where it is a single mesh that has some.

    Raises:
        PrtError: for vertices that are not finite.
    """
    mi = mitsuba()
    positions, normals, faces, shapes, first = [], [], [], [], 0
    uv = None
    for number, mesh in enumerate(meshes):
        params = mi.traverse(mesh)
        position = torch.from_numpy(np.array(params["vertex_positions"]).reshape(-1, 3)).float()
        face = torch.from_numpy(np.array(params["faces"]).reshape(-1, 3).astype(np.int64))
        flipped = mesh.has_flipped_normals()
        if flipped:
            face = face[:, [0, 2, 1]]
        if not bool(position.isfinite().all()):
            raise PrtError(f"shape {mesh.id()!r} has vertices that are not finite; mend the mesh")
        if len(meshes) == 1 and mesh.has_vertex_texcoords():
            uv = torch.from_numpy(np.array(params["vertex_texcoords"]).reshape(-1, 2)).float()[face]
        a, b, c = (position[face[:, k]] for k in range(3))
        flat = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
        if mesh.has_vertex_normals() and not mesh.has_face_normals():
            normal = torch.from_numpy(np.array(params["vertex_normals"]).reshape(-1, 3)).float()
            normal = -normal if flipped else normal
            bad = ~normal.isfinite().all(1) | (normal.norm(dim=1) < 0.5)
            if bool(bad.any()):  # of vertices that no triangle with area uses
                mean = torch.zeros_like(position).index_add_(0, face.flatten(), flat.repeat_interleave(3, 0))
                normal[bad] = torch.nn.functional.normalize(mean[bad] + 1e-12, dim=1)
        else:
            position, normal = position[face].reshape(-1, 3), flat.repeat_interleave(3, 0)
            face = torch.arange(3 * len(face)).view(-1, 3)
        positions.append(position)
        normals.append(normal)
        faces.append(face + first)
        shapes.append(torch.full((len(face),), number))
        first += len(position)
    if not positions:
        raise PrtError("the asset has no surface: its scene has no shapes")
    return TriangleMesh(*(torch.cat(parts) for parts in (positions, normals, faces, shapes))), uv


def welded(mesh: TriangleMesh) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "F 3"]]:
    """Vertices and faces with vertices at one place made one: they are doubled for normals and textures.

    One place is a millionth of the mesh's extent.
    """
    position = mesh.position.numpy().astype(np.float32)
    grid = np.round(position / max(float(np.ptp(position, axis=0).max()), 1e-12) * 1e6).astype(np.int64)
    _, first, same = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return position[first], same.ravel()[mesh.face.numpy()]


def sheets(mesh: TriangleMesh) -> Int[Tensor, "F"]:
    """Numbers of the connected pieces of each shape whose triangles are all wound the same way round."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    face, count = welded(mesh)[1], len(mesh.face)
    start, end = face.ravel().astype(np.int64), np.roll(face, -1, axis=1).ravel().astype(np.int64)
    owner = np.repeat(np.arange(count), 3)
    shape = mesh.shape.numpy().astype(np.int64)[owner]
    # neighbours that are wound alike run along their common edge in opposite directions
    most = len(mesh.position)
    ahead, back = (shape * most + start) * most + end, (shape * most + end) * most + start
    order = np.argsort(ahead, kind="stable")
    place = np.searchsorted(ahead[order], back).clip(max=len(order) - 1)
    met = ahead[order][place] == back
    links = (owner[met], owner[order][place][met])
    graph = coo_array((np.ones(len(links[0]), dtype=np.int8), links), shape=(count, count))
    return torch.from_numpy(connected_components(graph, directed=False)[1].astype(np.int64))


def flat_normals(mesh: TriangleMesh) -> Float[Tensor, "F 3"]:
    """Unit normals of the triangles, on the side of the vertex normals."""
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    flat = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    side = (flat * mesh.normal[mesh.face].sum(1)).sum(1, keepdim=True)
    return torch.where(side < 0, -flat, flat)

"""Transfer of spherical harmonics lighting to the vertices of an asset (Sloan, Kautz and Snyder 2002).

Diffuse transfer vectors, self-shadowed and interreflected (sections 4 and 5). What they transfer to is the
mean incident radiance, cosine weighted: irradiance over pi, which the albedo of a place is multiplied with.
"""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from torch import Tensor

from prt.light.sh import sh_basis
from prt.scene.frames import perpendicular
from prt.scene.lightmap_points import OFFSET, TriangleMesh
from prt.scene.mesh_places import triangle_scene
from prt.scene.mitsuba_setup import mitsuba

#: rays traced at a time; bounds the memory
RAYS = 1 << 18
#: by which share of the way to the middle of its triangles a vertex draws back
DRAW_BACK = 0.01


def vertex_transfer(
    asset: Any, order: int, directions: int, bounces: int, seed: int, pose: int = 0
) -> tuple[Float[Tensor, "V K"], Float[Tensor, "V K 3"]]:
    """Direct and interreflected transfer of ``K = order^2`` harmonics to every vertex, float32.

    Rays that hit a back face find the inside of a solid: black.

    Args:
        asset: of which ``mesh(pose)`` and ``vertex_albedo(pose)`` are asked.
        order: bands.
        directions: rays a vertex, in proportion to the cosine about its normal.
        bounces: of the interreflected light, its last one not counted: 1 is light that was reflected once.
        seed: of the directions.

    Returns:
        The direct one has no colour. The product with lighting coefficients is in the unit of radiance.
    """
    mesh = asset.mesh(pose)
    direct, links = trace_links(mesh, order, directions, seed)
    albedo = asset.vertex_albedo(pose)
    return direct, interreflect(direct[..., None].expand(-1, -1, 3), links, albedo, bounces)


def interreflect(
    direct: Float[Tensor, "V K 3"], links: list[csr_array], albedo: Float[Tensor, "V 3"], bounces: int
) -> Float[Tensor, "V K 3"]:
    """Sum of ``bounces`` passes (section 5): each gathers what the one before sends on."""
    last, total = direct, torch.zeros_like(direct, memory_format=torch.contiguous_format)
    for _ in range(bounces):
        sent = (albedo[:, None] * last).flatten(1).numpy()
        arriving = np.concatenate([part @ sent for part in links])
        last = torch.from_numpy(arriving).view(direct.shape)
        total += last
    return total


def trace_links(
    mesh: TriangleMesh, order: int, directions: int, seed: int
) -> tuple[Float[Tensor, "V K"], list[csr_array]]:
    """What every vertex sees: the direct transfer, and the vertices that light comes from.

    Returns:
        The links are sparse matrices, some rows each, V x V together. A row holds the weights with which a
        vertex gathers from others; its sum is the share of its directions that hit a front face.
    """
    many = len(mesh.position)
    scene = triangle_scene(mesh)
    flat, origin = _face_normals(mesh), vertex_origins(mesh)
    shift = torch.rand((many, 1, 2), generator=torch.Generator().manual_seed(seed))
    direct = torch.zeros((many, order**2))
    links = []
    for first in range(0, many, max(RAYS // directions, 1)):
        rows = slice(first, min(first + max(RAYS // directions, 1), many))
        here = rows.stop - rows.start
        d = cosine_directions(mesh.normal[rows], directions, shift[rows]).flatten(0, 1)
        owner = torch.arange(here).repeat_interleave(directions)
        escaped, triangle, weights = _intersect(scene, origin[rows][owner], d)
        values = sh_basis(d[escaped], order - 1)
        direct[rows].index_add_(0, owner[escaped], values, alpha=1 / directions)
        hit = (triangle >= 0) & ((flat[triangle] * d).sum(1) <= 0)
        share = torch.cat([1 - weights.sum(1, keepdim=True), weights], dim=1)[hit] / directions
        links.append(_links(mesh.face[triangle[hit]], share, owner[hit], (here, many)))
    return direct, links


def cosine_directions(
    normal: Float[Tensor, "V 3"], count: int, shift: Float[Tensor, "V 1 2"]
) -> Float[Tensor, "V count 3"]:
    """Unit directions of density cosine / pi about each normal: a Hammersley set, moved by ``shift``."""
    u = hammersley(count, shift)
    radius, angle = u[..., :1].sqrt(), 2 * math.pi * u[..., 1:]
    tangent, other = perpendicular(normal)
    height = (1 - u[..., :1]).clamp_min(0).sqrt()
    along = radius * angle.cos() * tangent[:, None] + radius * angle.sin() * other[:, None]
    return along + height * normal[:, None]


def sphere_directions(count: int, shift: Float[Tensor, "V 1 2"]) -> Float[Tensor, "V count 3"]:
    """Unit directions evenly over the sphere: a Hammersley set, moved by ``shift``."""
    u = hammersley(count, shift)
    height, angle = 1 - 2 * u[..., 0], 2 * math.pi * u[..., 1]
    radius = (1 - height**2).clamp_min(0).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), height], -1)


def hammersley(count: int, shift: Float[Tensor, "V 1 2"]) -> Float[Tensor, "V count 2"]:
    """``count`` even points of the unit square, moved by each shift and wrapped."""
    index = torch.arange(count)
    digit = torch.arange(32)
    radical = (((index[:, None] >> digit) & 1) * 0.5 ** (digit + 1)).sum(1)
    return (torch.stack([(index + 0.5) / count, radical], dim=1) + shift) % 1


# ---- geometry


def _face_normals(mesh: TriangleMesh) -> Float[Tensor, "F 3"]:
    """Not normalised: twice the area long, on the side of the vertex normals."""
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    inwards = (normal * mesh.normal[mesh.face].sum(1)).sum(1, keepdim=True) < 0
    return torch.where(inwards, -normal, normal)


def vertex_origins(mesh: TriangleMesh) -> Float[Tensor, "V 3"]:
    """Where the rays of the vertices start: above the surface, and off the rims of their triangles.

    A vertex in the corner of a room lies on the other walls too, and half its rays would start behind them.
    So each draws back towards the middle of its triangles; where the surface is convex that is below it, and
    only the part along the surface counts.
    """
    flat = _face_normals(mesh)
    corner = mesh.face.flatten()
    area = flat.norm(dim=1, keepdim=True)
    middle = mesh.position[mesh.face].mean(1)
    # area weighted: triangles too thin to count have no say
    sums = torch.zeros((len(mesh.position), 7))
    sums.index_add_(0, corner, torch.cat([flat, area * middle, area], dim=1).repeat_interleave(3, 0))
    used = sums[:, 6:] > 0
    normal = torch.where(used, torch.nn.functional.normalize(sums[:, :3], dim=1, eps=1e-30), mesh.normal)
    middle = torch.where(used, sums[:, 3:6] / sums[:, 6:].clamp_min(1e-30), mesh.position)
    back = DRAW_BACK * (middle - mesh.position)
    below = (back * normal).sum(1, keepdim=True).clamp_max(0)
    extent = mesh.position.amax(0) - mesh.position.amin(0)
    return mesh.position + back + (OFFSET * extent.norm() / 2 - below) * normal


def _intersect(
    scene: Any, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"]
) -> tuple[Bool[Tensor, "N"], Int[Tensor, "N"], Float[Tensor, "N 2"]]:
    """Which rays escape, the triangles that are hit (-1: none), weights of their second and third corner."""
    mi = mitsuba()
    ray = mi.Ray3f(mi.Point3f(origin.numpy().T), mi.Vector3f(direction.numpy().T))
    found = scene.ray_intersect_preliminary(ray, coherent=False)
    missed = ~torch.from_numpy(np.array(found.is_valid()))
    triangle = torch.from_numpy(np.array(found.prim_index).astype(np.int64))
    weights = torch.from_numpy(np.array(found.prim_uv).T.astype(np.float32))
    return missed, torch.where(missed, -1, triangle), weights


def _links(
    corners: Int[Tensor, "N 3"],
    weights: Float[Tensor, "N 3"],
    owner: Int[Tensor, "N"],
    shape: tuple[int, int],
) -> csr_array:
    """Rows of the vertices ``owner``; what they gather from a vertex in several directions is summed."""
    row = owner.repeat_interleave(3).to(torch.int32).numpy()
    column = corners.flatten().to(torch.int32).numpy()
    return csr_array((weights.flatten().numpy(), (row, column)), shape=shape)

"""On which triangle of a mesh, and where in it, the points of a G-buffer lie."""

import functools
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.scene.lightmap_points import TriangleMesh
from prt.scene.mesh_distance import closest
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.shapes import MeshData, diffuse, to_mesh

#: how far above and below a point its triangle is looked for, in sizes of the mesh: at first no further than
#: rounding moves it, then as far as an analytic shape may lie from the triangles that stand for it
REACH = (1e-5, 1e-3)
#: a point this near to a triangle, in sizes of the mesh, lies on it
ON_IT = 1e-6
#: triangles that are tried where rays find none
NEAREST = 32


def triangle_scene(mesh: TriangleMesh) -> Any:
    """All triangles as one shape of a ``mi.Scene``: its ``prim_index`` is the number of the triangle."""
    position, face = mesh.position.cpu().numpy(), mesh.face.cpu().numpy()
    data = MeshData(position, mesh.normal.cpu().numpy(), np.zeros((len(position), 2)), face)
    mi_mesh = to_mesh("mesh", data, diffuse((0.5, 0.5, 0.5)))
    return mitsuba().load_dict({"type": "scene", "mesh": mi_mesh}, optimize=False)


class MeshPlaces:
    """Finds the triangles that points of a surface lie on.

    Short rays through the point, along its normal and against it, find candidates; the point lies on the one
    that is nearest to it, and its weights are those of the nearest point of that triangle: exact to rounding,
    and never outside of it. Where rays slip through (a crack, a normal along the surface), triangles whose
    middles are near are tried.

    Args:
        mesh: triangles, world space.
    """

    def __init__(self, mesh: TriangleMesh):
        self.mesh = mesh
        self.corners = mesh.position[mesh.face].double()
        self.size = float((mesh.position.amax(0) - mesh.position.amin(0)).norm())

    def __call__(self, gbuffer: Any) -> tuple[Int[Tensor, "N 3"], Float[Tensor, "N 3"]]:
        """Vertices of the triangles that the points of a G-buffer lie on, and their barycentric weights."""
        triangle, weights, _ = self.find(gbuffer.position.cpu(), gbuffer.normal.cpu())
        return self.mesh.face[triangle].int(), weights

    def find(
        self, position: Float[Tensor, "N 3"], normal: Float[Tensor, "N 3"]
    ) -> tuple[Int[Tensor, "N"], Float[Tensor, "N 3"], Float[Tensor, "N"]]:
        """Triangles of points, barycentric weights (at least 0, of sum 1) and distances to the triangles.

        Normals need not be those of triangles, only point away from the surface; distances are float64.
        """
        count = len(position)
        distance = torch.full((count,), torch.inf, dtype=torch.float64)
        found = (torch.full((count,), -1), torch.zeros((count, 3)), distance)
        for reach in REACH:
            for side in (1.0, -1.0):
                left = (distance > ON_IT * self.size).nonzero()[:, 0]
                if len(left):
                    hit = self._cast(position[left], side * normal[left], reach * self.size)
                    self._keep_nearer(position, left[hit >= 0], hit[hit >= 0], found)
        lost = distance.isinf().nonzero()[:, 0]
        if len(lost):
            near = self._tree.query(position[lost].numpy(), k=min(NEAREST, len(self.mesh.face)))[1]
            for candidate in torch.from_numpy(np.reshape(near, (len(lost), -1))).unbind(1):
                self._keep_nearer(position, lost, candidate, found)
        return found

    def _cast(self, position: Tensor, along: Tensor, reach: float) -> Int[Tensor, "N"]:
        """The first triangle from ``reach`` above to ``reach`` below, -1 where there is none."""
        mi = mitsuba()
        start, way = (np.ascontiguousarray(v.numpy().T) for v in (position + reach * along, -along))
        ray = mi.Ray3f(mi.Point3f(start), mi.Vector3f(way))
        ray.maxt = mi.Float(2 * reach)
        hit = self._scene.ray_intersect_preliminary(ray, coherent=False)
        triangle = torch.from_numpy(np.array(hit.prim_index).astype(np.int64))
        return torch.where(torch.from_numpy(np.array(hit.is_valid())), triangle, -1)

    def _keep_nearer(
        self, position: Tensor, rows: Tensor, triangle: Tensor, found: tuple[Tensor, Tensor, Tensor]
    ) -> None:
        """Let points have these triangles, in place, where they are nearer than those found so far."""
        corners, points = self.corners[triangle], position[rows].double()
        on_it = closest(points, corners)
        away = (on_it - points).norm(dim=1)
        nearer = away < found[2][rows]
        new = (triangle, barycentric(on_it, corners).float(), away)
        for values, part in zip(found, new, strict=True):
            values[rows[nearer]] = part[nearer]

    @functools.cached_property
    def _scene(self) -> Any:
        return triangle_scene(self.mesh)

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.corners.mean(1).numpy())


def barycentric(point: Float[Tensor, "N 3"], corners: Float[Tensor, "N 3 3"]) -> Float[Tensor, "N 3"]:
    """Weights of the corners of triangles for points on them; a third each where there is no area."""
    a, b, c = (corners[:, k] - point for k in range(3))
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    parts = [(torch.linalg.cross(p, q) * normal).sum(1) for p, q in ((b, c), (c, a), (a, b))]
    area = torch.stack(parts, 1).clamp_min(0)
    total = area.sum(1, keepdim=True)
    return torch.where(total > 0, area / total.clamp_min(1e-300), 1 / 3)

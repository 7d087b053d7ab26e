"""Signed distance to a triangle mesh at given points, with the direction in which it grows."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.area_sampling import by_area
from prt.scene.atlas import interpolate
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.shapes import MeshData, to_mesh

#: points spread over the mesh to look up triangles by; how many of them, hence triangles, a query tries
SAMPLES, NEAREST = 400_000, 8
#: rays that a point's winding number is averaged over; odd, so that a majority is never tied
DIRECTIONS = 7
#: crossings of a ray that are followed, and how far it goes on beyond one, in sizes of the mesh
CROSSINGS, BEYOND = 64, 1e-6
#: queries that are worked on at a time
CHUNK = 1 << 15


class MeshDistance:
    """Distances to a mesh that encloses a volume, or nearly so.

    The unsigned distance is exact for the triangles tried: those that hold the :data:`NEAREST` closest of
    ``samples`` points spread over the mesh. The sign is that of the generalised winding number (Jacobson
    et al. 2013) less one half, estimated as the mean over directions of a ray's signed crossings: a ray that
    slips through a crack, or a small hole, is outvoted.

    Args:
        mesh: faces counter-clockwise seen from outside.
        samples: points spread over the mesh to look up triangles by.

    Raises:
        PrtError: for a mesh without area.
    """

    def __init__(self, mesh: MeshData, samples: int = SAMPLES):
        from scipy.spatial import cKDTree

        self.corners = torch.from_numpy(np.asarray(mesh.position)[mesh.face]).double()
        self.size = float(np.ptp(mesh.position, axis=0).max()) if len(mesh.position) else 0.0
        a, b, c = self.corners.unbind(1)
        cross = torch.linalg.cross(b - a, c - a)
        self.area = cross.norm(dim=1) / 2
        if len(mesh.face) == 0 or not float(self.area.sum()) > 0:
            raise PrtError(f"mesh with {len(mesh.face)} triangles has no area: no distance to it; replace it")
        self.normal = torch.nn.functional.normalize(cross, dim=1)
        position, self._face = self.sample(samples, torch.Generator().manual_seed(1))
        self._tree = cKDTree(position.numpy())
        self._mesh = mesh

    def sample(self, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "N 3"], Int[Tensor, "N"]]:
        """Points evenly spread by area, one in each of ``count`` equal areas, and their faces; float64."""
        random = torch.rand((count, 3), generator=generator, dtype=torch.float64)
        face, weights = by_area(self.area, random, torch.arange(count))
        return interpolate(self.corners[face], weights), face

    def __call__(self, position: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N"], Float[Tensor, "N 3"]]:
        """Signed distance, negative inside, and its gradient: unit, away from the nearest point outside.

        At points of the mesh itself the gradient is a face normal. float64.
        """
        found = [self._unsigned(part) for part in position.double().split(CHUNK)]
        distance, away = (torch.cat(column) for column in zip(*found, strict=True))
        sign = torch.where(self.winding(position) > 0.5, -1.0, 1.0).double()
        face = away[:, 3:]
        gradient = sign[:, None] * away[:, :3] / distance.clamp(min=1e-30)[:, None]
        on_it = distance < 1e-7 * self.size
        return sign * distance, torch.where(on_it[:, None], face, gradient)

    def _unsigned(self, position: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N"], Float[Tensor, "N 6"]]:
        """Distance; the way from the nearest point, and the normal of the nearest face."""
        index = torch.from_numpy(self._tree.query(position.numpy(), k=NEAREST)[1])
        face = self._face[index]
        way = position[:, None] - closest(position[:, None], self.corners[face])
        distance, which = way.norm(dim=2).min(1)
        rows = torch.arange(len(position))
        return distance, torch.cat([way[rows, which], self.normal[face[rows, which]]], 1)

    def winding(self, position: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
        """The winding number, estimated: about 1 inside and 0 outside."""
        mi = mitsuba()  # ahead of drjit, which would load an LLVM of its own choice
        import drjit as dr

        scene = mi.load_dict({"type": "scene", "mesh": to_mesh("mesh", self._mesh, {"type": "diffuse"})})
        point = mi.Point3f(np.ascontiguousarray(position.numpy().T, dtype=np.float32))
        total = dr.zeros(mi.Float, len(position))
        for way in fibonacci(DIRECTIONS):
            direction = mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in way))

            def step(origin, found, left, active, d=direction):
                hit = scene.ray_intersect(mi.Ray3f(origin, d), active)
                active &= hit.is_valid()
                found = dr.select(active, found + dr.sign(dr.dot(hit.n, d)), found)
                origin = dr.select(active, hit.p + BEYOND * self.size * d, origin)
                return origin, found, left - 1, active & (left > 1)

            state = (mi.Point3f(point), dr.zeros(mi.Float, len(position)), mi.UInt32(CROSSINGS),
                     dr.full(mi.Bool, True, len(position)))  # fmt: skip
            total += dr.while_loop(state, lambda o, f, left, active: active, step, label="winding")[1]
            dr.eval(total)
        return torch.from_numpy(np.array(total)) / DIRECTIONS


def fibonacci(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly over the sphere (a spherical Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    height, angle = 1 - 2 * k / count, np.pi * (3 - np.sqrt(5)) * k + 0.3
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], 1)


def closest(point: Float[Tensor, "*N 3"], corners: Float[Tensor, "*N 3 3"]) -> Float[Tensor, "*N 3"]:
    """The points of triangles nearest to points: of the four candidates in the face and on the edges."""
    a, b, c = corners.unbind(-2)
    normal = torch.linalg.cross(b - a, c - a)
    square = normal.square().sum(-1, keepdim=True).clamp(min=1e-60)
    away = point - a
    inside = point - (away * normal).sum(-1, keepdim=True) / square * normal
    best = torch.stack([_on_edge(point, p, q) for p, q in ((a, b), (b, c), (c, a))], -2)
    which = (best - point[..., None, :]).square().sum(-1).argmin(-1)
    edge = torch.gather(best, -2, which[..., None, None].expand(*which.shape, 1, 3))[..., 0, :]
    u = (torch.linalg.cross(away, c - a) * normal).sum(-1, keepdim=True) / square
    v = (torch.linalg.cross(b - a, away) * normal).sum(-1, keepdim=True) / square
    return torch.where((u >= 0) & (v >= 0) & (u + v <= 1), inside, edge)


def _on_edge(point: Tensor, p: Tensor, q: Tensor) -> Tensor:
    way = q - p
    length = way.square().sum(-1, keepdim=True).clamp(min=1e-60)
    return p + (((point - p) * way).sum(-1, keepdim=True) / length).clamp(0, 1) * way

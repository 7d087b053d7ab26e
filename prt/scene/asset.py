"""A scene seen as an asset that a lightmap is baked for: its triangles, its atlas, its measurement points."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.atlas import Atlas, interpolate, nearest_covered, rasterise, unwrap
from prt.scene.capture import camera_rays, facing, first_opaque_hit, materials_of, rows_of
from prt.scene.gbuffer import GBuffer
from prt.scene.lightmap_points import (
    OFFSET,
    AtlasGBuffer,
    MeasurePoints,
    Sites,
    TriangleMesh,
    map_view,
    texel_centres,
)
from prt.scene.meshes import as_meshes, flat_normals, one_mesh, sheets
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

#: rays per site that tell whether it lies inside of a solid, and the share of back faces that says so
HIDDEN_RAYS, HIDDEN_SHARE = 16, 0.5
#: views, and pixels a side, that tell which side of a sheet is looked at
SIDE_VIEWS, SIDE_PIXELS = 12, 48
#: places a texel is probed at
PROBES = 4


class SurfaceAsset:
    """An asset made of triangles. What it offers is described in docs/architecture.md.

    Args:
        scene: any scene; analytic shapes are baked as triangle meshes (:func:`prt.scene.meshes.as_meshes`).
        texels: of the lightmap, a side; charts are packed for this size.

    Raises:
        PrtError: for a scene without surface, or with shapes that have no lightmap.
    """

    #: neighbouring texels are neighbours on the surface: a denoiser may look at them
    filterable = True

    def __init__(self, scene: Any, texels: int):
        self.scene, self.texels, self.poses = scene, texels, scene.poses
        self.stores = "outgoing" if scene.medium else "incident"
        self.integrator = "volpath" if scene.medium else "path"
        self._kept: dict[tuple[Any, ...], Any] = {}

    def _once(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """What ``make`` returned the first time: kept as long as the asset."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON: geometry and materials of every keyframe, and the lightmap's size."""
        frames = [self.scene.posed(pose).fingerprint() for pose in range(self.poses)]
        return {"frames": frames, "texels": self.texels}

    # ---- geometry

    def shapes(self, pose: int = 0) -> list[Any]:
        """Its ``mi.Mesh`` objects; scenes with different emitters share them."""

        def make() -> list[Any]:
            content = {"type": "scene", **self.scene.posed(pose).description()}
            # not optimised: merged shapes come in another order every time, and an atlas is kept by triangle
            return as_meshes(list(mitsuba().load_dict(content, optimize=False).shapes()))

        return self._once(("shapes", pose), make)

    def load(self, emitters: dict[str, Any], pose: int = 0) -> Any:
        """A ``mi.Scene`` of the asset in this pose under these emitters; one without any is loaded once."""
        if not emitters:
            return self._once(("dark", pose), lambda: self._load({}, pose))
        return self._load(emitters, pose)

    def _load(self, emitters: dict[str, Any], pose: int) -> Any:
        content = {f"shape{i}": shape for i, shape in enumerate(self.shapes(pose))}
        # not optimised: merging shapes would change what prim_index counts
        return mitsuba().load_dict({"type": "scene", **content, **emitters}, optimize=False)

    def mesh(self, pose: int = 0) -> TriangleMesh:
        """All its triangles in one mesh; normals on the side that is looked at."""
        return self._once(("mesh", pose), lambda: self._oriented(one_mesh(self.shapes(pose))[0]))

    @functools.cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        position = self.mesh(0).position.numpy()
        return position.min(axis=0), position.max(axis=0)

    @property
    def centre(self) -> tuple[float, ...]:
        """Of the bounding box of pose 0, world units."""
        return tuple(float(v) for v in (self._box[0] + self._box[1]) / 2)

    @property
    def half_extents(self) -> tuple[float, ...]:
        """Of that box."""
        return tuple(float(v) for v in (self._box[1] - self._box[0]) / 2)

    @property
    def radius(self) -> float:
        """Of the sphere around that box."""
        return float(np.linalg.norm(self.half_extents))

    def _oriented(self, mesh: TriangleMesh) -> TriangleMesh:
        """Normals turned to the side the cameras look at: a wall may be modelled either way round."""
        turn = self._turned
        if not bool(turn.any()):
            return mesh
        vertex = torch.zeros(len(mesh.position), dtype=torch.bool)
        vertex[mesh.face[turn].flatten()] = True
        normal = torch.where(vertex[:, None], -mesh.normal, mesh.normal)
        face = torch.where(turn[:, None], mesh.face[:, [0, 2, 1]], mesh.face)
        return TriangleMesh(mesh.position, normal, face, mesh.shape)

    @functools.cached_property
    def _turned(self) -> Bool[Tensor, "F"]:
        """Triangles of sheets that are seen from behind more often than from in front, in pose 0.

        A sheet and not a shape: Mitsuba merges the shapes of a file that share a material. One that no view
        sees goes by its whole shape.
        """
        mesh = one_mesh(self.shapes(0))[0]
        if self.stores == "outgoing":  # a solid's outside is its outside
            return torch.zeros(len(mesh.face), dtype=torch.bool)
        scene, flat = self.load({}, 0), flat_normals(mesh)
        front = torch.zeros(len(mesh.face))
        for view in self.scene.posed(0).views("train", SIDE_VIEWS, SIDE_PIXELS):
            rays = camera_rays(view)
            found = scene.ray_intersect_preliminary(rays)
            hit = torch.from_numpy(np.array(found.is_valid()))
            triangle = torch.from_numpy(np.array(self._triangles(found, 0)).astype(np.int64))[hit]
            facing = -(flat[triangle] * torch.from_numpy(np.array(rays.d).T)[hit]).sum(1).sign()
            front.index_add_(0, triangle, facing)
        sheet = sheets(mesh)
        by_sheet = torch.zeros(int(sheet.max()) + 1).index_add_(0, sheet, front)[sheet]
        by_shape = torch.zeros(int(mesh.shape.max()) + 1).index_add_(0, mesh.shape, front)[mesh.shape]
        return torch.where(by_sheet == 0, by_shape, by_sheet) < 0

    def _triangles(self, found: Any, pose: int) -> Any:
        """The triangle of :meth:`mesh` (``mi.UInt32``) that each intersection is on; misses give any."""
        import drjit as dr

        mi = mitsuba()
        shapes = self.shapes(pose)
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in shapes]
        first = np.zeros(max(numbers) + 1, dtype=np.uint32)
        first[numbers] = np.cumsum([0, *(shape.face_count() for shape in shapes[:-1])])
        number = dr.reinterpret_array(mi.UInt32, found.shape)
        return dr.gather(mi.UInt32, mi.UInt32(first), number, number < len(first)) + found.prim_index

    # ---- lightmap

    @functools.cached_property
    def atlas(self) -> Atlas:
        """Where its triangles lie in the lightmap: the same for all poses."""
        mesh, own = one_mesh(self.shapes(0))
        atlas = unwrap(mesh, self.texels, self.scene.posed(0).fingerprint(), own)
        turn = self._turned
        corner = torch.where(turn[:, None, None], atlas.corner[:, [0, 2, 1]], atlas.corner)
        return Atlas(atlas.size, corner)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the lightmap."""
        return self.atlas.size

    @functools.cached_property
    def _places(self) -> tuple[Tensor, Tensor, Tensor]:
        """Texel, triangle and barycentrics of the probed places that are on the surface and can be seen."""
        triangle, weights = rasterise(self.atlas.corner, self.size, PROBES)
        texel = torch.arange(len(triangle)) // PROBES**2
        on = triangle >= 0
        texel, triangle, weights = texel[on], triangle[on], weights[on]
        if self.stores == "incident":
            open_ = ~self._hidden(triangle, weights)
            texel, triangle, weights = texel[open_], triangle[open_], weights[open_]
        return texel, triangle, weights

    @functools.cached_property
    def covered(self) -> Bool[Tensor, "T"]:
        """Which texels show a part of the surface that light can reach."""
        out = torch.zeros(self.size[0] * self.size[1], dtype=torch.bool)
        out[self._places[0]] = True
        return out

    @functools.cached_property
    def fill(self) -> Int[Tensor, "T"]:
        """For every texel the covered one it is filled from, as an index into the covered ones."""
        return nearest_covered(self.covered, self.size)

    def sites(self, pose: int = 0) -> Sites:
        """The places its lightmap is baked at."""
        texel, triangle, weights = self._places
        position, normal = self._surface(triangle, weights, pose)
        return Sites(texel, position, normal, self.size)

    def texel_gbuffer(self, pose: int = 0) -> AtlasGBuffer:
        """The lightmap itself as a G-buffer: one point a covered texel, of reflectance 1, seen from above."""
        texel, triangle, weights = self._places
        count = torch.bincount(texel, minlength=len(self.covered))[self.covered]
        middle = count.cumsum(0) - count + count // 2  # one of its places stands for the texel
        triangle, weights = triangle[middle], weights[middle]
        position, normal = self._surface(triangle, weights, pose)
        uv = texel_centres(self.covered.nonzero()[:, 0], self.size)
        one = torch.ones_like(position)
        view = map_view(self.centre, self.size)
        return AtlasGBuffer(
            position, normal, normal, normal, one, 0 * one, one[:, :1], uv, self.covered, view,
            triangle=triangle, barycentric=weights,
        )  # fmt: skip

    def _surface(self, triangle: Tensor, weights: Tensor, pose: int) -> tuple[Tensor, Tensor]:
        mesh = self.mesh(pose)
        corners = mesh.face[triangle]
        position = interpolate(mesh.position[corners], weights)
        normal = torch.nn.functional.normalize(interpolate(mesh.normal[corners], weights), dim=1)
        return position, normal

    def _hidden(self, triangle: Tensor, weights: Tensor) -> Bool[Tensor, "S"]:
        """Places inside of a solid (a floor under a box): most of what they see are back faces.

        Their light is black, never looked at, and would darken the seam of what is.
        """
        import drjit as dr

        mi = mitsuba()
        scene = self.load({}, 0)
        position, normal = self._surface(triangle, weights, 0)
        flat = self.face_normal(0)
        origin = position + OFFSET * self.radius * flat[triangle]
        count = len(position)
        rng = mi.load_dict({"type": "independent"})
        rng.seed(0, count)
        start = mi.Point3f(origin.numpy().T.astype(np.float32))
        frame = mi.Frame3f(mi.Vector3f(normal.numpy().T.astype(np.float32)))
        outward = mi.Vector3f(flat.numpy().T.astype(np.float32))
        behind = dr.zeros(mi.Float, count)
        for _ in range(HIDDEN_RAYS):
            d = frame.to_world(mi.warp.square_to_cosine_hemisphere(rng.next_2d()))
            found = scene.ray_intersect_preliminary(mi.Ray3f(start, d))
            hit = found.is_valid()
            n = dr.gather(mi.Vector3f, outward, self._triangles(found, 0), hit)
            behind += dr.select(hit & (dr.dot(n, d) > 0), mi.Float(1), 0)
            rng.schedule_state()
            dr.eval(behind)
        return torch.from_numpy(np.array(behind)) > HIDDEN_SHARE * HIDDEN_RAYS

    def face_normal(self, pose: int = 0) -> Float[Tensor, "F 3"]:
        """Unit normals of the triangles, on the side of the vertex normals."""
        return self._once(("face_normal", pose), lambda: flat_normals(self.mesh(pose)))

    # ---- measuring

    def measure_points(self, count: int, supersample: int, seed: int, pose: int = 0) -> MeasurePoints:
        """Blue-noise points on the surface that light can reach; the same places for every pose."""
        triangle, weights, group = self._once(
            ("scattered", count, supersample, seed), lambda: self._scattered(count, supersample, seed)
        )
        position, normal = self._surface(triangle, weights, pose)
        return MeasurePoints(position, normal, self._albedo(triangle, weights, pose), group)

    def _scattered(self, count: int, supersample: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        from prt.scene.blue_noise import scatter_points

        mesh = self.mesh(0)
        # triangles that no texel shows are inside of something
        seen = torch.zeros(len(mesh.face), dtype=torch.bool)
        seen[self._places[1]] = True
        which = seen.nonzero()[:, 0]
        corners = mesh.face[which]
        triangle, weights, group = scatter_points(
            mesh.position[corners], mesh.normal[corners], count, supersample, seed
        )
        return which[triangle], weights, group

    def _albedo(self, triangle: Tensor, weights: Tensor, pose: int) -> Float[Tensor, "P 3"]:
        """Diffuse plus specular reflectance at points of the surface; 1 where light passes through it."""
        if self.stores == "outgoing":
            return torch.ones((len(triangle), 3))
        import drjit as dr

        mi = mitsuba()
        position, _ = self._surface(triangle, weights, pose)
        flat = self.face_normal(pose)[triangle]
        reach = 1e-3 * self.radius
        origin = mi.Point3f((position + reach * flat).numpy().T.astype(np.float32))
        ray = mi.Ray3f(origin, mi.Vector3f(-flat.numpy().T.astype(np.float32)))
        ray.maxt = mi.Float(2 * reach)
        si = self.load({}, pose).ray_intersect(ray)
        dr.eval(si)
        hit = np.flatnonzero(np.array(si.is_valid()))
        out = torch.zeros((len(triangle), 3))
        if len(hit):
            si = dr.gather(mi.SurfaceInteraction3f, si, mi.UInt32(hit.astype(np.uint32)))
            material = materials_of(si, len(hit))
            albedo = rows_of(material.diffuse, len(hit)) + rows_of(material.specular, len(hit))
            out[hit] = albedo.clamp(0, 1)
        return out

    def vertex_albedo(self, pose: int = 0) -> Float[Tensor, "V 3"]:
        """Reflectance at the vertices, read a little inside of one of their triangles."""
        return self._once(("vertex_albedo", pose), lambda: self._vertex_albedo(pose))

    def _vertex_albedo(self, pose: int) -> Float[Tensor, "V 3"]:
        mesh = self.mesh(pose)
        triangle = torch.zeros(len(mesh.position), dtype=torch.long)
        corner = torch.zeros(len(mesh.position), dtype=torch.long)
        for k in range(3):
            triangle[mesh.face[:, k]] = torch.arange(len(mesh.face))
            corner[mesh.face[:, k]] = k
        owner_ok = mesh.face[triangle, corner] == torch.arange(len(mesh.position))
        corner = torch.where(owner_ok, corner, 0)
        weights = torch.full((len(triangle), 3), 0.02)
        weights.scatter_(1, corner[:, None], 0.96)
        return self._albedo(triangle, weights[:, 1:], pose)

    # ---- looking at it

    def capture(self, mi_scene: Any, view: View, pose: int = 0) -> AtlasGBuffer:
        """The G-buffer of a view with places in the lightmap.

        Args:
            mi_scene: from :meth:`load` with the same pose.
        """
        import drjit as dr

        mi = mitsuba()
        rays = camera_rays(view)
        # a boundary of a medium is no mask to be looked through
        si = mi_scene.ray_intersect(rays) if self.stores == "outgoing" else first_opaque_hit(mi_scene, rays)
        dr.eval(si)
        hit = torch.from_numpy(np.array(si.is_valid()))
        count = int(hit.sum())
        if count == 0:
            raise PrtError(
                f"a view of scene {self.scene.name!r} from {view.origin} sees nothing; check scene.cameras"
            )
        index = mi.UInt32(hit.nonzero()[:, 0].numpy().astype(np.uint32))
        si = dr.gather(mi.SurfaceInteraction3f, si, index)
        position = rows_of(si.p, count)
        triangle = torch.from_numpy(np.array(self._triangles(si, pose)).astype(np.int64))
        barycentric = self._barycentric(triangle, position, pose)
        if self.stores == "outgoing":
            one = torch.ones((count, 3))
            diffuse, specular, roughness, shading = one, 0 * one, one[:, :1], rows_of(si.sh_frame.n, count)
        else:
            material = materials_of(si, count)
            diffuse, specular, roughness, shading = (
                rows_of(part, count)
                for part in (material.diffuse, material.specular, material.roughness, material.normal)
            )
        normal, wo, wr = facing(view, position, shading, rows_of(si.n, count))
        return AtlasGBuffer(
            position, normal, wo, wr, diffuse, specular, roughness, self.atlas.at(triangle, barycentric),
            hit, view, triangle=triangle, barycentric=barycentric,
        )  # fmt: skip

    def _barycentric(self, triangle: Tensor, position: Tensor, pose: int) -> Float[Tensor, "N 2"]:
        """Weights of the second and third corner for points on (or, by rounding, near) triangles."""
        mesh = self.mesh(pose)
        a, b, c = (mesh.position[mesh.face[triangle, k]].double() for k in range(3))
        first, second, at = b - a, c - a, position.double() - a
        d00, d01, d11 = (first * first).sum(1), (first * second).sum(1), (second * second).sum(1)
        d20, d21 = (at * first).sum(1), (at * second).sum(1)
        scale = (d00 * d11 - d01 * d01).clamp_min(1e-30)
        weights = torch.stack([(d11 * d20 - d01 * d21) / scale, (d00 * d21 - d01 * d20) / scale], 1)
        return weights.clamp(0, 1).float()


def scaled_albedo(gbuffer: GBuffer) -> Float[Tensor, "N 3"]:
    """What a lightmap's value is multiplied by: all light is sent on evenly (Belcour 2022, section 7)."""
    return (gbuffer.diffuse + gbuffer.specular).clamp(0, 1)

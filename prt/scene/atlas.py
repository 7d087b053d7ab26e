"""A texture atlas over triangles: every point of an asset has its own place in one lightmap.

Charts come from xatlas, or from the mesh's own texture coordinates where those are usable. The rasteriser is
a ray tracer pointed at the flattened triangles: exact, and the same on every machine.
"""

import dataclasses
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.meshes import welded
from prt.scene.mitsuba_setup import mitsuba

#: empty texels between charts, so that bilinear lookups never reach a neighbour's
PADDING = 2
#: share of the area that texture coordinates may cover twice and still be used
OVERLAP = 0.02
VERSION = 1


@dataclasses.dataclass
class Atlas:
    """Where each triangle lies in the lightmap.

    Attributes:
        size: (H, W) in texels.
        corner: lightmap coordinates in [0, 1]^2 of each triangle's corners; texel (i, j) has its centre at
            ((j + 0.5) / W, (i + 0.5) / H).
    """

    size: tuple[int, int]
    corner: Float[Tensor, "F 3 2"]

    def at(self, triangle: Int[Tensor, "N"], barycentric: Float[Tensor, "N 2"]) -> Float[Tensor, "N 2"]:
        """Lightmap coordinates of points on triangles."""
        return interpolate(self.corner[triangle], barycentric)


def interpolate(corners: Float[Tensor, "N 3 C"], barycentric: Float[Tensor, "N 2"]) -> Float[Tensor, "N C"]:
    """Values at points given by the weights of the second and third corner."""
    b, c = barycentric[:, :1], barycentric[:, 1:]
    return (1 - b - c) * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2]


def unwrap(mesh: TriangleMesh, texels: int, fingerprint: dict, uv: Tensor | None = None) -> Atlas:
    """An atlas of about ``texels`` a side.

    Args:
        mesh: all triangles of the asset.
        fingerprint: of the asset, for the cache: charts of a large mesh take a minute.
        uv: the mesh's own texture coordinates (F, 3, 2), used where they lie in [0, 1]^2 and cover
            nothing twice.

    Raises:
        PrtError: for a mesh without triangles or a size that cannot hold the charts.
    """
    if not 8 <= texels <= 8192:
        raise PrtError(f"task.texels={texels} must lie between 8 and 8192 (lightmap texels a side)")
    if len(mesh.face) == 0:
        raise PrtError("the asset has no surface: it has no triangles to bake a lightmap for")
    if uv is not None and usable(uv):
        return Atlas((texels, texels), uv)
    settings = {"asset": fingerprint, "texels": texels}
    found = cached("atlas", VERSION, settings, lambda: _xatlas(mesh, texels))
    height, width = (int(v) for v in found["size"])
    return Atlas((height, width), found["corner"])


def usable(uv: Float[Tensor, "F 3 2"], probe: int = 512) -> bool:
    """Whether texture coordinates are an atlas: inside [0, 1]^2, with area, and nothing covered twice."""
    if not bool(((uv >= 0) & (uv <= 1)).all()):
        return False
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).abs()
    if float((area < 1e-12).float().mean()) > 0.01:
        return False
    covered = float((rasterise(uv, (probe, probe), 1)[0] >= 0).float().mean())
    return float(area.sum()) <= covered * (1 + OVERLAP)


def _xatlas(mesh: TriangleMesh, texels: int) -> dict[str, Tensor]:
    import xatlas

    position, face = welded(mesh)  # charts grow over shared vertices
    atlas = xatlas.Atlas()
    atlas.add_mesh(position, face.astype(np.uint32))
    charts, pack = xatlas.ChartOptions(), xatlas.PackOptions()
    pack.resolution, pack.padding, pack.bilinear = texels, PADDING, True
    atlas.generate(charts, pack)
    _, indices, uv = atlas.get_mesh(0)
    if atlas.width == 0 or len(indices) != len(mesh.face):
        raise PrtError(f"xatlas found no charts for {len(mesh.face)} triangles; check the mesh")
    size = torch.tensor([atlas.height, atlas.width])
    corner = torch.from_numpy(np.ascontiguousarray(uv[indices], dtype=np.float32))
    # our rows run with v
    return {"size": size, "corner": corner.clamp(0, 1)}


def rasterise(
    corner: Float[Tensor, "F 3 2"], size: tuple[int, int], grid: int
) -> tuple[Int[Tensor, "S"], Float[Tensor, "S 2"]]:
    """Which triangle covers each of ``grid x grid`` places in each texel, -1 where none, and where in it.

    Returns:
        Triangle and barycentric weights of S = H W grid^2 places, texel after texel (row-major).
    """
    mi = mitsuba()  # before drjit, which takes the LLVM it finds
    import drjit as dr

    height, width = size
    scale = corner.new_tensor([width, height])
    flat = torch.cat([corner * scale, torch.zeros_like(corner[..., :1])], dim=2).reshape(-1, 3)
    faces = len(corner)
    mesh = mi.Mesh("atlas", vertex_count=3 * faces, face_count=faces)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.ascontiguousarray(flat.numpy(), dtype=np.float32).ravel()
    params["faces"] = np.arange(3 * faces, dtype=np.uint32)
    params.update()
    scene = mi.load_dict({"type": "scene", "atlas": mesh})
    per = grid * grid
    index = dr.arange(mi.UInt32, height * width * per)
    texel, sub = index // per, index % per
    x = mi.Float(texel % width) + (mi.Float(sub % grid) + 0.5) / grid
    y = mi.Float(texel // width) + (mi.Float(sub // grid) + 0.5) / grid
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(x, y, 1), mi.Vector3f(0, 0, -1)))
    triangle = dr.select(hit.is_valid(), mi.Int32(hit.prim_index), -1)
    dr.eval(triangle, hit.prim_uv)
    weights = np.stack([np.array(hit.prim_uv.x), np.array(hit.prim_uv.y)], 1)
    return torch.from_numpy(np.array(triangle)).long(), torch.from_numpy(weights).float()


def nearest_covered(covered: Bool[Tensor, "T"], size: tuple[int, int]) -> Int[Tensor, "T"]:
    """For every texel the covered texel nearest to it, as an index into the covered ones: pads the seams.

    Raises:
        PrtError: if nothing is covered.
    """
    from scipy.ndimage import distance_transform_edt

    if not bool(covered.any()):
        raise PrtError("the asset has no surface in its lightmap: no texel is covered; raise task.texels")
    where: Any = distance_transform_edt(
        ~covered.view(size).numpy(), return_distances=False, return_indices=True
    )
    flat = torch.from_numpy(where[0].astype(np.int64) * size[1] + where[1]).flatten()
    return (covered.cumsum(0) - 1)[flat]

"""Hair as an asset: a lightmap over strand index and arc length, light measured on the hull of the strands.

After Belcour 2022, section 6.3: "we parameterize hair strands using length and strand index as 2D
coordinates. We further pack this texture coordinate by using 10 pixels per hair strand and concatenating
multiple strands per row", direct light is evaluated "on the hull defined by hair fibers", and what a texel
holds is the outgoing radiance averaged "along the hair's azimuth as well as along the arc length inside the
texel" (figure 11).
"""

import functools
import math
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.atlas import interpolate
from prt.scene.capture import camera_rays, facing, rows_of
from prt.scene.frames import perpendicular
from prt.scene.lightmap_points import AtlasGBuffer, MeasurePoints, Sites, map_view, texel_centres
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.strands import Strands
from prt.scene.view import View

#: texels side by side that one strand has (Belcour 2022, section 6.3)
TEXELS_PER_STRAND = 10
#: places that each texel averages over, unless told
PER_TEXEL = 8
#: how far the measurement points lie outside the hull of the strands' centre lines, in strand radii: 1 is
#: where the outermost hair ends, the rest keeps it from shadowing them
HULL_OFFSET = 1.5
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


class HairAsset:
    """An asset of strands; the contract is described in docs/architecture.md.

    A texel holds the mean radiance that a piece of strand sends on, over its round surface ("radially
    constant", section 6.3). Texel ``j`` of strand ``i`` has the flat index ``10 i + j``.

    Args:
        scene: has ``strands`` (:class:`Strands`) and ``hair()``, their ``mi.Shape`` objects.
        texels: as for other assets; the number of strands decides the size of the lightmap, not this.
    """

    #: the texel beside the last of a strand is another strand's: a denoiser of images must not look at it
    filterable: bool = False
    poses: int = 1
    stores: Literal["incident", "outgoing"] = "outgoing"
    integrator: Literal["path", "volpath"] = "path"

    def __init__(self, scene: Any, texels: int | None = None):
        self.scene, self.texels = scene, texels

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON: geometry and material, and the texels a strand has."""
        return {"scene": self.scene.fingerprint(), "texels_per_strand": TEXELS_PER_STRAND}

    # ---- geometry

    @property
    def strands(self) -> Strands:
        """Its geometry."""
        return self.scene.strands

    def load(self, emitters: dict[str, Any], pose: int = 0) -> Any:
        """A ``mi.Scene`` of the strands under these emitters; all such scenes share the shapes."""
        shapes = {f"hair{i}": shape for i, shape in enumerate(self.scene.hair())}
        return mitsuba().load_dict({"type": "scene", **shapes, **emitters}, optimize=False)

    @functools.cached_property
    def _box(self) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
        points = self.strands.enclosing().reshape(-1, 3)
        return points.amin(0) - self.strands.radius, points.amax(0) + self.strands.radius

    @property
    def centre(self) -> tuple[float, ...]:
        """Of the bounding box, world units."""
        return tuple(((self._box[0] + self._box[1]) / 2).tolist())

    @property
    def half_extents(self) -> tuple[float, ...]:
        """Of that box."""
        return tuple(((self._box[1] - self._box[0]) / 2).tolist())

    @property
    def radius(self) -> float:
        """Of the sphere around that box."""
        return math.hypot(*self.half_extents)

    # ---- lightmap

    @property
    def strands_per_row(self) -> int:
        """As many as make the lightmap about square."""
        return max(1, round(math.sqrt(len(self.strands) / TEXELS_PER_STRAND)))

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the lightmap; 100 000 strands fill 1000 x 1000 texels."""
        return -(-len(self.strands) // self.strands_per_row), TEXELS_PER_STRAND * self.strands_per_row

    @functools.cached_property
    def covered(self) -> Bool[Tensor, "T"]:
        """Which texels belong to a strand: all but the rest of the last row."""
        height, width = self.size
        return torch.arange(height * width) < TEXELS_PER_STRAND * len(self.strands)

    @functools.cached_property
    def fill(self) -> Int[Tensor, "T"]:
        """For every texel the covered one it is filled from, as an index into the covered ones."""
        return torch.arange(len(self.covered)).clamp(max=TEXELS_PER_STRAND * len(self.strands) - 1)

    def sites(self, pose: int = 0, per_texel: int = PER_TEXEL) -> Sites:
        """The places its lightmap is baked at: spread over arc length and azimuth, the same at every call.

        Args:
            pose: hair has one.
            per_texel: places in each texel. Arc lengths are the middles of as many equal pieces and azimuths
                those of as many equal angles, each taken once, turned from texel to texel.

        Returns:
            ``normal`` is radial, ``position`` the point of the centre line plus ``radius * normal``.

        Raises:
            PrtError: for less than one place a texel.
        """
        if per_texel < 1:
            raise PrtError(f"per_texel={per_texel} must be at least 1 (places in a texel that are averaged)")
        number = torch.arange(per_texel)
        # the order of the golden sequence: neighbours along the strand face different ways
        order = ((number + 1) * GOLDEN % 1.0).argsort().argsort()
        texel = torch.arange(TEXELS_PER_STRAND * len(self.strands))
        along = ((number + 0.5) / per_texel).expand(len(texel), -1)
        # in double: a float has no digits left for the angle of the millionth texel
        turn = ((order + 0.5) / per_texel + (texel.double() * GOLDEN)[:, None] % 1.0) * (2 * math.pi)
        position, normal = self._surface(texel, along, turn.float())
        return Sites(texel.repeat_interleave(per_texel), position, normal, self.size)

    def texel_gbuffer(self, pose: int = 0) -> AtlasGBuffer:
        """The lightmap itself as a G-buffer: one point a covered texel, of reflectance 1, seen from above."""
        texel = self.covered.nonzero()[:, 0]
        middle = torch.full((len(texel), 1), 0.5)
        turn = (texel.double() * GOLDEN % 1.0 * (2 * math.pi)).float()
        position, normal = self._surface(texel, middle, turn[:, None])
        uv, view = texel_centres(texel, self.size), map_view(self.centre, self.size)
        return _gbuffer(position, normal, normal, normal, uv, self.covered, view)

    def _surface(
        self, texel: Int[Tensor, "T"], along: Float[Tensor, "T L"], turn: Float[Tensor, "T L"]
    ) -> tuple[Float[Tensor, "S 3"], Float[Tensor, "S 3"]]:
        """Points on the round surface and their normals, texel after texel.

        Args:
            along: share of the texel's arc length, in [0, 1].
            turn: azimuth, radians, from an arbitrary direction.
        """
        strand = texel // TEXELS_PER_STRAND
        share = (texel % TEXELS_PER_STRAND)[:, None] + along
        segment, t = self.strands.locate(strand, share / TEXELS_PER_STRAND)
        place = strand.repeat_interleave(along.shape[1]), segment.flatten(), t.flatten()
        tangent = self.strands.tangent(*place)
        first, second = perpendicular(tangent)
        angle = turn.flatten()[:, None]
        normal = torch.nn.functional.normalize(angle.cos() * first + angle.sin() * second, dim=1)
        return self.strands.at(*place) + self.strands.radius * normal, normal

    # ---- measuring

    @functools.cached_property
    def hull(self) -> tuple[Float[Tensor, "F 3 3"], Float[Tensor, "F 3"]]:
        """Triangles of the convex hull of the centre lines, and their unit normals, outwards.

        Raises:
            PrtError: for strands that all lie in one plane: they have no hull.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = self.strands.enclosing().reshape(-1, 3).double().numpy()
        try:
            found = ConvexHull(points)
        except QhullError as error:
            raise PrtError(
                f"{len(self.strands)} strands of scene {self.scene.name!r} lie in one plane and have no hull "
                "to measure light on; raise scene.strands or scene.curl"
            ) from error
        corners, normal = points[found.simplices], found.equations[:, :3]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        turned = (flat * normal).sum(1) < 0
        corners[turned] = corners[turned][:, [0, 2, 1]]
        return torch.from_numpy(corners).float(), torch.from_numpy(normal).float()

    def measure_points(self, count: int, supersample: int, seed: int, pose: int = 0) -> MeasurePoints:
        """Blue-noise points on the hull, ``HULL_OFFSET`` strand radii outside the centre lines; albedo 1.

        Raises:
            PrtError: for strands without a hull.
        """
        from prt.scene.blue_noise import scatter_points

        corners, flat = self.hull
        corner_normals = flat[:, None].expand(-1, 3, -1).contiguous()
        triangle, weights, group = scatter_points(corners, corner_normals, count, supersample, seed)
        position, normal = interpolate(corners[triangle], weights), flat[triangle]
        # outside of a plane of the hull is outside of the hull, whichever hair it is
        position = position + HULL_OFFSET * self.strands.radius * normal
        return MeasurePoints(position, normal, torch.ones_like(position), group)

    # ---- looking at it

    def capture(self, mi_scene: Any, view: View, pose: int = 0) -> AtlasGBuffer:
        """The G-buffer of a view with places in the lightmap.

        ``uv`` never comes closer than half a texel to another strand's texels, and stands in the middle of
        its row: a bilinear lookup stays on the strand.

        Args:
            mi_scene: from :meth:`load`.

        Raises:
            PrtError: for a view that sees nothing, or without a vectorised variant.
        """
        import drjit as dr

        mi = mitsuba()
        if mi.variant().startswith("scalar"):
            raise PrtError("the G-buffer needs a vectorised Mitsuba variant: pip install karellen-llvm-core")
        rays = camera_rays(view)
        found = mi_scene.ray_intersect_preliminary(rays)
        si = found.compute_surface_interaction(rays)
        along, prim, owner = found.prim_uv.x, found.prim_index, dr.reinterpret_array(mi.UInt32, found.shape)
        dr.eval(si, along, prim, owner)
        hit = torch.from_numpy(np.array(found.is_valid()))
        count = int(hit.sum())
        if count == 0:
            raise PrtError(
                f"a view of scene {self.scene.name!r} from {view.origin} sees nothing; check scene.cameras"
            )
        position, normal = rows_of(si.p, len(hit))[hit], rows_of(si.n, len(hit))[hit]
        segment = self._segment(np.array(prim), np.array(owner))[hit]
        t = torch.from_numpy(np.array(along))[hit].float()
        normal, wo, wr = facing(view, position, normal, normal)
        return _gbuffer(position, normal, wo, wr, self.uv(segment, t), hit, view)

    def _segment(self, primitive: np.ndarray, owner: np.ndarray) -> Int[Tensor, "N"]:
        """Number of the segment over all strands, from that in its shape and from the shape's address."""
        import drjit as dr

        mi = mitsuba()
        out = np.zeros(len(primitive), dtype=np.int64)
        each = self.strands.strands_per_shape * self.strands.segments
        for number, shape in enumerate(self.scene.hair()):
            here = owner == np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))
            first = number * each
            many = min(each, len(self.strands) * self.strands.segments - first)
            # the segment that a shape has beyond its strands lies in the last of them
            out[here] = first + np.minimum(primitive[here], many - 1)
        return torch.from_numpy(out)

    def uv(self, primitive: Int[Tensor, "N"], t: Float[Tensor, "N"]) -> Float[Tensor, "N 2"]:
        """Places in the lightmap; ``primitive`` is the number of the segment, over all strands."""
        strand = primitive // self.strands.segments
        share = self.strands.share(strand, primitive % self.strands.segments, t)
        height, width = self.size
        texel = (TEXELS_PER_STRAND * share).clamp(0.5, TEXELS_PER_STRAND - 0.5)
        column = TEXELS_PER_STRAND * (strand % self.strands_per_row) + texel
        return torch.stack([column / width, (strand // self.strands_per_row + 0.5) / height], 1)


def _gbuffer(
    position: Tensor, normal: Tensor, wo: Tensor, wr: Tensor, uv: Tensor, hit: Tensor, view: View
) -> AtlasGBuffer:
    """Points on hair: their reflectance is in the light that is stored, so here it is 1."""
    one = torch.ones_like(position)
    return AtlasGBuffer(
        position, normal, wo, wr, one, 0 * one, one[:, :1], uv, hit, view,
        triangle=torch.full((len(position),), -1), barycentric=torch.zeros((len(position), 2)),
    )  # fmt: skip

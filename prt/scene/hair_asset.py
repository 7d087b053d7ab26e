"""Hair as an asset: a lightmap over strand index and arc length, light measured on the hull of the strands.

After Belcour 2022, section 6.3: "we parameterize hair strands using length and strand index as 2D
coordinates. We further pack this texture coordinate by using 10 pixels per hair strand and concatenating
multiple strands per row", direct light is evaluated "on the hull defined by hair fibers", and what a texel
holds is the outgoing radiance averaged "along the hair's azimuth as well as along the arc length inside the
texel" (figure 11).
"""

import dataclasses
import functools
import math
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.capture import _rows, _towards_viewer, camera_rays
from prt.scene.lightmap_points import AtlasGBuffer, MeasurePoints, Sites
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

#: texels side by side that one strand has (Belcour 2022, section 6.3)
TEXELS_PER_STRAND = 10
#: places that each texel averages over, unless told
PER_TEXEL = 8
#: how far the measurement points lie outside the hull of the strands' centre lines, in strand radii: 1 is
#: where the outermost hair ends, the rest keeps it from shadowing them
HULL_OFFSET = 1.5
#: pieces that each segment is cut into to measure arc length, and strands measured at a time (memory)
PIECES, CHUNK = 8, 1 << 14
#: segments in one Mitsuba shape at most: it takes the tangent from the place along all of its strands, one
#: float, which has no digits left for the place along a segment where there are millions
SHAPE_SEGMENTS = 1 << 17
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclasses.dataclass(eq=False)
class Strands:
    """N strands of equal radius, each a curve with C control points.

    Attributes:
        control: control points, world units. A ``bsplinecurve`` is a uniform cubic B-spline of C - 3 segments
            (it does not reach its end control points), a ``linearcurve`` a polyline of C - 1.
        radius: of every strand, world units.
        curve: name of the Mitsuba shape.
    """

    control: Float[Tensor, "N C 3"]
    radius: float
    curve: Literal["bsplinecurve", "linearcurve"] = "bsplinecurve"

    def __len__(self) -> int:
        return len(self.control)

    @property
    def segments(self) -> int:
        """Of each strand."""
        return self.control.shape[1] - (3 if self.curve == "bsplinecurve" else 1)

    def at(
        self, strand: Int[Tensor, "M"], segment: Int[Tensor, "M"], t: Float[Tensor, "M"]
    ) -> Float[Tensor, "M 3"]:
        """Points of the centre lines, world units; ``t`` in [0, 1] runs along the segment."""
        if self.curve == "bsplinecurve":
            s = 1 - t
            weights = s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3
            return self._blend(strand, segment, weights) / 6
        return self._blend(strand, segment, (1 - t, t))

    def tangent(
        self, strand: Int[Tensor, "M"], segment: Int[Tensor, "M"], t: Float[Tensor, "M"]
    ) -> Float[Tensor, "M 3"]:
        """Unit tangents of the centre lines, from root to tip."""
        if self.curve == "bsplinecurve":
            s = 1 - t
            weights = -(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2
        else:
            weights = -torch.ones_like(t), torch.ones_like(t)
        return torch.nn.functional.normalize(self._blend(strand, segment, weights), dim=1)

    def _blend(self, strand: Tensor, segment: Tensor, weights: tuple[Tensor, ...]) -> Float[Tensor, "M 3"]:
        parts = [weight[:, None] * self.control[strand, segment + k] for k, weight in enumerate(weights)]
        return torch.stack(parts).sum(0)

    @functools.cached_property
    def arc(self) -> Float[Tensor, "N K"]:
        """Share of the strand's arc length from the root to the ends of K - 1 = segments * PIECES pieces."""
        steps = torch.arange(self.segments * PIECES + 1)
        segment = (steps // PIECES).clamp(max=self.segments - 1)
        t = steps / PIECES - segment
        rows = []
        for strand in torch.arange(len(self)).split(CHUNK):
            index = strand.repeat_interleave(len(steps))
            points = self.at(index, segment.repeat(len(strand)), t.repeat(len(strand)))
            lengths = points.view(len(strand), -1, 3).diff(dim=1).norm(dim=2)
            total = torch.nn.functional.pad(lengths.double().cumsum(1), (1, 0))
            rows.append((total / total[:, -1:].clamp_min(1e-30)).float())
        return torch.cat(rows)

    def share(
        self, strand: Int[Tensor, "M"], segment: Int[Tensor, "M"], t: Float[Tensor, "M"]
    ) -> Float[Tensor, "M"]:
        """Arc length from the root to a place, as a share of the strand's: 0 at the root, 1 at the tip."""
        place = (segment + t.clamp(0, 1)) * PIECES
        piece = place.long().clamp(max=self.segments * PIECES - 1)
        low, high = self.arc[strand, piece], self.arc[strand, piece + 1]
        return low + (place - piece) * (high - low)

    def locate(
        self, strand: Int[Tensor, "M"], share: Float[Tensor, "M L"]
    ) -> tuple[Int[Tensor, "M L"], Float[Tensor, "M L"]]:
        """The inverse of :meth:`share`: segment and ``t`` of L places on each of M strands."""
        table = self.arc[strand]
        piece = torch.searchsorted(table, share.contiguous(), right=True) - 1
        piece = piece.clamp(0, self.segments * PIECES - 1)
        low, high = table.gather(1, piece), table.gather(1, piece + 1)
        place = piece + ((share - low) / (high - low).clamp_min(1e-30)).clamp(0, 1)
        segment = (place / PIECES).long().clamp(max=self.segments - 1)
        return segment, place / PIECES - segment

    def enclosing(self) -> Float[Tensor, "N E 3"]:
        """Points near the centre lines whose convex hull holds them: control points in Bezier form.

        Those of the B-spline would do too, but stand off further; samples of the curve would cut its bends.
        """
        if self.curve == "linearcurve":
            return self.control
        a, b, c = self.control[:, :-2], self.control[:, 1:-1], self.control[:, 2:]
        joints = (a + 4 * b + c) / 6
        inner = self.control[:, 1:-2], self.control[:, 2:-1]
        return torch.cat([joints, (2 * inner[0] + inner[1]) / 3, (inner[0] + 2 * inner[1]) / 3], dim=1)

    def shapes(self, bsdf: dict[str, Any]) -> list[Any]:
        """All strands as ``mi.Shape`` objects with this BSDF: ``strands_per_shape`` in each but the last.

        Raises:
            PrtError: if the files through which Mitsuba takes curves cannot be written.
        """
        material = mitsuba().load_dict(bsdf)
        return [self._shape(part, material) for part in self.control.split(self.strands_per_shape)]

    @property
    def strands_per_shape(self) -> int:
        """Strands in one ``mi.Shape``."""
        return max(1, SHAPE_SEGMENTS // self.segments)

    def _shape(self, control: Float[Tensor, "P C 3"], material: Any) -> Any:
        lines = f"%.9g %.9g %.9g {self.radius:.9g}\n" * control.shape[1] + "\n"
        try:
            # Mitsuba reads curves from a text file only; it copies them, so the file need not outlive this
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "strands.txt"
                with open(path, "w") as file:
                    file.writelines(lines % tuple(row) for row in control.flatten(1).tolist())
                    if self.curve == "bsplinecurve":
                        # At the very tip of its last strand Mitsuba 3.9 looks for a segment after that and
                        # reads memory that is not its own (BSplineCurve::partials). So there is one: thinner
                        # and inside of the last segment, where no ray meets it.
                        thin = f"%.9g %.9g %.9g {1e-3 * self.radius:.9g}\n" * 4
                        file.write(thin % tuple(control[-1, -4:].flatten().tolist()))
                return mitsuba().load_dict({"type": self.curve, "filename": str(path), "bsdf": material})
        except OSError as error:
            raise PrtError(
                f"cannot write {len(control)} strands to {tempfile.gettempdir()}: {error.strerror or error}; "
                "free the disk or set TMPDIR to another folder"
            ) from error


class HairAsset:
    """An asset of strands; the contract is described in docs/architecture.md.

    A texel holds the mean radiance that a piece of strand sends on, over its round surface ("radially
    constant", section 6.3). Texel ``j`` of strand ``i`` has the flat index ``10 i + j``.

    Args:
        scene: has ``strands`` (:class:`Strands`) and ``hair()``, their ``mi.Shape`` objects.
        texels: as for other assets; the number of strands decides the size of the lightmap, not this.
    """

    #: the texel beside the last of a strand is another strand's: a denoiser must not look at it
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
        height, width = self.size
        uv = torch.stack([(texel % width + 0.5) / width, (texel // width + 0.5) / height], 1)
        x, y, z = self.centre
        # a lightmap has no camera: its view only names an image's size
        view = View((x, y, z), (x, y, z + 1.0), width=width, height=height)
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
        first, second = _perpendicular(tangent)
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
        b, c = weights[:, :1], weights[:, 1:]
        a, normal = corners[triangle], flat[triangle]
        position = (1 - b - c) * a[:, 0] + b * a[:, 1] + c * a[:, 2]
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
        position, normal = _rows(si.p, len(hit))[hit], _rows(si.n, len(hit))[hit]
        segment = self._segment(np.array(prim), np.array(owner))[hit]
        t = torch.from_numpy(np.array(along))[hit].float()
        wo = torch.nn.functional.normalize(torch.tensor(view.origin, dtype=torch.float32) - position, dim=1)
        normal = _towards_viewer(normal, normal, wo)
        cosine = (normal * wo).sum(1, keepdim=True)
        wr = torch.nn.functional.normalize(2 * cosine * normal - wo, dim=1)
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


def _perpendicular(axis: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Two unit vectors that complete each unit axis to a frame (Duff et al. 2017)."""
    x, y, z = axis.unbind(1)
    sign = torch.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1),
        torch.stack([b, sign + y * y * a, -y], 1),
    )


def _gbuffer(
    position: Tensor, normal: Tensor, wo: Tensor, wr: Tensor, uv: Tensor, hit: Tensor, view: View
) -> AtlasGBuffer:
    """Points on hair: their reflectance is in the light that is stored, so here it is 1."""
    one = torch.ones_like(position)
    return AtlasGBuffer(
        position, normal, wo, wr, one, 0 * one, one[:, :1], uv, hit, view,
        triangle=torch.full((len(position),), -1), barycentric=torch.zeros((len(position), 2)),
    )  # fmt: skip

"""Strands of hair as curves: places along them, arc length, and the Mitsuba shapes made of them."""

import dataclasses
import functools
import tempfile
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba

#: pieces that each segment is cut into to measure arc length, and strands measured at a time (memory)
PIECES, CHUNK = 8, 1 << 14
#: segments in one Mitsuba shape at most: it takes the tangent from the place along all of its strands, one
#: float, which has no digits left for the place along a segment where there are millions
SHAPE_SEGMENTS = 1 << 17


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

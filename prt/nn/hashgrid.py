"""Multiresolution hash encoding of positions (Mueller et al. 2022), fast on CPU and GPU as plain torch."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError

#: Mueller et al. 2022, equation 4
PRIMES = (1, 2654435761, 805459861)
INITIAL = 1e-4
#: points whose corners are computed at a time on the CPU: their arrays stay in cache
BLOCK = 4096


class Corners(NamedTuple):
    """Which rows of a table a point reads, and how much of each; depends on the position only.

    Attributes:
        indices, weights: L levels of C corners: 8 of a cell of a grid, 3 of a triangle.
    """

    indices: Int[Tensor, "N L C"]
    weights: Float[Tensor, "N L C"]

    def rows(self, index: Tensor) -> "Corners":
        """The corners of some of the points."""
        return Corners(self.indices[index], self.weights[index])

    def to(self, device: torch.device | str) -> "Corners":
        return Corners(self.indices.to(device), self.weights.to(device))


class HashGrid(torch.nn.Module):
    """Trilinearly interpolated features at several resolutions, concatenated from coarse to fine.

    Cells are cubes: level l has ``floor(base_resolution * scale**l)`` of them along the longest side of the
    bounds. A level whose corners all fit into the table is stored densely, without collisions; the others
    share ``2**log2_table`` rows by hashing.

    Where the same points are looked up again and again (training pixels), compute :meth:`corners` once and
    call :meth:`lookup` on rows of it: that leaves about half of the cost of a training step.

    Args:
        levels, features: L and F; Raghavan 2023 (section 5) has 32 and 2.
        log2_table: base-2 logarithm of the rows per level.
        base_resolution, scale: cells of level 0 and growth per level.
        bounds: corners (min, max) of the box that is covered, world units; points outside are clamped to it.

    Raises:
        PrtError: for a setting out of range or bounds without extent.
    """

    #: whether training keeps the corners of all its points on a GPU too: large, and found again in no time
    keeps_places = False

    def __init__(
        self,
        levels: int,
        features: int,
        log2_table: int,
        base_resolution: int,
        scale: float,
        bounds: tuple[Sequence[float], Sequence[float]],
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        for name, value, most in (
            ("levels", levels, 64), ("features", features, 64), ("log2_table", log2_table, 26),
            ("base_resolution", base_resolution, 1 << 16),
        ):  # fmt: skip
            if not isinstance(value, int) or not 1 <= value <= most:
                raise PrtError(f"hash grid {name}={value!r} must be an integer from 1 to {most}")
        if not scale >= 1 or base_resolution * scale ** (levels - 1) > 1 << 22:
            raise PrtError(
                f"hash grid scale={scale!r} must be at least 1 and keep the finest of {levels} levels below "
                "2^22 cells (float32 resolves no more); lower scale or levels"
            )
        low, high = (torch.tensor([float(c) for c in corner], dtype=torch.float64) for corner in bounds)
        extent = high - low
        if not torch.isfinite(extent).all() or extent.max() <= 0 or extent.min() < 0:
            raise PrtError(f"hash grid bounds={bounds!r} must be finite with min below max; check the scene")

        self.levels, self.features, self.table_rows = levels, features, 1 << log2_table
        resolution = [math.floor(base_resolution * scale**level + 1e-9) for level in range(levels)]
        sides = (extent / extent.max()).tolist()
        cells = [[max(1, math.ceil(side * r - 1e-6)) for side in sides] for r in resolution]
        corners = [math.prod(n + 1 for n in axis) for axis in cells]
        # Corner counts grow with the level, so the dense levels come first.
        self.dense_levels = sum(count <= self.table_rows for count in corners)
        rows = [min(count, self.table_rows) for count in corners]
        offsets = [sum(rows[:level]) for level in range(levels)]
        # Dense levels number their corners with x fastest; hashed levels multiply by primes (equation 4).
        factors = [[1, n[0] + 1, (n[0] + 1) * (n[1] + 1)] for n in cells[: self.dense_levels]]
        factors += [list(PRIMES)] * (levels - self.dense_levels)

        per_unit = torch.tensor(resolution, dtype=torch.float64)[:, None] / extent.max()
        self.register_buffer("low", low.float(), persistent=False)
        self.register_buffer("high", high.float(), persistent=False)
        self.register_buffer("per_unit", per_unit.float(), persistent=False)
        self.register_buffer("last_cell", torch.tensor(cells) - 1, persistent=False)
        # modulo 2^32: only low bits are used
        self.register_buffer("factors", torch.tensor(factors).to(torch.int32), persistent=False)
        self.register_buffer("offsets", torch.tensor(offsets, dtype=torch.int32), persistent=False)
        table = torch.empty((sum(rows), features)).uniform_(-INITIAL, INITIAL, generator=generator)
        self.table = torch.nn.Parameter(table)

    @property
    def out_features(self) -> int:
        return self.levels * self.features

    def nbytes(self) -> int:
        """Bytes of the table as it is stored."""
        return self.table.numel() * self.table.element_size()

    def forward(self, points: Float[Tensor, "N 3"]) -> Float[Tensor, "N LF"]:
        """Features at world positions; differentiable in the table, not in the positions."""
        return self.lookup(self.corners(points))

    def locate(self, gbuffer) -> Corners:
        """:meth:`corners` of the points of a G-buffer."""
        return self.corners(gbuffer.position)

    def cells(self, points: Float[Tensor, "N 3"]) -> tuple[Int[Tensor, "N L 3"], Float[Tensor, "N L 3"]]:
        """The cell of each point at each level and the place in it, from 0 to 1."""
        inside = torch.minimum(torch.maximum(points, self.low), self.high) - self.low
        scaled = inside[:, None] * self.per_unit
        cell = torch.minimum(scaled.long(), self.last_cell)  # truncation is floor: nothing is negative
        return cell, scaled - cell

    @torch.no_grad()
    def corners(self, points: Float[Tensor, "N 3"]) -> Corners:
        """Rows and trilinear weights of the eight corners around each point at each level."""
        count = len(points)
        indices = torch.empty((count, self.levels, 8), dtype=torch.int32, device=points.device)
        weights = points.new_empty((count, self.levels, 8))
        block = BLOCK if points.device.type == "cpu" else max(count, 1)
        for start in range(0, count, block):
            rows = slice(start, start + block)
            self._fill_corners(points[rows], indices[rows], weights[rows])
        return Corners(indices, weights)

    def _fill_corners(self, points: Tensor, indices: Tensor, weights: Tensor) -> None:
        """:meth:`corners` of some points, written in place.

        One long array per axis and side: loops over a last dimension of 2 are several times slower.
        """
        cell, place = (part.permute(2, 0, 1).contiguous() for part in self.cells(points))
        near = cell.int() * self.factors.T[:, None]
        far = near + self.factors.T[:, None]
        # Masking each axis before the xor gives the same row as masking after it; products wrap around in
        # int32, which changes no low bit.
        for side in (near, far):
            side[..., self.dense_levels :] &= self.table_rows - 1
        terms, shares = (near, far), (1 - place, place)
        for x, y in itertools.product((0, 1), repeat=2):
            row_xy, share_xy = self._joined(terms[x][0], terms[y][1]), shares[x][0] * shares[y][1]
            for z in (0, 1):
                corner = 4 * x + 2 * y + z
                torch.add(self._joined(row_xy, terms[z][2]), self.offsets, out=indices[..., corner])
                torch.mul(share_xy, shares[z][2], out=weights[..., corner])

    def _joined(self, a: Int[Tensor, "N L"], b: Int[Tensor, "N L"]) -> Int[Tensor, "N L"]:
        """Partial row numbers of two axes as one: added at dense levels, xor at hashed ones."""
        out, dense = torch.empty_like(a), self.dense_levels
        torch.add(a[:, :dense], b[:, :dense], out=out[:, :dense])
        torch.bitwise_xor(a[:, dense:], b[:, dense:], out=out[:, dense:])
        return out

    def lookup(self, corners: Corners) -> Float[Tensor, "N LF"]:
        """Features from precomputed corners (any rows of them); differentiable in the table."""
        return weighted_rows(self.table, corners)

    def forward_readable(self, points: Float[Tensor, "N 3"]) -> Float[Tensor, "N LF"]:
        """The same as :meth:`forward`, one level and one corner at a time."""
        cell, place = self.cells(points)
        out = []
        for level in range(self.levels):
            feature = points.new_zeros((len(points), self.features))
            for corner in range(8):
                side = torch.tensor([corner >> 2 & 1, corner >> 1 & 1, corner & 1], device=points.device)
                weight = torch.where(side.bool(), place[:, level], 1 - place[:, level]).prod(1, keepdim=True)
                x, y, z = ((cell[:, level] + side) * self.factors[level]).unbind(1)
                row = x + y + z if level < self.dense_levels else (x ^ y ^ z) % self.table_rows
                feature = feature + weight * self.table[self.offsets[level] + row]
            out.append(feature)
        return torch.cat(out, 1)


def weighted_rows(table: Float[Tensor, "T F"], places: Corners) -> Float[Tensor, "N LF"]:
    """Weighted sums of the rows that points read, level after level; differentiable in the table."""
    count, levels, corners = places.indices.shape
    indices, weights = (part.reshape(-1, corners) for part in places)
    return WeightedRows.apply(table, indices, weights).reshape(count, levels * table.shape[1])


class WeightedRows(torch.autograd.Function):
    """Weighted sums of a few table rows each.

    The forward pass is torch's fused ``embedding_bag``. Its own backward pass sorts all indices; scattering
    one feature at a time is about 30 times faster on the CPU and stays deterministic there.
    """

    @staticmethod
    def forward(ctx, table: Tensor, indices: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(indices, weights)
        ctx.shape = table.shape
        return torch.nn.functional.embedding_bag(indices, table, mode="sum", per_sample_weights=weights)

    @staticmethod
    def backward(ctx, *gradients: Tensor):
        (gradient,) = gradients
        indices, weights = ctx.saved_tensors
        flat = indices.reshape(-1).long()
        out = gradient.new_zeros(ctx.shape)
        for feature in range(ctx.shape[1]):
            out[:, feature].scatter_add_(0, flat, (weights * gradient[:, feature, None]).reshape(-1))
        return out, None, None

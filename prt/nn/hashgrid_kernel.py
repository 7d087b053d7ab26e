"""The hash grid's lookup as one Triton kernel, for a GPU; imported only where Triton is installed.

A program reads a block of neighbouring points at one level. Blocks of one level follow one another, so that
level's table stays in the L2 cache (Mueller 2022, section 4), and features are stored feature by feature:
neighbouring threads write neighbouring numbers. Values are those of :meth:`HashGrid.forward_readable` to
rounding. Not differentiable.
"""

import torch
import triton  # pyright: ignore[reportMissingImports]
import triton.language as tl  # pyright: ignore[reportMissingImports]
from jaxtyping import Float
from torch import Tensor

from prt.nn.hashgrid import HashGrid

BLOCK = 256


@triton.jit
def _axis(points, low, high, per_unit, last_cell, factors, point, inside, level, axis: tl.constexpr):
    """What the two sides of a cell add to the row along an axis, and the place between them."""
    edge = tl.load(low + axis)
    x = tl.load(points + point * 3 + axis, mask=inside, other=0.0)
    x = tl.minimum(tl.maximum(x, edge), tl.load(high + axis)) - edge
    scaled = x * tl.load(per_unit + level)
    last = tl.load(last_cell + level * 3 + axis).to(tl.int32)
    cell = tl.maximum(tl.minimum(scaled.to(tl.int32), last), 0)  # a NaN reads a row that exists
    factor = tl.load(factors + level * 3 + axis)
    near = cell * factor  # wraps around in 32 bits, as in torch
    return near, near + factor, scaled - cell.to(tl.float32)


@triton.jit
def lookup_kernel(
    points, low, high, per_unit, last_cell, factors, offsets, table, out, count, dense_levels, row_mask,
    FEATURES: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """``out`` (L F, N) at ``points`` (N, 3); PADDED: FEATURES rounded up to a power of two."""
    level = tl.program_id(1)
    point = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    feature = tl.arange(0, PADDED)
    inside = point < count
    x0, x1, px = _axis(points, low, high, per_unit, last_cell, factors, point, inside, level, 0)
    y0, y1, py = _axis(points, low, high, per_unit, last_cell, factors, point, inside, level, 1)
    z0, z1, pz = _axis(points, low, high, per_unit, last_cell, factors, point, inside, level, 2)
    offset = tl.load(offsets + level).to(tl.int64)
    mask = inside[:, None] & (feature < FEATURES)[None, :]
    total = tl.zeros((BLOCK, PADDED), tl.float32)
    for corner in tl.static_range(8):
        x, wx = (x1, px) if corner & 4 else (x0, 1 - px)
        y, wy = (y1, py) if corner & 2 else (y0, 1 - py)
        z, wz = (z1, pz) if corner & 1 else (z0, 1 - pz)
        row = tl.where(level < dense_levels, x + y + z, (x ^ y ^ z) & row_mask).to(tl.int64) + offset
        value = tl.load(table + row[:, None] * FEATURES + feature[None, :], mask=mask, other=0.0)
        total += (wx * wy * wz)[:, None] * value
    rows = (level * FEATURES + feature).to(tl.int64)
    tl.store(out + rows[None, :] * count + point[:, None], total, mask=mask)


@torch.no_grad()
def lookup_on_gpu(grid: HashGrid, points: Float[Tensor, "N 3"]) -> Float[Tensor, "N LF"]:
    """Features at world positions; a view of an array that is stored feature by feature."""
    points = points.float().contiguous()
    count = len(points)
    out = points.new_empty((grid.out_features, count))
    if count:
        parts = (grid.low, grid.high, grid.per_unit, grid.last_cell, grid.factors, grid.offsets)
        sizes = (grid.features, triton.next_power_of_2(grid.features), BLOCK)
        lookup_kernel[(triton.cdiv(count, BLOCK), grid.levels)](
            points, *(part.contiguous() for part in parts), grid.table.detach(), out, count,
            grid.dense_levels, grid.table_rows - 1, *sizes,
        )  # fmt: skip
    return out.T

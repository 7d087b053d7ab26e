"""K-planes over space and scene variables (Fridovich-Keil 2023): a plane per pair of coordinates."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.nn.cells import cells

#: points whose factors are multiplied at a time on the CPU: their arrays stay in cache
BLOCK = 2048
#: what space planes start in (the authors' code); planes that involve a variable start at 1
INITIAL = (0.1, 0.5)


class LevelState(NamedTuple):
    """A level in one state: what is left of the planes that involve a variable."""

    lines: Float[Tensor, "3 R nF"]
    constant: Float[Tensor, "F"]


class KPlanes(torch.nn.Module):
    """Features multiplied over all (n + 3)(n + 2) / 2 planes of a level, concatenated over levels.

    K-planes (section 3) with d = n + 3 coordinates x, y, z, v_1 .. v_n: every plane is interpolated
    bilinearly (equation 1), the results are multiplied (equation 2), and resolutions ("multiscale planes")
    are concatenated; as there, only space has several.

    A frame has one state, and so has a step of training. At a state a plane of two variables is a constant
    and a plane of a coordinate and a variable a line; :meth:`at` makes both once. A point then reads three
    planes and 3 n lines a level: time is linear in n, though the planes stored are quadratic in it.

    Args:
        variables: n, at least 1.
        levels, features: number of resolutions, and F features of each.
        base_resolution, scale: cells of the coarsest level along x, y and z, and growth per level.
        variable_resolution: cells along every v_i, at all levels.
        bounds: corners of the box, world units; points outside are clamped to it, and states to [0, 1].
        generator: of the initial space planes.

    Raises:
        PrtError: for a setting out of range or bounds without extent.
    """

    def __init__(
        self,
        variables: int,
        levels: int,
        features: int,
        base_resolution: int,
        scale: float,
        variable_resolution: int,
        bounds: tuple[Sequence[float], Sequence[float]],
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        for name, value, most in (
            ("variables", variables, 64), ("levels", levels, 16), ("features", features, 64),
            ("base_resolution", base_resolution, 1 << 13),
            ("variable_resolution", variable_resolution, 1 << 13),
        ):  # fmt: skip
            if not isinstance(value, int) or not 1 <= value <= most:
                raise PrtError(f"k-planes {name}={value!r} must be an integer from 1 to {most}")
        if not scale >= 1 or base_resolution * scale ** (levels - 1) > 1 << 13:
            raise PrtError(
                f"k-planes scale={scale!r} must be at least 1 and keep the finest of {levels} levels at 8192 "
                "cells or fewer; lower scale or levels"
            )
        low, high = (torch.tensor([float(c) for c in corner], dtype=torch.float64) for corner in bounds)
        extent = high - low
        if not torch.isfinite(extent).all() or extent.max() <= 0 or extent.min() < 0:
            raise PrtError(f"k-planes bounds={bounds!r} must be finite with min below max; check the scene")
        self.variables, self.levels, self.features = variables, levels, features
        self.cells = [int(base_resolution * scale**level + 1e-9) for level in range(levels)]
        self.variable_cells = variable_resolution
        self.register_buffer("low", low.float(), persistent=False)
        # a box without extent along an axis has one place along it
        self.register_buffer("extent", extent.float().clamp_min(1e-12), persistent=False)
        pairs, along = list(itertools.combinations(range(variables), 2)), variable_resolution + 1
        self.register_buffer("pairs", torch.tensor(pairs, dtype=torch.int64).reshape(-1, 2), persistent=False)

        def initial(r: int) -> Tensor:
            return torch.empty((3 * (r + 1) ** 2, features)).uniform_(*INITIAL, generator=generator)

        # planes xy, xz, yz one below the other; place along the first coordinate, along the second, feature
        self.space = torch.nn.ParameterList(initial(r) for r in self.cells)
        # variable, coordinate, place along the variable, along the coordinate, feature
        self.mixed = torch.nn.ParameterList(
            torch.ones((variables, 3, along, r + 1, features)) for r in self.cells
        )
        # pair, place along its first variable, along its second, feature
        self.states = torch.nn.ParameterList(
            torch.ones((len(pairs), along, along, features)) for _ in self.cells
        )

    @property
    def outputs(self) -> int:
        """C = levels features."""
        return self.levels * self.features

    @property
    def factors(self) -> int:
        """Planes whose features are multiplied."""
        return (self.variables + 3) * (self.variables + 2) // 2

    def nbytes(self) -> int:
        """Bytes of all planes as they are stored."""
        return sum(p.numel() * p.element_size() for p in self.parameters())

    def at(self, v: Float[Tensor, "n"]) -> list[LevelState]:
        """Lines and constants of a state, one entry a level; differentiable in the planes."""
        row, part = cells(v, self.variable_cells)
        number = torch.arange(self.variables, device=v.device)
        pair = torch.arange(len(self.pairs), device=v.device)
        (i, j), (p, q) = row[self.pairs].T, part[self.pairs].T[..., None]
        out = []
        for mixed, states in zip(self.mixed, self.states, strict=True):
            near, far = mixed[number, :, row], mixed[number, :, row + 1]
            lines = torch.lerp(near, far, part[:, None, None, None])  # n 3 R F
            one = torch.lerp(states[pair, i, j], states[pair, i, j + 1], q)
            other = torch.lerp(states[pair, i + 1, j], states[pair, i + 1, j + 1], q)
            constant = torch.lerp(one, other, p).prod(0)  # 1 where there is a single variable
            out.append(LevelState(lines.permute(1, 2, 0, 3).flatten(2), constant))
        return out

    def forward(self, position: Float[Tensor, "N 3"], state: list[LevelState]) -> Float[Tensor, "N C"]:
        """Features at world positions in the state :meth:`at` was given; differentiable in the planes."""
        unit = ((position - self.low) / self.extent).T.contiguous()
        parts = []
        for space, level, r in zip(self.space, state, self.cells, strict=True):
            place = cells(unit, r)
            planes = _ProductOfRows.apply(space, *plane_rows(*place, r), self.features)
            lines = _ProductOfRows.apply(level.lines.flatten(0, 1), *line_rows(*place, r), self.features)
            parts.append(planes * (lines * level.constant))
        return torch.cat(parts, dim=1)

    def slow(self, position: Float[Tensor, "N 3"], v: Float[Tensor, "n"]) -> Float[Tensor, "N C"]:
        """The same as ``forward(position, at(v))``: a bilinear lookup in every plane for every point."""
        unit = ((position - self.low) / self.extent).clamp(0, 1)
        coordinates = torch.cat([unit, v.expand(len(unit), -1)], dim=1)
        parts = []
        for level, r in enumerate(self.cells):
            space = self.space[level].view(3, r + 1, r + 1, self.features)
            feature = 1.0
            for a, b in itertools.combinations(range(3 + self.variables), 2):
                x, y, resolution = coordinates[:, a], coordinates[:, b], (r, r)
                if b < 3:
                    table = space[a + b - 1]  # xy, xz, yz
                elif a < 3:
                    table = self.mixed[level][b - 3, a]
                    x, y, resolution = y, x, (self.variable_cells, r)
                else:
                    number = [*itertools.combinations(range(self.variables), 2)].index((a - 3, b - 3))
                    table, resolution = self.states[level][number], (self.variable_cells,) * 2
                (i, p), (j, q) = cells(x, resolution[0]), cells(y, resolution[1])
                p, q = p[:, None], q[:, None]
                near = (1 - q) * table[i, j] + q * table[i, j + 1]
                far = (1 - q) * table[i + 1, j] + q * table[i + 1, j + 1]
                feature = feature * ((1 - p) * near + p * far)
            parts.append(feature)
        return torch.cat(parts, dim=1)


def plane_rows(
    cell: Int[Tensor, "3 N"], part: Float[Tensor, "3 N"], r: int
) -> tuple[Int[Tensor, "3 N 4"], Float[Tensor, "3 N 4"]]:
    """Rows and bilinear weights of the planes xy, xz, yz of ``r`` cells a side, one below the other."""
    first, second = (0, 0, 1), (1, 2, 2)
    row = cell[first, :] * (r + 1) + cell[second, :]
    row += torch.arange(3, device=row.device)[:, None] * (r + 1) ** 2
    p, q = part[first, :], part[second, :]
    pq = p * q
    rows = torch.stack([row, row + 1, row + (r + 1), row + (r + 2)], dim=-1)
    return rows, torch.stack([1 - p - q + pq, q - pq, p - pq, pq], dim=-1)


def line_rows(
    cell: Int[Tensor, "3 N"], part: Float[Tensor, "3 N"], r: int
) -> tuple[Int[Tensor, "3 N 2"], Float[Tensor, "3 N 2"]]:
    """Rows and linear weights of the lines along x, y, z of ``r`` cells, one below the other."""
    row = cell + torch.arange(3, device=cell.device)[:, None] * (r + 1)
    return torch.stack([row, row + 1], dim=-1), torch.stack([1 - part, part], dim=-1)


class _ProductOfRows(torch.autograd.Function):
    """The product of interpolated features: over three lookups of a point, and over the G groups of a row.

    table (R, G F), indices and weights (3, N, K), F -> (N, F). A block of points at a time, and again in the
    backward pass: the 3 N G factors are never stored, and stay in cache. Left to autograd, the products and
    torch's backward pass of indexing take several times as long.
    """

    @staticmethod
    def forward(ctx, table: Tensor, indices: Tensor, weights: Tensor, features: int) -> Tensor:
        ctx.save_for_backward(table, indices, weights)
        ctx.features = features
        out = table.new_empty((indices.shape[1], features))
        for rows in _blocks(indices):
            x, y, z = (_looked_up(table, indices[b, rows], weights[b, rows]) for b in range(3))
            groups = (x * y * z).view(len(x), -1, features)
            if groups.shape[1] == 1:
                out[rows] = groups[:, 0]
            else:
                torch.prod(groups, 1, out=out[rows])
        return out

    @staticmethod
    def backward(ctx, *gradients: Tensor):
        (gradient,), features = gradients, ctx.features
        table, indices, weights = ctx.saved_tensors
        out = torch.zeros_like(table)
        for rows in _blocks(indices):
            x, y, z = (_looked_up(table, indices[b, rows], weights[b, rows]) for b in range(3))
            xy = x * y
            to_product = _through_product(gradient[rows], (xy * z).view(len(x), -1, features)).flatten(1)
            to_xy = to_product * z
            for b, part in enumerate((to_xy * y, to_xy * x, to_product * xy)):
                _scatter(out, indices[b, rows], weights[b, rows], part)
        return out, None, None, None


def _blocks(indices: Int[Tensor, "3 N K"]) -> list[slice]:
    """The points in blocks, or all at once on a GPU."""
    count = indices.shape[1]
    block = BLOCK if indices.device.type == "cpu" else max(count, 1)
    return [slice(start, start + block) for start in range(0, count, block)]


def _looked_up(
    table: Float[Tensor, "R D"], indices: Int[Tensor, "N K"], weights: Float[Tensor, "N K"]
) -> Float[Tensor, "N D"]:
    """Weighted sums of K rows each."""
    return torch.nn.functional.embedding_bag(indices, table, mode="sum", per_sample_weights=weights)


def _through_product(
    gradient: Float[Tensor, "N F"], factors: Float[Tensor, "N G F"]
) -> Float[Tensor, "N G F"]:
    """The gradient of each factor of ``factors.prod(1)``.

    It is the product of what stands before and after the factor: no division, so factors may be zero.
    """
    out = torch.empty_like(factors)
    before, after = gradient, torch.ones_like(gradient)
    for g in range(factors.shape[1]):
        out[:, g] = before
        before = before * factors[:, g]
    for g in reversed(range(factors.shape[1] - 1)):
        after = after * factors[:, g + 1]
        out[:, g] *= after
    return out


def _scatter(
    out: Float[Tensor, "R D"], indices: Int[Tensor, "N K"], weights: Float[Tensor, "N K"],
    gradient: Float[Tensor, "N D"],
) -> None:  # fmt: skip
    """Add to the rows of ``out`` their share of the gradient of :func:`_looked_up`."""
    for corner in range(indices.shape[1]):
        out.index_add_(0, indices[:, corner], gradient * weights[:, corner, None])

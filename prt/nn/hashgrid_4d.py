"""Multiresolution hash grid over space and one variable (Coomans 2024)."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.nn.hashgrid import INITIAL, PRIMES, HashGrid, weighted_rows

#: of the fourth coordinate; the first three are those of :data:`prt.nn.hashgrid.PRIMES`. Mueller 2022 gives
#: primes for three dimensions, the authors' code this one for the next.
FOURTH_PRIME = 3674653429


class HashGrid4d(torch.nn.Module):
    """Features of (x, y, z, v_1), interpolated between 16 corners at several resolutions.

    Coomans 2024 learns one animation with such a grid (so Su 2024, section 6.1); there is no room for a
    second variable. Level l has ``floor(base_resolution * scale**l)`` cells along the longest side of the
    bounds, and as many along v_1. A level whose corners all fit into the table is stored densely, the others
    are hashed (Mueller 2022, equation 4, with a fourth prime).

    A hash is the xor of one term a coordinate, so at a state the fourth term is one number for all points: it
    permutes the rows of a level. :meth:`at` blends the two permuted tables between which the state lies, and
    what is left is a hash grid of space, which :class:`~prt.nn.hashgrid.HashGrid` looks up from 8 corners.

    Args:
        variables: of the scene; must be 1.
        levels, features, log2_table, base_resolution, scale, bounds, generator: as of
            :class:`~prt.nn.hashgrid.HashGrid`. States are clamped to [0, 1].

    Raises:
        PrtError: for another number of variables, a setting out of range or bounds without extent.
    """

    def __init__(
        self,
        variables: int,
        levels: int,
        features: int,
        log2_table: int,
        base_resolution: int,
        scale: float,
        bounds: tuple[Sequence[float], Sequence[float]],
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        if variables != 1:
            raise PrtError(
                f"a 4D hash grid takes scenes of 1 variable, not {variables}; use another encoding or scene"
            )
        self.space = _Cells(levels, features, log2_table, base_resolution, scale, bounds)
        self.cells = [math.floor(base_resolution * scale**level + 1e-9) for level in range(levels)]
        # A dense level numbers its corners of space first, then those of the variable.
        rows = [
            count * (cells + 1) if level < self.space.dense_levels else count
            for level, (count, cells) in enumerate(zip(self.space.rows, self.cells, strict=True))
        ]
        self.offsets = [sum(rows[:level]) for level in range(levels)]
        table = torch.empty((sum(rows), features)).uniform_(-INITIAL, INITIAL, generator=generator)
        self.table = torch.nn.Parameter(table)

    @property
    def outputs(self) -> int:
        """C = levels features."""
        return self.space.out_features

    def nbytes(self) -> int:
        """Bytes of the table as it is stored."""
        return self.table.numel() * self.table.element_size()

    def at(self, v: Float[Tensor, "1"]) -> Float[Tensor, "S F"]:
        """The table of space in a state, levels one below the other; differentiable in the 4D table."""
        out, where = [], float(v.clamp(0, 1))
        for level, (first, count) in enumerate(zip(self.offsets, self.space.rows, strict=True)):
            cells = self.cells[level]
            cell = min(int(where * cells), cells - 1)
            part = where * cells - cell
            if level < self.space.dense_levels:
                near = self.table[first + cell * count : first + (cell + 1) * count]
                far = self.table[first + (cell + 1) * count : first + (cell + 2) * count]
                out.append(torch.lerp(near, far, part))
            else:
                terms = (cell * FOURTH_PRIME % count, (cell + 1) * FOURTH_PRIME % count)
                out.append(_BlendedXor.apply(self.table[first : first + count], *terms, part))
        return torch.cat(out)

    def forward(self, position: Float[Tensor, "N 3"], state: Float[Tensor, "S F"]) -> Float[Tensor, "N C"]:
        """Features at world positions in the state :meth:`at` was given; differentiable in the table."""
        return weighted_rows(state, self.space.corners(position))


class _Cells(HashGrid):
    """The hash grid of space that a 4D one is at a state: without a table, and hashed where that is.

    Attributes:
        rows: of each level.
    """

    def __init__(
        self, levels: int, features: int, log2_table: int, base_resolution: int, scale: float,
        bounds: tuple[Sequence[float], Sequence[float]],
    ):  # fmt: skip
        # its own table is dropped at once; a generator of its own leaves torch's numbers alone
        super().__init__(levels, features, log2_table, base_resolution, scale, bounds, torch.Generator())
        self.register_parameter("table", None)
        sides = (self.last_cell + 2).tolist()
        resolution = [math.floor(base_resolution * scale**level + 1e-9) for level in range(levels)]
        corners = [math.prod(side) for side in sides]
        dense = sum(c * (r + 1) <= self.table_rows for c, r in zip(corners, resolution, strict=True))
        # fewer levels are dense than in three dimensions: the others have to be hashed here as well
        self.factors[dense:] = torch.tensor(PRIMES).to(torch.int32)
        self.dense_levels = dense
        self.rows = corners[:dense] + [self.table_rows] * (levels - dense)
        offsets = [sum(self.rows[:level]) for level in range(levels)]
        self.offsets.copy_(torch.tensor(offsets, dtype=torch.int32))


class _BlendedXor(torch.autograd.Function):
    """(1 - part) T[row xor a] + part T[row xor b] for every row of a table of 2^k rows.

    Xor with a number undoes itself, so the backward pass reads rows too and adds up nothing.
    """

    @staticmethod
    def forward(ctx, table: Tensor, a: int, b: int, part: float) -> Tensor:
        ctx.blend = (a, b, part)
        return _blended(table, a, b, part)

    @staticmethod
    def backward(ctx, *gradients: Tensor):
        return _blended(gradients[0], *ctx.blend), None, None, None


def _blended(table: Float[Tensor, "R F"], a: int, b: int, part: float) -> Float[Tensor, "R F"]:
    row = torch.arange(len(table), device=table.device)
    return torch.lerp(table.index_select(0, row ^ a), table.index_select(0, row ^ b), part)

"""The hash grid's lookup in compiled C++, on the CPU: about four times faster than in torch.

torch writes the rows and weights of eight corners a point and level to memory before it reads them; the C++
keeps them in cache. Values are those of :meth:`HashGrid.forward_readable` to rounding. Not differentiable.
"""

import ctypes
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from prt.nn.compiled import library, pointer
from prt.nn.hashgrid import HashGrid

SOURCE = Path(__file__).with_name("hashgrid.cpp")


@torch.no_grad()
def lookup_compiled(grid: HashGrid, points: Float[Tensor, "N 3"]) -> Float[Tensor, "N LF"]:
    """Features at world positions, with as many threads as torch uses.

    Raises:
        PrtError: if there is no C++ compiler or it fails.
    """
    points = points.float().contiguous()
    out = points.new_empty((len(points), grid.out_features))
    parts = (grid.low, grid.high, grid.per_unit, grid.last_cell, grid.factors, grid.offsets)
    held = [points, *(part.contiguous() for part in parts), grid.table.detach(), out]
    sizes = (grid.levels, grid.features, grid.dense_levels, grid.table_rows - 1, torch.get_num_threads())
    library(SOURCE).prt_lookup(*map(pointer, held), ctypes.c_int64(len(points)), *sizes)
    return out

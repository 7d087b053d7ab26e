"""Runs the Triton kernels in Triton's interpreter, on the CPU, and prints their distances from the twins.

A program of its own: TRITON_INTERPRET=1 must be set before Triton is imported. Products of bfloat16 are left
out: the interpreter keeps such numbers as 16-bit integers and multiplies those.
"""

import json

import torch
from fused_case import FusedCase, distance

from prt.methods.wavelet_kernel import shade_on_gpu
from prt.methods.wavelet_tiles import shade_tiles
from prt.nn.hashgrid import HashGrid
from prt.nn.hashgrid_kernel import lookup_on_gpu

torch.set_num_threads(1)
found = {}
for terms, width, pixels in ((12, 40, 70), (64, 128, 33)):
    case = FusedCase(terms, width, 3, pixels)
    for kind in (torch.float32, torch.float16):
        packed = case.packed(kind)
        twin = shade_tiles(case.pixel.space, case.bias, packed, 32)
        # row by row, and feature by feature as the lookup's kernel leaves them
        for space in (case.pixel.space, case.pixel.space.T.contiguous().T):
            image = shade_on_gpu(space, case.bias, packed, tile=32)
            found[f"{terms} {width} {kind} {space.stride()}"] = distance(image, twin)
found["empty"] = float(len(shade_on_gpu(case.pixel.space[:0], case.bias[:0], packed, tile=32)))
for levels, features, log2_table in ((6, 2, 8), (5, 3, 8), (2, 4, 12)):
    grid = HashGrid(levels, features, log2_table, 4, 1.4, ((0.0, 0.0, 0.0), (1.0, 0.5, 1.0)))
    points = torch.rand((300, 3), generator=torch.Generator().manual_seed(0)) * 1.2 - 0.1
    with torch.no_grad():
        torch.nn.init.normal_(grid.table)
        found[f"grid {levels} {features}"] = distance(
            lookup_on_gpu(grid, points), grid.forward_readable(points)
        )
print(json.dumps(found))

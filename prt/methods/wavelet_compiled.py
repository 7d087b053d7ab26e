"""The folded network fused in C++, compiled at first use, for a CPU.

:mod:`prt.methods.wavelet_tiles` says what is computed and holds the readable twin. In float32 any processor
runs it; in bfloat16 it takes the matrix unit of x86 processors (AMX). There torch's own products of these
sizes reach half the rate of a large one, because their results are written and read again
(``ratio/products`` of ``prt table performance/folded``).
"""

import ctypes
import functools
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.wavelet_tiles import Packed
from prt.nn.compiled import cpu_flags, library, pointer

SOURCES = {
    torch.float32: Path(__file__).with_name("wavelet_float.cpp"),
    torch.bfloat16: Path(__file__).with_name("wavelet_amx.cpp"),
}
AMX = ("amx_tile", "amx_bf16", "avx512f", "avx512_bf16")
#: columns that the float32 code reads together
PANEL = 32


@functools.cache
def compiled_problem(kind: torch.dtype) -> str | None:
    """None where the code for a precision runs here, else why not; compiles it where that is not done yet."""
    lacking = [name for name in AMX if kind == torch.bfloat16 and name not in cpu_flags()]
    if lacking:
        return f"the processor has no {', '.join(lacking)}"
    try:
        code = library(SOURCES[kind])
    except PrtError as error:
        return str(error)
    if kind == torch.bfloat16 and not code.prt_amx_allowed():
        return "the system does not let a process use AMX"
    return None


def arranged(packed: Packed) -> Packed:
    """The weights in the order that the compiled code reads them: once per light.

    bfloat16: tiles of 32 rows and 16 columns, the rows in pairs. float32: panels of 32 columns (of the last
    layer, which has 16, all).
    """
    if packed.first.dtype == torch.bfloat16:
        first, second, last = tiles(packed.first), tiles(packed.second[None]), tiles(packed.last)
    else:
        first, second, last = panels(packed.first), panels(packed.second[None]), packed.last
    return Packed(first, second[0], packed.second_bias, last, packed.constant)


def tiles(weights: Float[Tensor, "K M H"]) -> Float[Tensor, "K MT HT 16 16 2"]:
    wavelets, rows, columns = weights.shape
    parts = weights.view(wavelets, rows // 32, 16, 2, columns // 16, 16)
    return parts.permute(0, 1, 4, 2, 5, 3).contiguous()


def panels(weights: Float[Tensor, "K M H"]) -> Float[Tensor, "K HP M 32"]:
    wavelets, rows, columns = weights.shape
    return weights.view(wavelets, rows, columns // PANEL, PANEL).transpose(1, 2).contiguous()


def shade_compiled(
    space: Float[Tensor, "N M"], bias: Float[Tensor, "N H"], packed: Packed
) -> Float[Tensor, "N 3"]:
    """Radiance of pixels, as :func:`prt.methods.wavelet_tiles.shade_tiles` gives it, with torch's threads.

    Args:
        space: S, float32; ``bias``: g, float32.
        packed: float32 or bfloat16 weights from :func:`arranged`.
    """
    space, bias = space.float().contiguous(), bias.float().contiguous()
    out = bias.new_empty((len(bias), 3))
    wavelets, width = len(packed.first), len(packed.second_bias)
    rows = packed.first[0].numel() // width
    weights = (packed.first, packed.second, packed.second_bias, packed.last)
    held = map(pointer, (space, bias, *weights, out))
    sizes = (space.shape[1], bias.shape[1], rows, width, wavelets, torch.get_num_threads())
    library(SOURCES[packed.first.dtype]).prt_shade(*held, ctypes.c_int64(len(bias)), *sizes)
    return out + packed.constant

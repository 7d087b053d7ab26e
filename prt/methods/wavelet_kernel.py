"""The folded network fused into one Triton kernel, for a GPU; imported only where Triton is installed.

:mod:`prt.methods.wavelet_tiles` says what is computed and holds the readable twin. A program keeps a tile of
pixels: their factors S and biases g stay in registers while the weights of one wavelet after the other stream
through shared memory. Of the K x pixels x H activations nothing is stored. With 64 terms, 128 neurons and K
wavelets a pixel costs K * 2 * (64 * 128 + 128 * 128 + 16 * 128) operations of matrix units, 0.9 TFLOP for
512 x 512 pixels and 64 wavelets.
"""

import functools
from typing import Any

import triton  # pyright: ignore[reportMissingImports]
import triton.language as tl  # pyright: ignore[reportMissingImports]
from jaxtyping import Float
from torch import Tensor

from prt.methods.wavelet_tiles import COLOURS, Packed

#: (pixels of a program, warps, stages of the pipeline): the fastest is found at the first call of a size
CONFIGURATIONS = ((64, 4, 2), (64, 4, 3), (64, 8, 3), (128, 4, 3), (128, 8, 2), (128, 8, 3), (128, 8, 4))


@triton.jit
def shade_kernel(
    space, bias, first, second, second_bias, last, out, count, wavelets, terms, width,
    space_row, space_column,
    TERMS: tl.constexpr, WIDTH: tl.constexpr, COLOURS: tl.constexpr, TILE: tl.constexpr,
):  # fmt: skip
    """``out`` (N, 3) of a tile of pixels, without the constant; sizes in capitals are powers of two."""
    kind: tl.constexpr = first.dtype.element_ty
    pixel = tl.program_id(0).to(tl.int64) * TILE + tl.arange(0, TILE)
    term, neuron, colour = tl.arange(0, TERMS), tl.arange(0, WIDTH), tl.arange(0, COLOURS)
    inside = (pixel < count)[:, None]
    factors = tl.load(
        space + pixel[:, None] * space_row + term[None, :].to(tl.int64) * space_column,
        mask=inside & (term < terms)[None, :], other=0.0,
    ).to(kind)  # fmt: skip
    own = tl.load(
        bias + pixel[:, None] * width + neuron[None, :], mask=inside & (neuron < width)[None, :], other=0.0
    )
    weights = tl.load(second + neuron[:, None] * WIDTH + neuron[None, :])
    shared = tl.load(second_bias + neuron)[None, :]
    first_at = first + term[:, None] * WIDTH + neuron[None, :]
    last_at = last + neuron[:, None] * COLOURS + colour[None, :]
    total = tl.zeros((TILE, COLOURS), tl.float32)
    for _ in range(wavelets):
        z = tl.maximum(tl.dot(factors, tl.load(first_at), own), 0.0).to(kind)
        y = tl.maximum(tl.dot(z, weights) + shared, 0.0).to(kind)
        total = tl.dot(y, tl.load(last_at), total)
        first_at += TERMS * WIDTH
        last_at += WIDTH * COLOURS
    tl.store(out + pixel[:, None] * 3 + colour[None, :], total, mask=inside & (colour < 3)[None, :])


@functools.cache
def tuned() -> Any:
    """The kernel with its configurations; made when first called, because it asks for a GPU."""
    configs = [
        triton.Config({"TILE": tile}, num_warps=warps, num_stages=stages)
        for tile, warps, stages in CONFIGURATIONS
    ]
    return triton.autotune(configs=configs, key=["TERMS", "WIDTH"])(shade_kernel)


def shade_on_gpu(
    space: Float[Tensor, "N M"], bias: Float[Tensor, "N H"], packed: Packed, tile: int | None = None
) -> Float[Tensor, "N 3"]:
    """Radiance of pixels, as :func:`prt.methods.wavelet_tiles.shade_tiles` gives it.

    Args:
        space: S, float32, in any layout; ``bias``: g, float32.
        tile: pixels of a program; None chooses by measuring.
    """
    count, width = bias.shape
    _, rows, columns = packed.first.shape
    out = bias.new_empty((count, 3))
    if count == 0:
        return out
    arguments = (
        space, bias.contiguous(), packed.first, packed.second, packed.second_bias, packed.last, out, count,
        len(packed.first), space.shape[1], width, space.stride(0), space.stride(1),
    )  # fmt: skip
    sizes = {"TERMS": rows, "WIDTH": columns, "COLOURS": COLOURS}
    if tile is None:
        tuned()[lambda chosen: (triton.cdiv(count, chosen["TILE"]),)](*arguments, **sizes)
    else:
        shade_kernel[(triton.cdiv(count, tile),)](*arguments, **sizes, TILE=tile)
    return out + packed.constant

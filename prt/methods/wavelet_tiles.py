"""The folded network as fused kernels compute it: a tile of pixels at a time, wavelet after wavelet.

    z_k = max(g + S F_k, 0)        y_k = max(b + z_k A, 0)        B = sum_k y_k C_k + c

S, g: the pixel's factors and its part of the first layer; F_k: the first layer folded for wavelet k; A, b:
the second layer; C_k: the last layer times the light's coefficient L_k; c: what the last bias adds. z_k and
y_k of a tile stay in registers and caches: nothing of size pixels x wavelets x neurons ever reaches memory.

Products are of bfloat16 numbers and are added up in float32; S, z_k and y_k are rounded to bfloat16. The
error against float32 is a few thousandths of an image's norm. :func:`shade_tiles` is the readable twin of the
kernels of :mod:`prt.methods.wavelet_kernel` (Triton) and :mod:`prt.methods.wavelet_compiled` (C++, which also
has one in float32).
"""

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from prt.nn.wavelet_transport import WaveletTransport

#: columns of the last layer: the three colours, filled up to the width of a matrix instruction
COLOURS = 16
#: smallest number of terms and neurons that both kernels take
LEAST = 32


@dataclasses.dataclass
class Packed:
    """A lighting's weights for a fused kernel; M and H filled up with zeros to powers of two.

    Zeros change nothing: a neuron of zero weights and bias is 0 after each layer.
    """

    first: Float[Tensor, "K M H"]
    second: Float[Tensor, "H H"]
    second_bias: Float[Tensor, "H"]
    last: Float[Tensor, "K H 16"]
    constant: Float[Tensor, "3"]


def padded(size: int) -> int:
    """The next power of two, at least :data:`LEAST`."""
    return max(LEAST, 1 << (size - 1).bit_length())


def pack(
    net: WaveletTransport, folded: Float[Tensor, "M KH"], weight: Float[Tensor, "K 3"], kind: torch.dtype
) -> Packed:
    """The weights of a lighting: once per light.

    Args:
        folded: the first layer of all wavelets, as :meth:`WaveletTransport.fold` gives it, float32.
        weight: lighting coefficients times output scales.
        kind: of the weights and of all that is multiplied.
    """
    _, second, last = net.mlp.layers
    terms, width, wavelets = net.terms, net.width, len(weight)
    rows, columns = padded(terms), padded(width)
    out = Packed(
        first=folded.new_zeros((wavelets, rows, columns), dtype=kind),
        second=folded.new_zeros((columns, columns), dtype=kind),
        second_bias=folded.new_zeros(columns),
        last=folded.new_zeros((wavelets, columns, COLOURS), dtype=kind),
        constant=weight.sum(dim=0) * last.bias,
    )
    out.first[:, :terms, :width] = folded.view(terms, wavelets, width).transpose(0, 1)
    out.second[:width, :width] = second.weight.T
    out.second_bias[:width] = second.bias
    out.last[:, :width, :3] = weight[:, None, :] * last.weight.T
    return out


def shade_tiles(
    space: Float[Tensor, "N M"], bias: Float[Tensor, "N H"], packed: Packed, tile: int = 64
) -> Float[Tensor, "N 3"]:
    """Radiance, with the operations, precisions and order of the fused kernels, in plain torch.

    Args:
        space: S of the pixels, float32.
        bias: g of the pixels, float32.
        tile: pixels at a time.
    """
    kind, (wavelets, rows, columns) = packed.first.dtype, packed.first.shape
    out = space.new_empty((len(space), 3))

    def rounded(values: Tensor) -> Tensor:
        return values.to(kind).float()

    for start in range(0, len(space), tile):
        pixels = slice(start, start + tile)
        factors, own = rounded(space[pixels]), bias[pixels]
        factors = torch.nn.functional.pad(factors, (0, rows - factors.shape[1]))
        own = torch.nn.functional.pad(own, (0, columns - own.shape[1]))
        total = space.new_zeros((len(factors), COLOURS))
        for k in range(wavelets):
            z = rounded((own + factors @ packed.first[k].float()).clamp(min=0))
            y = rounded((packed.second_bias + z @ packed.second.float()).clamp(min=0))
            total += y @ packed.last[k].float()
        out[pixels] = total[:, :3]
    return out + packed.constant

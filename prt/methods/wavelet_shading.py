"""From lighting to image with the network of Raghavan 2023: Algorithm 1, as printed and fast.

The readable form and the fast one agree to rounding; a test holds them equal. Where they can
run, the fused kernels of :mod:`prt.methods.wavelet_fused` are faster still.
"""

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.methods.wavelet_tiles import Packed
from prt.nn.wavelet_transport import PixelInputs, WaveletTransport


@dataclasses.dataclass
class WaveletCode:
    """A lighting as the K wavelets that are kept, with the first layer of the network folded for them."""

    index: Int[Tensor, "K"]
    value: Float[Tensor, "K 3"]
    folded: Float[Tensor, "M KH"]
    #: lighting coefficient times output scale, what multiplies the last hidden layer
    weight: Float[Tensor, "K 3"]
    #: all weights in the layout of a fused kernel, where one is used
    packed: Packed | None


def shade_readable(
    net: WaveletTransport, pixel: PixelInputs, code: WaveletCode, chunk: int
) -> Float[Tensor, "N 3"]:
    """B = sum_k L_k T_k with T_k evaluated as printed (Algorithm 1, lines 6 to 9)."""
    out = pixel.space.new_zeros((len(pixel.space), 3))
    for start in range(0, len(out), chunk):
        rows = slice(start, start + chunk)
        part = PixelInputs(pixel.space[rows], pixel.features[rows])
        out[rows] = torch.einsum("nkc,kc->nc", net.coefficients_readable(part, code.index), code.value)
    return out


def shade_folded(
    net: WaveletTransport, pixel: PixelInputs, code: WaveletCode, chunk: int
) -> Float[Tensor, "N 3"]:
    """The same with the first layer folded per light and the last layer applied after the sum over k.

    Of both hidden layers only ``max(z, -b)`` is computed, z the pre-activation without its bias b: since
    ``relu(z + b) = max(z, -b) + b`` and b is the same for all wavelets of a pixel, what is left out passes
    through the next layer once per pixel. The two large products run in the precision of the code, into two
    buffers that every chunk of pixels reuses: they stay in cache and are never allocated anew.
    """
    _, second, last = net.mlp.layers
    kind, wavelets, width, count = code.folded.dtype, len(code.index), net.width, len(pixel.space)
    space = pixel.space.to(kind)
    bias = net.per_pixel(pixel.features)
    next_bias = torch.addmm(second.bias, bias, second.weight.T)
    floor, next_floor = (-part.to(kind)[:, None, :] for part in (bias, next_bias))
    weight, light = second.weight.T.to(kind), code.weight.T.to(kind)
    first, hidden = space.new_empty((2, min(chunk, count) * wavelets, width))
    summed = space.new_empty((count, 3, width))
    for start in range(0, count, chunk):
        rows = slice(start, start + chunk)
        pixels = len(space[rows])
        a, b = (buffer[: pixels * wavelets] for buffer in (first, hidden))
        per_wavelet = (pixels, wavelets, width)
        torch.mm(space[rows], code.folded, out=a.view(pixels, -1))
        torch.maximum(a.view(per_wavelet), floor[rows], out=a.view(per_wavelet))
        torch.mm(a, weight, out=b)
        torch.maximum(b.view(per_wavelet), next_floor[rows], out=b.view(per_wavelet))
        torch.matmul(light, b.view(per_wavelet), out=summed[rows])
    total = code.weight.sum(dim=0)
    out = torch.einsum("nch,ch->nc", summed.float(), last.weight)
    return out + total * (next_bias @ last.weight.T + last.bias)

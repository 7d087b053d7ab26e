"""A small network with a lighting and pixels to compare fused kernels on; no size is a power of two."""

import torch

from prt.methods.wavelet_shading import WaveletCode, shade_readable
from prt.methods.wavelet_tiles import Packed, pack
from prt.nn.direction_encodings import DirectionEncoding
from prt.nn.hashgrid import HashGrid
from prt.nn.wavelet_texture import WaveletTexture
from prt.nn.wavelet_transport import PixelInputs, WaveletTransport

RESOLUTION = 8


class FusedCase:
    """``pixels`` random inputs of a network of ``terms`` and ``width``, and ``wavelets`` coefficients.

    Attributes:
        pixel, bias: S and the other inputs, and g.
        truth: the readable form in float32.
    """

    @torch.no_grad()
    def __init__(self, terms: int = 12, width: int = 40, wavelets: int = 5, pixels: int = 70):
        generator = torch.Generator().manual_seed(terms + width)
        torch.manual_seed(1)
        grid = HashGrid(terms // 2, 2, 8, 4, 1.3, ((0.0,) * 3, (1.0,) * 3))
        texture, directions = WaveletTexture(RESOLUTION, terms, False), DirectionEncoding("sh", 1, 1)
        self.net = WaveletTransport(grid, texture, directions, width).requires_grad_(False)
        for layer in self.net.mlp.layers:
            layer.bias.normal_(0, 0.3)
        self.index = torch.randperm(6 * RESOLUTION**2, generator=generator)[:wavelets]
        value = torch.randn((wavelets, 3), generator=generator)
        self.pixel = PixelInputs(
            torch.randn((pixels, terms), generator=generator),
            torch.randn((pixels, directions.outputs + 6), generator=generator),
        )
        folded = self.net.fold(self.index)
        self.code = WaveletCode(self.index, value, folded, value * self.net.scale[self.index][:, None], None)
        self.bias = self.net.per_pixel(self.pixel.features)
        self.truth = shade_readable(self.net, self.pixel, self.code, 64)

    @torch.no_grad()
    def packed(self, kind: torch.dtype) -> Packed:
        return pack(self.net, self.code.folded, self.code.weight, kind)


def distance(image: torch.Tensor, truth: torch.Tensor) -> float:
    """Norm of the difference over the norm."""
    return float((image - truth).norm() / truth.norm())

"""Recorded transport: for each pixel, where its light paths left the scene and how much they carry.

Light transport is linear, so one path-traced pass serves every environment (docs/architecture.md). The
samples of pixel p are the slice ``offsets[p]:offsets[p + 1]``; its radiance under a lighting L is the
sum of ``weight * L[texel]`` over them.
"""

import dataclasses
import warnings

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor


@dataclasses.dataclass
class Transport:
    """Sparse rows of the transport matrix, pixels times cubemap texels, one matrix per colour.

    Attributes:
        resolution: R of the cubemap, 6 x R x R texels, flat index ``(face * R + row) * R + column``.
        offsets: row starts.
        texel: flat texel index of each sample.
        weight: throughput over the number of samples per pixel (and over the pdf for next-event samples).
        bounces: surface bounces of each sample: 0 the camera ray left, 1 direct, 2 or more indirect.
    """

    resolution: int
    offsets: Int[Tensor, "P_plus_1"]
    texel: Int[Tensor, "S"]
    weight: Float[Tensor, "S 3"]
    bounces: UInt8[Tensor, "S"]

    @property
    def pixels(self) -> int:
        return self.offsets.numel() - 1

    def pixel_of_sample(self) -> Int[Tensor, "S"]:
        counts = self.offsets[1:] - self.offsets[:-1]
        return torch.repeat_interleave(torch.arange(self.pixels), counts)

    def component(self, name: str) -> "Transport":
        """The samples of ``background`` (0 bounces), ``direct`` (1), ``indirect`` (2+) or ``full`` (1+)."""
        keep = {
            "background": self.bounces == 0,
            "direct": self.bounces == 1,
            "indirect": self.bounces >= 2,
            "full": self.bounces >= 1,
        }[name]
        return self.samples(keep)

    def samples(self, keep: Bool[Tensor, "S"]) -> "Transport":
        """Some of the samples of every pixel."""
        offsets = torch.cat([torch.zeros(1, dtype=torch.int64), keep.cumsum(0)])[self.offsets]
        return Transport(self.resolution, offsets, self.texel[keep], self.weight[keep], self.bounces[keep])

    def rows(self, pixels: Int[Tensor, "N"]) -> "Transport":
        """The rows of some pixels, in the order given (a pixel may be asked for twice)."""
        start, counts = self.offsets[pixels], self.offsets[pixels + 1] - self.offsets[pixels]
        offsets = torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)])
        index = torch.arange(int(offsets[-1])) + torch.repeat_interleave(start - offsets[:-1], counts)
        return Transport(self.resolution, offsets, self.texel[index], self.weight[index], self.bounces[index])

    def relight(self, lightings: Float[Tensor, "L T 3"]) -> Float[Tensor, "L P 3"]:
        """Radiance of every pixel under L lightings given per texel (T = 6 R R)."""
        if lightings.ndim != 3 or lightings.shape[1:] != (6 * self.resolution**2, 3):
            raise ValueError(
                f"lightings of shape {tuple(lightings.shape)} do not fit transport recorded at resolution "
                f"{self.resolution}: they must be (L, {6 * self.resolution**2}, 3)"
            )
        out = torch.zeros((3, self.pixels, lightings.shape[0]))
        # 32-bit indices where they suffice: torch would otherwise convert them in every product
        index = torch.int32 if len(self.texel) < 1 << 31 else torch.int64
        offsets, texel = self.offsets.to(index), self.texel.to(index)
        size = (self.pixels, lightings.shape[1])
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparse")
            for channel in range(3) if len(texel) else ():
                weight = self.weight[:, channel].contiguous()
                matrix = torch.sparse_csr_tensor(offsets, texel, weight, size=size, check_invariants=False)
                out[channel] = matrix @ lightings[:, :, channel].T.contiguous()
        return out.permute(2, 1, 0).contiguous()

    def dense(self) -> Float[Tensor, "P T 3"]:
        """The rows as a dense matrix; for a few thousand pixels at most."""
        texels = 6 * self.resolution**2
        out = torch.zeros((self.pixels * texels, 3))
        out.index_add_(0, self.pixel_of_sample() * texels + self.texel, self.weight)
        return out.reshape(self.pixels, texels, 3)

    @staticmethod
    def concatenate(parts: list["Transport"]) -> "Transport":
        """The rows of several records one after the other."""
        ends, total = [torch.zeros(1, dtype=torch.int64)], 0
        for part in parts:
            ends.append(part.offsets[1:] + total)
            total += int(part.offsets[-1])
        return Transport(
            parts[0].resolution,
            torch.cat(ends),
            torch.cat([p.texel for p in parts]),
            torch.cat([p.weight for p in parts]),
            torch.cat([p.bounces for p in parts]),
        )

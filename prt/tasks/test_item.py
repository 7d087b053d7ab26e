"""What a method is judged on, in every task."""

import dataclasses
from typing import Any

from jaxtyping import Float
from torch import Tensor

from prt.metrics.image import PSNR_CAP
from prt.metrics.registry import evaluate
from prt.scene.gbuffer import GBuffer
from prt.trace.reference import noise_floor


@dataclasses.dataclass
class TestItem:
    """One view under one lighting, neither seen in training, with its references.

    Attributes:
        lighting: whatever the task's methods take: a cubemap (6, R, R, 3), a light rig.
        references: component to (H, W, 3) linear radiance, no background.
        noise_floor: component to the PSNR in dB that the reference has against the truth, estimated from its
            two independent halves; what the denoiser changes in both alike is not seen by it.
        direct: direct light of another seed, added to an indirect prediction to give the full image.
    """

    split: str
    view_name: str
    lighting_name: str
    lighting: Any
    gbuffer: GBuffer
    references: dict[str, Tensor]
    noise_floor: dict[str, float]
    direct: Float[Tensor, "H W 3"]


def psnr(image: Tensor, reference: Tensor) -> float:
    """PSNR in dB as every table here has it: sRGB after the reference's exposure."""
    return evaluate(image, reference, ["psnr"])["psnr"]


def floor_of(a: Float[Tensor, "H W 3"], b: Float[Tensor, "H W 3"]) -> float:
    """PSNR in dB of the mean of two independent halves against the truth.

    Capped as PSNR itself: two black halves are equal, and infinity has no mean.
    """
    return min(noise_floor(a, b, psnr), PSNR_CAP)

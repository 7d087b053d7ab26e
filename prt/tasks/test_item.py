"""What a method is judged on, in every task."""

import dataclasses
from typing import Any

from jaxtyping import Float
from torch import Tensor

from prt.scene.gbuffer import GBuffer


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

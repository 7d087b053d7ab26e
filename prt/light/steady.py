"""Which wavelets a moving light keeps, without flicker: hysteresis, and fading in and out.

Choosing the K largest coefficients anew in every frame swaps wavelets whose rank is about that of the last
one kept, and each swap is a jump (Raghavan 2023, section 6.5: "some flicker can occasionally be seen").
"""

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError


@dataclasses.dataclass
class SteadySelection:
    """A selection that goes on from that of the frame before; never more than K wavelets at a time.

    A kept wavelet leaves only when its rank falls below ``leave`` times that of the K-th largest, and what
    leaves or enters fades over ``fade`` frames. A wavelet that fades out occupies its place until it is gone,
    so that a frame always costs K evaluations.

    Args:
        count: K.
        leave: from 0 (a wavelet never leaves) to 1 (no hysteresis).
        fade: frames, 1 for none.

    Raises:
        PrtError: for a setting out of range.
    """

    count: int
    leave: float = 0.7
    fade: int = 8

    def __post_init__(self):
        if self.count < 1 or not 0 <= self.leave <= 1 or self.fade < 1:
            raise PrtError(
                f"steady selection count={self.count}, leave={self.leave}, fade={self.fade}: count and fade "
                "must be at least 1 and leave from 0 to 1"
            )
        self.level: Tensor | None = None
        self.rising = torch.zeros(0, dtype=torch.bool)

    def next(self, rank: Float[Tensor, "T"]) -> tuple[Int[Tensor, "k"], Float[Tensor, "k"]]:
        """The wavelets of the next frame and how far each is faded in, from 0 to 1.

        Args:
            rank: importance of every coefficient of the frame's lighting, at least 0.
        """
        rank = rank.cpu()
        count = min(self.count, len(rank))
        largest = rank.sort(descending=True, stable=True).indices[:count]
        if self.level is None:  # the first frame has no frame before it to differ from
            self.level = torch.zeros(len(rank))
            self.level[largest] = 1.0
            self.rising = self.level > 0
            return largest, self.level[largest]
        threshold = rank[largest[-1]]
        kept = self.level > 0
        # one that fades out comes back only when it is among the largest again
        self.rising = kept & torch.where(self.rising, rank >= self.leave * threshold, rank >= threshold)
        free = count - int(kept.sum())
        new = [int(k) for k in largest if not kept[k]][: max(free, 0)]
        self.rising[new] = True
        step = 1.0 / self.fade
        self.level = (self.level + torch.where(self.rising, step, -step)).clamp(0, 1)
        self.level[self.level < 0.5 * step] = 0.0  # sums of 1 / fade do not end at exactly 0
        index = self.level.nonzero()[:, 0]
        return index, self.level[index]

"""Surfaces with known transfer, without Mitsuba where its code is not what is tested."""

import torch

from prt.trace.surface import SurfacePoints


class Ground:
    """The plane y = 0; with ``wall``, light from x < 0 is blocked everywhere, as by an infinite wall."""

    blocked = None
    extent = 1.0
    bounds = ((-1.0, 0.0, -1.0), (1.0, 0.0, 1.0))

    def __init__(self, wall: bool = False):
        self.wall, self.counts, self.scene = wall, {}, None

    def sample(self, count, seed):
        place = 2 * torch.rand((count, 3), generator=torch.Generator().manual_seed(seed)) - 1
        place[:, 1] = 0
        return SurfacePoints(place, torch.tensor([[0.0, 1.0, 0.0]]).repeat(count, 1))

    def occluded(self, origin, direction):
        below = direction[:, 1] < 0
        return below | (direction[:, 0] < 0) if self.wall else below

    def fingerprint(self):
        return {"ground": self.wall}

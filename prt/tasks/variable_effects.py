"""What each variable of a scene changes in its images, found by path tracing two ends of it."""

import statistics
from typing import Any

import numpy as np
import torch

from prt.progress import track


def effects(task: Any, states: int, spp: int, size: int, seed: int = 11) -> dict[str, float]:
    """Root mean square change of the image from a variable's start to its end, over mean radiance.

    All else stands in a few random states. Noise is not counted: each end is rendered twice, and the mean of
    the product of two independent differences has none.

    Args:
        task: of kind ``animate``.
        states: of all other variables, for each one.
        spp, size: paths a pixel and pixels a side of an image, four for each state.

    Returns:
        The change by the variable's name, in their order; 0 for one that does nothing.
    """
    rng = np.random.default_rng(seed)
    n = task.dimension
    view = task.training_views(4, size)[1]
    found = {}
    for number, name in enumerate(track(task.stage.animation.names, "variables", n)):
        changes = []
        for _ in range(states):
            low = rng.random(n)
            high = low.copy()
            low[number], high[number] = 0.0, 1.0
            a, b = (task.render(torch.tensor(low), view, spp, k) for k in (1, 2))
            c, d = (task.render(torch.tensor(high), view, spp, k) for k in (1, 2))
            square = float(((c - a).double() * (d - b).double()).mean())
            changes.append(max(square, 0.0) ** 0.5 / (float((a + b + c + d).mean()) / 4 or 1.0))
        found[str(name)] = statistics.fmean(changes)
    return found

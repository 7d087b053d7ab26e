"""A large scene in cells, before and after merging, and rendered (Dhawal 2022, section 4.4 and figure 5)."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.benchmark_transfer import row
from prt.methods.learnt_sh import LearntSh, held_out_error
from prt.methods.stability_transfer import fitted
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.savefig import save_png

#: points drawn in the plan
DRAWN = 40_000


def figure5(
    task: Any, method: dict[str, Any], folder: Path, larger: int, views: int = 2
) -> list[dict[str, Any]]:
    """One network, one network a cell, and merged cells, at equal size and steps; and one larger network.

    Writes ``plan.png`` and ``render.png`` into ``folder``.

    Args:
        larger: neurons of the larger network.
        views: of the render.

    Raises:
        PrtError: if the method's scene is not cut, or no cells are to be merged.
    """
    if method.get("cells") is None or method.get("networks") is None:
        raise PrtError(
            "method.cells and method.networks must both be set: figure 5 cuts a scene and merges cells"
        )
    forms = {
        "one": {"cells": None, "networks": None},
        "larger": {"cells": None, "networks": None, "neurons": larger},
        "cells": {"networks": None},
        "merged": {},
    }
    rows, models = [], {}
    for name, changes in forms.items():
        model = fitted(task, method, **changes)
        models[name] = model
        variant = f"networks={name}"
        rows += [
            row("error/held_out", held_out_error(task, model), variant),
            row("bytes/model", model.nbytes(), variant), row("networks/used", len(model.nets), variant),
        ]  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    plan(task, models, folder / "plan.png")
    render(task, models["merged"], folder / "render.png", views)
    return rows


def plan(task: Any, models: dict[str, LearntSh], path: Path) -> None:
    """The scene from above, its points coloured by the network that serves them."""
    from matplotlib.figure import Figure

    position = task.training().points.position[:DRAWN]
    # from above: what is below is drawn first
    position = position[position[:, 1].argsort()].contiguous()
    figure = Figure(figsize=(11, 5), layout="constrained")
    for axis, name in zip(figure.subplots(1, 2), ("cells", "merged"), strict=True):
        group = models[name].group_of(position)
        height = (position[:, 1] - position[:, 1].min()) / (position[:, 1].max() - position[:, 1].min())
        colour = hues(int(group.max()) + 1)[group.numpy()] * (0.45 + 0.55 * height.numpy()[:, None])
        axis.scatter(position[:, 0], position[:, 2], s=0.6, c=colour, linewidths=0)
        axis.set_aspect("equal")
        axis.set_title(f"{len(models[name].nets)} networks, {name}")
        axis.set_xlabel("x")
        axis.invert_yaxis()
    save_png(figure, path, dpi=100)


def hues(count: int) -> Float[np.ndarray, "N 3"]:
    """Colours that are easily told apart."""
    from matplotlib import colormaps

    return np.array([colormaps["tab20"](k % 20)[:3] for k in range(count)])


def render(task: Any, model: LearntSh, path: Path, views: int) -> None:
    """Views of the far trajectories: which network serves a pixel, white light, and a test environment."""
    from matplotlib.figure import Figure

    size, white = task.size, torch.ones((6, task.resolution, task.resolution, 3))
    light = task.lighting.test()[1][0]
    figure = Figure(figsize=(10, 3.4 * views), layout="constrained")
    axes = figure.subplots(views, 3, squeeze=False)
    for line, view in zip(axes, task.scene.views("far", views, size), strict=True):
        gbuffer = task.dressed(task.surface.capture(view), "diffuse")
        colour = torch.from_numpy(hues(len(model.nets))).float()[model.group_of(gbuffer.position)]
        grey = model.shade(gbuffer, model.light(white)).mean(1, keepdim=True).clamp(0, 1)
        pictures = [
            (gbuffer.image(colour * (0.3 + 0.7 * grey)).numpy() ** (1 / 2.2), "network"),
            (shown(gbuffer.image(model.shade(gbuffer, model.light(white)))), "white light"),
            (shown(gbuffer.image(model.shade(gbuffer, model.light(light)))), task.lighting.test()[0][0]),
        ]
        for axis, (picture, title) in zip(line, pictures, strict=True):
            axis.imshow(np.clip(picture, 0, 1))
            axis.set_title(title)
            axis.axis("off")
    save_png(figure, path, dpi=100)


def shown(image: Float[Tensor, "H W 3"]) -> np.ndarray:
    """Exposed by itself, sRGB."""
    return to_srgb(image.clamp_min(0), exposure_of(image.clamp_min(0).numpy()))

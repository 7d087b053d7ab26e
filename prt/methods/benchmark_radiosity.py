"""Dynamic radiosity measured where one fit serves several figures (Su 2024, figures 7, 10 and 11), and what
the variables of a scene do.

Called by ``prt table su2024/figure7`` and the like.
"""

import copy
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Silent
from prt.methods.dynamic_radiosity import DynamicRadiosity, Residual
from prt.metrics.registry import evaluate
from prt.metrics.timing import device_name, time_repeated
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.progress import track
from prt.savefig import save_png
from prt.tasks.test_item import TestItem
from prt.tasks.variable_effects import effects
from prt.trace.surface_states import SurfaceStates

NAME = "dynamic_radiosity"
#: repetitions of a timing: slow frames that are compared by factors of ten
REPETITIONS = 5


def row(metric: str, value: float, variant: str, method: str = NAME, n: int = 1) -> dict[str, Any]:
    """A row of ``results.csv``; times and sizes are of the whole method, all else is of full radiance."""
    timed = metric.startswith("time/")
    device = f"{device_name()}, {torch.get_num_threads()} threads" if timed else ""
    component = "" if metric.startswith(("time/", "bytes/", "steps/")) else "full"
    found = {"method": method, "device": device, "variant": variant, "metric": metric}
    return {**found, "component": component, "value": float(value), "lo": None, "hi": None, "n": n}


def fitted(task: Any, method: dict[str, Any], **changes: Any) -> DynamicRadiosity:
    """The method with some settings changed, fitted to the task."""
    model = DynamicRadiosity(**{**copy.deepcopy(method), **changes})
    model.fit(task, Silent(), 0, "cpu")
    return model


def image_of(model: DynamicRadiosity, item: TestItem) -> Float[Tensor, "H W 3"]:
    return item.gbuffer.image(model.shade(item.gbuffer, model.light(item.lighting)))


def mape_of(model: DynamicRadiosity, items: list[TestItem]) -> float:
    """Mean over test items."""
    found = [evaluate(image_of(model, i), i.references["full"], ["mape"])["mape"] for i in items]
    return statistics.fmean(found)


def renderings(
    task: Any, model: DynamicRadiosity, folder: Path, right_hand: list[int], pixel_samples: list[int]
) -> list[dict[str, Any]]:
    """One network shown in several ways: its own values, the right-hand side with more and more directions
    (figure 7), more rays a pixel (figure 11). Writes ``renderings.png`` into ``folder``."""
    items = task.tests()
    shown = items[0]
    exposure = exposure_of(shown.references["full"].numpy())
    pictures = [("reference", shown.references["full"])]
    rows = []
    ways = [("left_hand=1", {"right_hand": 0, "pixel_samples": 1})]
    ways += [(f"right_hand={m}", {"right_hand": m, "pixel_samples": 1}) for m in right_hand]
    ways += [(f"pixel_samples={s}", {"right_hand": 0, "pixel_samples": s}) for s in pixel_samples]
    for variant, settings in track(ways, "renderings", len(ways)):
        for name, value in settings.items():
            setattr(model, name, value)
        rows.append(row("mape", mape_of(model, items), variant, n=len(items)))
        code = model.light(shown.lighting)
        taken = time_repeated(lambda code=code: model.shade(shown.gbuffer, code), REPETITIONS, warmup=1)
        rows.append(row("time/shade", taken.median, variant))
        pictures.append((variant, image_of(model, shown)))
    strip(pictures, exposure, folder / "renderings.png")
    return rows


def strip(pictures: list[tuple[str, Tensor]], exposure: float, path: Path) -> None:
    """Pictures side by side with their names, below them the differences from the first, four times."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.9 * len(pictures), 4.1), layout="constrained")
    axes = figure.subplots(2, len(pictures), squeeze=False)
    first = to_srgb(pictures[0][1].numpy(), exposure)
    for column, (name, picture) in enumerate(pictures):
        image = to_srgb(np.nan_to_num(picture.numpy()), exposure)
        axes[0][column].imshow(image, interpolation="nearest")
        axes[0][column].set_title(name.replace("_", " "), fontsize=8)
        axes[1][column].imshow(np.clip(4 * np.abs(image - first), 0, 1), interpolation="nearest")
        for axis in (axes[0][column], axes[1][column]):
            axis.set(xticks=[], yticks=[])
    axes[1][0].set_title("difference x 4", fontsize=8)
    save_png(figure, path, dpi=150)


def fine_tuning(
    task: Any, model: DynamicRadiosity, method: dict[str, Any], change: float, steps: list[int]
) -> list[dict[str, Any]]:
    """Neural radiosity of one state, carried on after a small change of it (figure 10).

    Both have the same network sizes and the same number of steps for their first fit. ``steps/needed`` is the
    first of ``steps`` at which the fine-tuned network is no worse than dynamic radiosity; where there is none
    the row is missing.

    Args:
        model: dynamic radiosity, fitted; ``method``: its settings.
        change: how far every variable moves, from 0.5.
        steps: of fine-tuning, at which the error is measured; ascending from 0.

    Raises:
        PrtError: for a scene without variables, or a test state that is not the changed one.
    """
    if task.dimension == 0:
        raise PrtError("figure 10 changes the state: the scene needs at least one variable")
    before = [0.5] * task.dimension
    after = [0.5 + change] * task.dimension
    items = [item for item in task.tests() if item.split == "given"]
    if not items or not torch.allclose(items[0].lighting, torch.tensor(after)):
        raise PrtError(f"figure 10 is judged in the changed state: set task.given=[{after}]")
    ours = mape_of(model, items)
    rows = [row("mape", ours, "")]
    static = fitted(task, method, encoding="static", static_state=before)
    needed = None
    taken, seconds = 0, 0.0
    tuning = Tuning(task, static, after)
    for goal in steps:
        seconds += tuning.go_on(goal - taken)
        taken = goal
        error = mape_of(static, items)
        rows.append(row("mape", error, f"steps={goal}", "static_radiosity"))
        rows.append(row("time/tuning", seconds, f"steps={goal}", "static_radiosity"))
        if needed is None and error <= ours:
            needed = goal
    if needed is not None:
        rows.append(row("steps/needed", needed, "", "static_radiosity"))
    return rows


class Tuning:
    """A static network that is carried on in another state: with one optimiser and generator."""

    def __init__(self, task: Any, model: DynamicRadiosity, state: list[float]):
        model.static_state = list(state)
        task.stage.set(state)
        self.residual = Residual(
            model, SurfaceStates(task.stage.mi_scene, task.walk_views()), task.dimension,
            torch.Generator().manual_seed(1),
        )  # fmt: skip
        # the directions that the fit had in the end, and rates as at its beginning, once decayed
        self.residual.step = model.training["steps"]
        self.optimiser = model.optimiser(model.training["decay"])

    def go_on(self, steps: int) -> float:
        """So many further steps; returns the seconds taken."""
        started = time.monotonic()
        for _ in range(steps):
            self.optimiser.zero_grad(set_to_none=True)
            self.residual.loss().backward()
            self.optimiser.step()
        return time.monotonic() - started


def variables(task: Any, states: int, spp: int, size: int, seed: int = 11) -> list[dict[str, Any]]:
    """How much of the image each variable changes, by path tracing, and what moving it costs.

    ``change/image``: :func:`prt.tasks.variable_effects.effects`. ``time/move``: one change of this variable
    alone.
    """
    rows = []
    for number, (name, change) in enumerate(effects(task, states, spp, size, seed).items()):
        rows.append(row("change/image", change, f"variable={name}", n=states))
        at = [np.full(task.dimension, 0.5), np.full(task.dimension, 0.5)]
        at[1][number] = 0.9

        def there_and_back(at: list = at) -> None:
            for v in at:
                task.stage.set(v.tolist())

        taken = time_repeated(there_and_back, REPETITIONS, 1).median / 2
        rows.append(row("time/move", taken, f"variable={name}"))
    return rows

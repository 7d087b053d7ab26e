"""A finished run opened again, for pictures of any view under any light."""

import dataclasses
import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.bench.build import build
from prt.bench.evaluate import denoised
from prt.bench.figure import ERROR_END
from prt.bench.run import build_task
from prt.bench.run_folder import RunFolder
from prt.errors import PrtError
from prt.metrics.tonemap import to_srgb
from prt.scene.view import View
from prt.tasks.free_views import FreeView, free_view


@dataclasses.dataclass(frozen=True)
class Frame:
    """One picture.

    Attributes:
        image: linear radiance of the component that is shown.
        seconds: what the method took, lighting and shading; not the G-buffer, nor direct light that is added.
    """

    image: Float[Tensor, "H W 3"]
    seconds: float


class Playback:
    """A run's scene, lights and fitted method.

    Args:
        path: folder of a finished run.
        component: what is shown; by default the whole image where the task has one. Direct light is traced
            and denoised where the method predicts indirect light alone.

    Raises:
        PrtError: for a folder without a finished run, or a component that cannot be shown.
    """

    def __init__(self, path: Path, component: str | None = None):
        self.folder = RunFolder(path)
        self.cfg = self.folder.config()
        if not self.folder.done:
            raise PrtError(f"{path} is {self.folder.state()}, not done; `prt run` with its settings ends it")
        self.task = build_task(self.cfg)
        self.free: FreeView = free_view(self.task)
        self.model = build(self.cfg, "method")
        self.model.load(self.folder.checkpoint, self.task, str(self.cfg.device))
        self.own = str(self.model.component.value)
        possible = [self.own, *(["full"] if self.own == "indirect" else [])]
        self.component = component or possible[-1]
        if self.component not in possible:
            raise PrtError(f"component={self.component}: this run shows {' or '.join(possible)}")

    @property
    def name(self) -> str:
        """The run as people call it."""
        return f"{self.cfg.choice.method} on {self.cfg.choice.scene}"

    def lighting(self, name: str | None = None) -> Any:
        """A test lighting by name, the first by default.

        Raises:
            PrtError: for a name that is none of them.
        """
        known = self.free.lightings
        if name is not None and name not in known:
            raise PrtError(f"no lighting {name!r}; choose from {', '.join(known)}")
        return known[name] if name is not None else next(iter(known.values()))

    def view(self, size: int) -> View:
        """Where the first test camera stands."""
        return self.task.scene.views("far", 1, size)[0]

    def turntable(self, frames: int, size: int) -> list[View]:
        """Views along the first trajectory of test cameras, from its beginning to its end."""
        path = self.task.scene.cameras["far"][0]
        return [view.resized(size, size) for view in path([k / frames for k in range(frames)])]

    @torch.no_grad()
    def frame(self, view: View, lighting: Any, direct_spp: int = 16) -> Frame:
        """The method's picture."""
        gbuffer = self.free.look(view, lighting)
        started = time.perf_counter()
        code = self.model.light(lighting.to(str(self.cfg.device)))
        radiance = self.model.shade(gbuffer.to(str(self.cfg.device)), code).detach().float().cpu()
        seconds = time.perf_counter() - started
        image = gbuffer.image(radiance)
        if self.component != self.own:
            direct = self.free.trace(view, lighting, direct_spp, 1)["direct"]
            image = image + denoised(direct, gbuffer)
        return Frame(image, seconds)

    def reference(self, view: View, lighting: Any, spp: int, seed: int = 1) -> Float[Tensor, "H W 3"]:
        """The path-traced picture of the same component."""
        return self.free.trace(view, lighting, spp, seed)[self.component]


def to_bytes(image: Float[Tensor, "H W 3"], exposure: float) -> np.ndarray:
    """sRGB of a linear image, (H, W, 3) bytes; what is not finite is magenta."""
    linear = image.numpy()
    bad = ~np.isfinite(linear).all(axis=-1)
    shown = (to_srgb(np.where(bad[..., None], 0.0, linear), exposure) * 255 + 0.5).astype(np.uint8)
    shown[bad] = (255, 0, 255)
    return shown


def difference(
    image: Float[Tensor, "H W 3"], reference: Float[Tensor, "H W 3"], exposure: float
) -> np.ndarray:
    """The error map as figures have it, (H, W, 3) bytes: absolute error of what is displayed."""
    error = np.abs(to_srgb(image.numpy(), exposure) - to_srgb(reference.numpy(), exposure)).mean(axis=-1)
    share = np.clip(np.where(np.isfinite(error), error / ERROR_END, 1.0), 0, 1)
    return (matplotlib.colormaps["magma"](share)[..., :3] * 255 + 0.5).astype(np.uint8)

"""Path tracing at equal time: a method whose fit only finds out how many samples a frame's time allows.

The comparison of Raghavan 2023, figures 5 and 8: the renderer's own ``path`` integrator with emitter
sampling, with or without Open Image Denoise, given as long per frame as the precomputed method takes.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Component, FitLog
from prt.scene.gbuffer import GBuffer
from prt.trace.denoise import denoise
from prt.trace.reference import render

#: added to the run's seed: no reference is rendered with the random numbers of a method under test
FIRST_SEED = 2_000_000
MOST_SAMPLES = 1 << 14
REPETITIONS = 5


class PathTraced:
    """The method; settings as in ``conf/method/path_traced.yaml``.

    The indirect image is the full image less the direct one, traced with the same random numbers
    (:meth:`prt.trace.reference.ReferenceRenderer.render`); the time of both counts, and so does denoising.

    Args:
        frame_seconds: time one frame may take at the task's test image size; fit measures how many samples
            per pixel that allows (at least 1, even where one sample takes longer). None: use ``samples``.
        samples: samples per pixel, where the count and not the time is given.
        denoise: whether the image is denoised, guided by the colours and normals of the G-buffer.
    """

    component = Component.INDIRECT
    tasks = frozenset({"relight_indirect", "animate"})

    def __init__(self, frame_seconds: float | None, samples: int | None = None, denoise: bool = False):
        if (frame_seconds is None) == (samples is None):
            raise PrtError(
                f"method.frame_seconds={frame_seconds} and method.samples={samples}: give exactly one "
                "and null for the other"
            )
        if frame_seconds is not None and not 0 < frame_seconds < float("inf"):
            raise PrtError(f"method.frame_seconds={frame_seconds} must be a positive number of seconds")
        if samples is not None and (not isinstance(samples, int) or not 1 <= samples <= MOST_SAMPLES):
            raise PrtError(f"method.samples={samples!r} must be an integer from 1 to {MOST_SAMPLES}")
        self.frame_seconds, self.samples, self.denoise = frame_seconds, samples, denoise
        self.scene: Any = None
        self.task: Any = None
        self.seed = FIRST_SEED

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Measure how many samples per pixel fit into ``frame_seconds``, on the task's first test view."""
        self._use(task)
        self.seed = FIRST_SEED + seed
        kept = log.resume()
        log.start(1, "path_traced")
        if kept is not None:
            self.samples = int(kept[1]["samples"])
            return
        if self.frame_seconds is not None:
            item = task.tests()[0]
            code = self.light(item.lighting)

            def frame(samples: int) -> None:
                self.samples = samples
                self.shade(item.gbuffer, code)

            self.samples = affordable_samples(frame, self.frame_seconds)
        log.step(1, samples=float(self.samples))
        log.save(1, {"samples": self.samples})

    def _use(self, task: Any) -> None:
        self.scene, self.task = task.scene, task
        if task.name == "animate":
            self.component = Component.FULL

    # ---- rendering

    def light(self, lighting: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Nothing is precomputed: the code is the lighting, or the state of a scene that moves."""
        return lighting.detach().cpu()

    def shade(
        self, gbuffer: GBuffer, code: Float[Tensor, "..."], v: Tensor | None = None
    ) -> Float[Tensor, "N 3"]:
        """Indirect radiance of the pixels of the G-buffer's view; full radiance in task animate.

        Raises:
            PrtError: for a G-buffer that belongs to no image, or before ``fit`` or ``load``.
        """
        if self.scene is None or self.samples is None:
            raise PrtError("path_traced has no scene yet; fit it or load a checkpoint first")
        if gbuffer.view is None:
            raise PrtError("path_traced renders whole images: give the G-buffer of a view, not single points")
        if len(gbuffer) == 0:
            return torch.zeros((0, 3))
        if self.component is Component.FULL:
            image = self.task.render(code, gbuffer.view, self.samples, self.seed)
        else:
            depth = self.scene.max_depth
            image = render(self.scene, gbuffer.view, code, self.samples, depth, self.seed)["indirect"]
        if self.denoise:
            image = denoise(image, **gbuffer.to("cpu").guides())
        return image.reshape(-1, 3)[gbuffer.hit.cpu()]

    # ---- storage

    def nbytes(self) -> int:
        """Nothing is stored beside the scene itself."""
        return 0

    def save(self, path: Path) -> None:
        save_file({"samples": torch.tensor(self.samples), "seed": torch.tensor(self.seed)}, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        state = load_file(path)
        self._use(task)
        self.samples, self.seed = int(state["samples"]), int(state["seed"])


def affordable_samples(frame: Callable[[int], None], seconds: float) -> int:
    """The most samples per pixel for which ``frame(samples)`` takes no longer than ``seconds``, at least 1.

    Doubles the count until a frame takes longer, then interpolates: time is affine in the sample count.
    """

    def measure(samples: int) -> float:
        frame(samples)  # kernels and memory of this size
        times = []
        for _ in range(REPETITIONS):
            start = time.perf_counter()
            frame(samples)
            times.append(time.perf_counter() - start)
        return statistics.median(times)

    samples, taken = 1, measure(1)
    while taken < seconds and samples < MOST_SAMPLES:
        fewer, before = samples, taken
        samples *= 2
        taken = measure(samples)
        if taken >= seconds:
            share = (seconds - before) / (taken - before)
            return int(fewer + share * (samples - fewer))
    return samples

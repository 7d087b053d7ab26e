"""What recording transport costs against rendering: paths per second, cost of a training set, variance.

``prt table performance/record`` runs it, once per scene.

All of it is measured in one run on one machine, record and renderer in turn, so that another load on the
machine meets both. The renderer is Mitsuba's ``path`` with emitter sampling on the same scene, view, number
of paths, depth and variant.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.environments import EnvironmentSet
from prt.metrics.timing import device_name
from prt.progress import Bar
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.trace.cubemap_emitter import set_lighting
from prt.trace.record import record
from prt.trace.reference import ReferenceRenderer

WARM_UP = 3
COST_REPETITIONS = 3
RESAMPLES = 1000
MODES = ("bsdf", "nee")


def benchmark(
    scene: Scene,
    lighting: EnvironmentSet,
    maps: Sequence[str] = ("indoor", "outdoor"),
    size: int = 64,
    spp: int = 64,
    lights: int = 64,
    repetitions: int = 30,
    variance_spp: int = 64,
    variance_seeds: int = 16,
    view: View | None = None,
) -> list[dict[str, Any]]:
    """Measure the recorder on one scene.

    Args:
        scene: what is recorded; its ``max_depth`` is used.
        lighting: its training environments light the training set of ``lights`` images (in turn where there
            are fewer), and their mean is the prior of next-event samples; variance is taken under its tests.
        maps: what its first test environments are called in the results.
        size: images of ``size`` x ``size`` pixels; ``view`` or the scene's first far view.
        spp: paths per pixel of everything that is timed.
        repetitions: of each timing of one record and one image, after warming up.
        variance_spp, variance_seeds: samples per pixel and independent images a variance is estimated from.

    Returns:
        Rows with ``method`` (``record``), ``device``, ``variant`` (the recorder's mode, and the map),
        ``component, metric, value, lo, hi, n``. Metrics, of which more is better for the recorder:
        ``ratio/paths``: paths per second of ``record``, rows brought into order, over those of ``mi.render``;
        median over pairs of calls, 95 % bootstrap interval.
        ``ratio/cost``: seconds to set and render ``lights`` lightings one by one over seconds to record once
        and relight as many, at equal paths; median, smallest and largest of three.
        ``ratio/variance``: variance of a rendered image's pixels over that of a relit one's at equal paths,
        both means over the image; 95 % bootstrap interval over seeds.
        ``paths/record``, ``paths/render``: paths per second.

    Raises:
        PrtError: if a number is below what the measure needs, or the lighting has fewer tests than ``maps``.
    """
    least = {"size": 1, "spp": 1, "lights": 1, "repetitions": 3, "variance_spp": 1, "variance_seeds": 3}
    given = (size, spp, lights, repetitions, variance_spp, variance_seeds)
    for (name, lowest), value in zip(least.items(), given, strict=True):
        if value < lowest:
            raise PrtError(f"record benchmark {name}={value} must be at least {lowest}")
    view = (view or scene.views("far", 1, size)[0]).resized(size, size)
    (_, train), (names, tests) = lighting.train(), lighting.test()
    if len(names) < len(maps):
        raise PrtError(
            f"record benchmark maps={list(maps)}, but the lighting has {len(names)} test environments; "
            "raise lighting.test_count (hdri) or lighting.test_rooms and test_skies (procedural)"
        )
    setup = Setup(scene, view, train, lights)
    common = {"method": "record", "device": renderer_device()}
    steps = len(MODES) * (repetitions + WARM_UP) + COST_REPETITIONS + len(maps) * variance_seeds
    rows: list[dict[str, Any]] = []
    with Bar(f"record benchmark, {scene.name}", steps) as bar:
        for mode in MODES:
            for row in setup.speed(mode, spp, repetitions, bar):
                rows.append({**common, "variant": f"mode={mode}", "component": "full", **row})
        for mode, row in setup.cost(spp, bar):
            rows.append({**common, "variant": f"mode={mode}", "component": "full", **row})
        for name, cubemap in zip(maps, tests, strict=False):
            for mode, part, row in setup.variance(cubemap, variance_spp, variance_seeds, bar):
                rows.append({**common, "variant": f"mode={mode},map={name}", "component": part, **row})
    return rows


class Setup:
    """One scene, loaded for the recorder and for the renderer."""

    def __init__(self, scene: Scene, view: View, train: Float[Tensor, "n 6 R R 3"], lights: int):
        self.view, self.max_depth, self.resolution = view, scene.max_depth, train.shape[2]
        self.lightings = train[torch.arange(lights) % len(train)]
        self.prior = {"bsdf": None, "nee": train.mean(0)}
        self.empty = scene.load()
        self.renderer = ReferenceRenderer(scene, self.resolution)
        self.sensor = mitsuba().load_dict(sensor_description(view))
        set_lighting(self.renderer.mi_scene, self.lightings[0])

    def record(self, mode: str, spp: int, seed: int):
        return record(
            self.empty, self.view, spp, self.max_depth, self.resolution, seed, prior=self.prior[mode]
        )

    def render(self, spp: int, seed: int, component: str = "full") -> np.ndarray:
        """One image with the lighting that is set."""
        integrator = self.renderer.integrators[component]
        image = mitsuba().render(
            self.renderer.mi_scene, sensor=self.sensor, integrator=integrator, spp=spp, seed=seed
        )
        return np.array(image, dtype=np.float64)

    def speed(self, mode: str, spp: int, repetitions: int, bar: Bar) -> Iterator[dict[str, Any]]:
        """Paths per second of both, call by call in turn."""
        seconds = []
        for number in range(repetitions + WARM_UP):
            pair = (
                timed(lambda n=number: self.record(mode, spp, n)),
                timed(lambda n=number: self.render(spp, n)),
            )
            seconds.append(pair)
            bar.advance()
        recorded, rendered = np.array(seconds[WARM_UP:]).T
        paths = self.view.width * self.view.height * spp
        yield median("ratio/paths", rendered / recorded)
        yield median("paths/record", paths / recorded)
        yield median("paths/render", paths / rendered)

    def cost(self, spp: int, bar: Bar) -> Iterator[tuple[str, dict[str, Any]]]:
        """Images of all lightings: one record relit, in each mode, against one rendering each."""
        flat = self.lightings.reshape(len(self.lightings), -1, 3)

        def relit(mode: str, seed: int) -> None:
            self.record(mode, spp, seed).component("full").relight(flat)

        def rendered(seed: int) -> None:
            for number, lighting in enumerate(self.lightings):
                set_lighting(self.renderer.mi_scene, lighting)
                self.render(spp, seed + number)

        ratios: dict[str, list[float]] = {mode: [] for mode in MODES}
        for mode in MODES:
            relit(mode, 0)
        for number in range(COST_REPETITIONS):
            once = {
                mode: float(np.median([timed(lambda m=mode, n=number: relit(m, n)) for _ in range(3)]))
                for mode in MODES
            }
            images = timed(lambda n=number: rendered(n))
            for mode in MODES:
                ratios[mode].append(images / once[mode])
            bar.advance()
        for mode, found in ratios.items():
            yield mode, row("ratio/cost", float(np.median(found)), min(found), max(found), len(found))

    def variance(
        self, lighting: Tensor, spp: int, seeds: int, bar: Bar
    ) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Variance of rendered images over that of relit ones, per mode and component."""
        set_lighting(self.renderer.mi_scene, lighting)
        flat = lighting.reshape(1, -1, 3)
        images: dict[tuple[str, str], list[np.ndarray]] = {}
        for seed in range(seeds):
            full, direct = self.render(spp, seed), self.render(spp, seed, "direct")
            images.setdefault(("render", "full"), []).append(full)
            images.setdefault(("render", "indirect"), []).append(
                full - direct
            )  # same seed: no noise of direct
            for mode in MODES:
                transport = self.record(mode, spp, 10_000 + seed)
                for part in ("full", "indirect"):
                    images.setdefault((mode, part), []).append(
                        transport.component(part).relight(flat)[0].double().numpy()
                    )
            bar.advance()
        spread = {key: deviations(np.stack(stack)) for key, stack in images.items()}
        for mode in MODES:
            for part in ("full", "indirect"):
                yield mode, part, ratio_of_means(spread["render", part], spread[mode, part])


def renderer_device() -> str:
    """What Mitsuba renders on, in words."""
    cuda = mitsuba().variant().startswith("cuda")
    import drjit as dr  # only after Mitsuba has been set up

    return device_name("cuda") if cuda else f"{device_name()}, {dr.thread_count()} threads"


def timed(function: Callable[[], object]) -> float:
    """Seconds of one call; both sides end with their numbers in host memory: nothing is left to wait for."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def deviations(images: np.ndarray) -> np.ndarray:
    """Per image its mean squared distance from the mean of all, unbiased for the variance: ``(n,)``."""
    n = len(images)
    return ((images - images.mean(0)) ** 2).reshape(n, -1).mean(1) * n / (n - 1)


def ratio_of_means(a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """``ratio/variance`` with its bootstrap interval over seeds."""
    random = np.random.default_rng(0)
    draws = [np.mean(random.choice(a, len(a))) / np.mean(random.choice(b, len(b))) for _ in range(RESAMPLES)]
    lo, hi = np.percentile(draws, [2.5, 97.5])
    return row("ratio/variance", float(a.mean() / b.mean()), float(lo), float(hi), len(a))


def median(metric: str, values: np.ndarray) -> dict[str, Any]:
    """The median with its 95 % bootstrap interval."""
    random = np.random.default_rng(0)
    draws = [np.median(random.choice(values, len(values))) for _ in range(RESAMPLES)]
    lo, hi = np.percentile(draws, [2.5, 97.5])
    return row(metric, float(np.median(values)), float(lo), float(hi), len(values))


def row(metric: str, value: float, lo: float, hi: float, n: int) -> dict[str, Any]:
    return {"metric": metric, "value": value, "lo": lo, "hi": hi, "n": n}

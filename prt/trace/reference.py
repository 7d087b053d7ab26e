"""Reference images, made by the renderer's own ``path`` integrator and emitter sampling, not by the recorder.

Known limit: where a *fractionally* transparent mask stands before the background, ``hide_emitters`` also
discards the emitter samples taken on the mask, and it comes out too dark (the image by 2 percent in a test
with a sphere of opacity 0.4). Masks of opacity 0 or 1 are exact. The recorder keeps those samples.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.trace.cubemap_emitter import scene_with_lighting, set_lighting

#: Paths traced at a time: bounds the memory.
WAVEFRONT = 1 << 22
COMPONENTS = ("full", "direct", "indirect")


class ReferenceRenderer:
    """A scene loaded once and rendered under many lightings and from many views.

    Args:
        scene: what is looked at.
        resolution: R of the lightings.
        max_depth: surface bounces D of the ``full`` image; by default the scene's.

    Camera rays that meet no surface give zero: the background is no part of a reference.
    """

    def __init__(self, scene: Scene, resolution: int, max_depth: int | None = None):
        self.max_depth = scene.max_depth if max_depth is None else max_depth
        self.mi_scene = scene_with_lighting(scene, torch.zeros((6, resolution, resolution, 3)))

        self.integrators = component_integrators(self.max_depth)

    def render(
        self, view: View, lighting: Float[Tensor, "6 R R 3"], spp: int, seed: int
    ) -> dict[str, Float[Tensor, "H W 3"]]:
        """Images ``full``, ``direct`` and ``indirect``, with ``spp`` paths per pixel each.

        ``full`` and ``direct`` use the same random numbers up to the first vertex, so their difference is
        exactly the part of the full estimate that bounced twice or more: no noise of direct light is left in
        ``indirect`` and it is not negative.

        Raises:
            PrtError: if spp is below 1, or the lighting does not fit (see ``set_lighting``).
        """
        set_lighting(self.mi_scene, lighting)
        return render_components(self.mi_scene, self.integrators, view, spp, seed)

    def render_with_floor(
        self, view: View, lighting: Float[Tensor, "6 R R 3"], spp: int, seed: int,
        psnr: Callable[[Tensor, Tensor], float] | None = None,
    ) -> tuple[dict[str, Float[Tensor, "H W 3"]], dict[str, float]]:  # fmt: skip
        """The mean of two independent halves of ``spp / 2`` paths, and each component's noise floor in dB."""
        halves = [self.render(view, lighting, max(1, spp // 2), seed=2 * seed + half) for half in (0, 1)]
        mean = {name: (halves[0][name] + halves[1][name]) / 2 for name in COMPONENTS}
        floor = {name: noise_floor(halves[0][name], halves[1][name], psnr) for name in COMPONENTS}
        return mean, floor


def component_integrators(max_depth: int) -> dict[str, Any]:
    """``path`` integrators of the components ``full`` (where it is more than direct light) and ``direct``."""
    mi = mitsuba()

    def integrator(bounces: int):
        # our D surface bounces are Mitsuba's max_depth D + 1, which counts the emitter
        return mi.load_dict({"type": "path", "max_depth": bounces + 1, "hide_emitters": True})

    found = {"full": integrator(max_depth), "direct": integrator(1)}
    if max_depth == 1:
        del found["full"]
    return found


def render_components(
    mi_scene: Any, integrators: dict[str, Any], view: View, spp: int, seed: int
) -> dict[str, Float[Tensor, "H W 3"]]:
    """Images ``full``, ``direct`` and ``indirect`` of a lit scene; ``indirect`` is their exact difference.

    Args:
        integrators: from :func:`component_integrators`; all use the same random numbers.

    Raises:
        PrtError: if spp is below 1.
    """
    sums = render_parts(mi_scene, integrators, view, spp, seed)
    sums.setdefault("full", sums["direct"])
    sums["indirect"] = np.maximum(sums["full"] - sums["direct"], 0)  # below zero by rounding only
    return {name: torch.from_numpy(sums[name]).float() for name in COMPONENTS}


def render_parts(
    mi_scene: Any, integrators: dict[str, Any], view: View, spp: int, seed: int
) -> dict[str, Float[np.ndarray, "H W 3"]]:
    """One image of each integrator, float64, in passes of at most ``WAVEFRONT`` paths.

    Raises:
        PrtError: if spp is below 1.
    """
    mi = mitsuba()
    if spp < 1:
        raise PrtError(f"reference spp={spp} must be at least 1")
    sensor = mi.load_dict(sensor_description(view))
    most = max(1, WAVEFRONT // (view.width * view.height))
    sums = {name: np.zeros((view.height, view.width, 3)) for name in integrators}
    for number, done in enumerate(range(0, spp, most)):
        count = min(most, spp - done)
        chunk_seed = int(np.random.SeedSequence([seed & 0xFFFFFFFF, number]).generate_state(1)[0])
        for name, integrator in integrators.items():
            image = mi.render(mi_scene, sensor=sensor, integrator=integrator, spp=count, seed=chunk_seed)
            sums[name] += np.array(image, dtype=np.float64) * (count / spp)
    return sums


def render(
    scene: Scene, view: View, lighting: Float[Tensor, "6 R R 3"], spp: int, max_depth: int, seed: int
) -> dict[str, Float[Tensor, "H W 3"]]:
    """One reference: see :meth:`ReferenceRenderer.render`; loaded scenes are kept from call to call."""
    return _renderer(scene, lighting.shape[1], max_depth).render(view, lighting, spp, seed)


@functools.lru_cache(maxsize=2)
def _renderer(scene: Scene, resolution: int, max_depth: int) -> ReferenceRenderer:
    return ReferenceRenderer(scene, resolution, max_depth)


def noise_floor(
    a: Float[Tensor, "H W 3"],
    b: Float[Tensor, "H W 3"],
    psnr: Callable[[Tensor, Tensor], float] | None = None,
) -> float:
    """PSNR in dB that the mean of two independent renderings has against the truth, estimated from the two.

    The error of (a + b) / 2 has the root mean square of (a - b) / 2, half of what ``psnr(a, b)`` sees:
    6.02 dB better. Where ``psnr`` is nonlinear (tone mapping) this holds to first order.

    Args:
        psnr: the metric in use, ``psnr(image, reference)``; by default linear radiance against a peak of the
            99.9th percentile of the mean image. Infinite where the two are equal (a black image).
    """
    if torch.equal(a, b):
        return math.inf
    if psnr is None:
        mean = ((a + b) / 2).numpy()
        peak = float(np.quantile(mean, 0.999)) or float(mean.max())
        error = float((a - b).double().square().mean())
        return 10 * math.log10(4 * peak * peak / error) if peak > 0 else math.inf
    return float(psnr(a, b)) + 20 * math.log10(2)

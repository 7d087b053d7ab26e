"""How fast the folded wavelet-neural renderer is against the readable one and against the machine.

``prt table performance/folded`` runs it. The network is untrained: time and the agreement of the two forms do
not depend on what it has learnt. All is measured in one run, the forms in turn.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import torch

from prt.light.environments import EnvironmentSet
from prt.methods.wavelet_neural import WaveletCode, WaveletNeural
from prt.metrics.timing import device_name
from prt.progress import Bar
from prt.scene.capture import capture
from prt.scene.scene import Scene

FORMS = {"readable": (False, "float32"), "folded": (True, "float32"), "folded_bfloat16": (True, "bfloat16")}
#: side of the square matrices whose product stands for the machine's matmul rate
MATMUL = 2048


def benchmark(
    scene: Scene, lighting: EnvironmentSet, method: dict[str, Any], size: int = 128, repetitions: int = 30
) -> list[dict[str, Any]]:
    """Measure one frame of a scene's first far view.

    Args:
        method: settings of :class:`WaveletNeural` besides ``folded`` and ``precision``; nothing is trained.
        size: pixels along each side of the frame.
        repetitions: of each timing, the forms in turn.

    Returns:
        Rows of ``ratio/speedup`` (readable over this form), ``ratio/matmul`` (arithmetic of the folded form
        per second over that of a large matrix product in the same precision), ``ratio/error`` (norm of the
        difference to the readable form over its norm) and ``time/shade`` in seconds; medians with the 5th
        and 95th percentile.
    """
    gbuffer = capture(scene.load(), scene.views("far", 1, size)[0])
    cubemap = lighting.test()[1][0]
    renderer = WaveletNeural(**method)
    torch.manual_seed(0)
    bounds = gbuffer.position.amin(dim=0).tolist(), gbuffer.position.amax(dim=0).tolist()
    renderer.build(bounds, cubemap.shape[1], torch.ones(cubemap.shape[:3].numel()), "cpu")
    torch.nn.init.normal_(renderer.net.grid.table)

    def prepare(form: str) -> WaveletCode:
        renderer.folded, renderer.precision = FORMS[form]
        return renderer.light(cubemap)

    truth = renderer.shade(gbuffer, prepare("readable"))
    seconds: dict[str, list[float]] = {name: [] for name in (*FORMS, "float32", "bfloat16")}
    errors = {}
    with Bar(f"folded benchmark, {scene.name}", repetitions + 2) as bar:
        for number in range(repetitions + 2):
            for form in FORMS:
                code = prepare(form)
                taken, image = clocked(lambda code=code: renderer.shade(gbuffer, code))
                seconds[form].append(taken)
                errors[form] = float((image - truth).norm() / truth.norm())
            for name, kind in (("float32", torch.float32), ("bfloat16", torch.bfloat16)):
                square = torch.ones((MATMUL, MATMUL), dtype=kind)
                seconds[name].append(clocked(lambda square=square: square @ square)[0])
            if number == 1:  # warmed up
                seconds = {name: [] for name in seconds}
            bar.advance()
    work = arithmetic(renderer, len(gbuffer))
    rows = []
    for form, (folded, precision) in FORMS.items():
        speedup = [a / b for a, b in zip(seconds["readable"], seconds[form], strict=True)]
        rate = [
            work / a / (2 * MATMUL**3 / b) for a, b in zip(seconds[form], seconds[precision], strict=True)
        ]
        found = {"time/shade": seconds[form], "ratio/speedup": speedup, "ratio/error": [errors[form]]}
        for metric, values in found.items() if not folded else {**found, "ratio/matmul": rate}.items():
            rows.append({
                "method": "wavelet_neural", "device": device_name("cpu"), "variant": f"form={form}",
                "component": "indirect", "metric": metric, **spread(values),
            })  # fmt: skip
    return rows


def arithmetic(method: WaveletNeural, pixels: int) -> float:
    """Floating-point operations of a folded frame's matrix products: two layers and the sum over k."""
    width, terms = method.width, method.net.terms
    return 2.0 * pixels * method.wavelets * (terms * width + width * width + 3 * width)


def clocked(work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of a call, and what it returned."""
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def spread(values: list[float]) -> dict[str, float | int]:
    """Median, 5th and 95th percentile."""
    if len(values) == 1:
        return {"value": values[0], "lo": float("nan"), "hi": float("nan"), "n": 1}
    cuts = statistics.quantiles(values, n=20, method="inclusive")
    return {"value": statistics.median(values), "lo": cuts[0], "hi": cuts[-1], "n": len(values)}

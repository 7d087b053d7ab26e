"""What a frame of the wavelet-neural renderer costs, on a CPU or a GPU (Raghavan 2023, table 2).

``prt table raghavan2023/table2``, ``performance/frame_time`` and ``performance/folded`` run it. The network
is untrained: neither time nor the agreement of its forms depends on what it has learnt. All that is compared
is measured in turn, round by round, so that a machine whose speed drifts is the same for all.
"""

import dataclasses
import itertools
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from prt.errors import PrtError
from prt.light.environments import EnvironmentSet
from prt.methods.frame_rows import Case, absent, join_words, rows_of
from prt.methods.wavelet_fused import chunk_on
from prt.methods.wavelet_neural import WaveletNeural
from prt.methods.wavelet_shading import WaveletCode
from prt.progress import Bar
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.trace.denoise import denoise

#: settings of the method that make a form
SETTINGS = {
    "readable": {"folded": False, "kernel": "auto"},
    "plain": {"folded": True, "kernel": "plain"},
    "fused": {"folded": True, "kernel": "fused"},
}
FORMS = (*SETTINGS, "fastest")
PRECISIONS = {"float32": torch.float32, "bfloat16": torch.bfloat16}
#: side of the square matrices whose product stands for a device's matmul rate: large enough to keep it busy
MATMUL = {"cpu": 2048, "cuda": 8192}
WARMUP = 2
#: seconds of a slow frame
SLOW = 1.0
#: products in a row of one timing, at most
MOST = 128
#: pixels that the error is taken on
SAMPLE = 4096


@dataclasses.dataclass
class Image:
    """A resolution: its view, its G-buffer on the device, and the frames that share them."""

    view: View
    gbuffer: GBuffer
    cases: list[Case] = dataclasses.field(default_factory=list)


def frame_time(
    scene: Scene,
    lighting: EnvironmentSet,
    method: dict[str, Any],
    frames: dict[str, list[int]],
    precisions: list[str],
    forms: list[str],
    devices: list[str],
    repetitions: int = 30,
    slow_repetitions: int = 10,
) -> list[dict[str, Any]]:
    """Measure frames of a scene's first far view under the first test lighting.

    Args:
        method: settings of :class:`WaveletNeural`; ``wavelets``, ``precision``, ``folded`` and ``kernel`` are
            set here.
        frames: numbers of wavelets by resolution, as ``{512x512: [32, 64]}``.
        precisions: of ``shade``: ``float32``, ``bfloat16``.
        forms: how the network is shaded: ``readable`` (Algorithm 1 as printed, in float32), ``plain``
            (folded, in torch), ``fused`` (:mod:`prt.methods.wavelet_fused`), ``fastest`` (fused where that
            can run, else plain; the rows' device says which).
        devices: ``cpu``, ``cuda``. Of several, one that is absent has one row without a figure, whose device
            says why; a single one must be there. The same holds for forms.
        repetitions: rounds; ``slow_repetitions``: of frames that take more than :data:`SLOW` seconds.

    Returns:
        Rows as :func:`prt.methods.frame_rows.rows_of` explains them.

    Raises:
        PrtError: for a setting out of range, or the only device or form where it cannot run.
    """
    check(frames, precisions, forms, repetitions, slow_repetitions)
    rows = []
    for device in devices:
        problem = device_problem(device)
        if problem and len(devices) == 1:
            raise PrtError(f"benchmark.devices={device}: {problem}")
        token = f"device={device}" if len(devices) > 1 else ""
        if problem:
            rows.append(absent(token, f"{token} is empty, no GPU was had ({problem})"))
            continue
        bench = Bench(scene, lighting, method, device)
        for form, precision in itertools.product(forms, precisions):
            if form == "readable" and precision != "float32":
                continue
            words = join_words(f"form={form}" if len(forms) > 1 else "", token)
            runs_as, reason = bench.resolved(form, precision)
            if runs_as:
                bench.add(frames, precision, runs_as, words)
            elif len(forms) == 1:
                raise PrtError(f"benchmark.forms={form}: {reason}")
            else:
                variant = join_words(f"precision={precision}", words)
                rows.append(absent(variant, f"{variant} is empty: {reason}"))
        bench.run(repetitions, slow_repetitions)
        rows += rows_of(bench.cases, device)
    return rows


def check(frames: Any, precisions: Any, forms: Any, repetitions: int, slow_repetitions: int) -> None:
    """Refuse settings out of range.

    Raises:
        PrtError: naming the setting, its value and what is allowed.
    """
    for name, given, known in (("precisions", precisions, PRECISIONS), ("forms", forms, FORMS)):
        for value in given:
            if value not in known:
                raise PrtError(f"benchmark.{name}: {value!r} is not one of {', '.join(known)}")
    for name, value in (("repetitions", repetitions), ("slow_repetitions", slow_repetitions)):
        if not isinstance(value, int) or value < 2:
            raise PrtError(f"benchmark.{name}={value!r} must be a whole number of at least 2")
    for resolution, counts in frames.items():
        size_of(resolution)
        for count in counts:
            if not isinstance(count, int) or count < 1:
                raise PrtError(f"benchmark.frames.{resolution}: {count!r} wavelets; take 1 or more")


def size_of(resolution: str) -> tuple[int, int]:
    """Width and height of ``512x512``."""
    parts = str(resolution).split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise PrtError(f"benchmark.frames: {resolution!r} is no <width>x<height>, as 800x600")
    return int(parts[0]), int(parts[1])


def device_problem(device: str) -> str | None:
    """None where torch has the device, else why not."""
    if device not in MATMUL:
        raise PrtError(f"benchmark.devices: {device!r} is not one of {', '.join(MATMUL)}")
    return "torch sees no CUDA device" if device == "cuda" and not torch.cuda.is_available() else None


class Bench:
    """A scene, a lighting and an untrained network on one device, and the frames that are measured."""

    def __init__(self, scene: Scene, lighting: EnvironmentSet, method: dict[str, Any], device: str):
        self.device, self.mi_scene = device, scene.load()
        self.view = scene.views("far", 1, 64)[0]
        self.lighting = lighting.test()[1][0].to(device)
        self.renderer = WaveletNeural(**{"wavelets": 1, **method})
        self.images: dict[str, Image] = {}
        torch.manual_seed(0)
        points = capture(self.mi_scene, self.view).position
        bounds = points.amin(dim=0).tolist(), points.amax(dim=0).tolist()
        resolution = self.lighting.shape[1]
        self.renderer.build(bounds, resolution, torch.ones(6 * resolution**2), device)
        with torch.no_grad():  # features as small as at the start of training would hide errors
            torch.nn.init.normal_(self.renderer.net.grid.table)
        side = MATMUL[device]
        self.squares = {
            name: torch.ones((side, side), dtype=kind, device=device) for name, kind in PRECISIONS.items()
        }

    @property
    def cases(self) -> list[Case]:
        return [case for image in self.images.values() for case in image.cases]

    def set(self, form: str, precision: str, wavelets: int) -> WaveletCode:
        """Make the renderer one of the measured kind; returns its code of the lighting."""
        for name, value in {**SETTINGS[form], "precision": precision, "wavelets": wavelets}.items():
            setattr(self.renderer, name, value)
        return self.renderer.light(self.lighting)

    def resolved(self, form: str, precision: str) -> tuple[str | None, str]:
        """The form that runs for a wanted one; None where it cannot, and why."""
        points = capture(self.mi_scene, self.view).to(self.device)
        try:
            tried = "fused" if form == "fastest" else form
            self.renderer.radiance(points, self.set(tried, precision, 1))
        except PrtError as error:
            return ("plain" if form == "fastest" else None), str(error)
        return tried, ""

    def add(self, frames: dict[str, list[int]], precision: str, form: str, token: str) -> None:
        """Measure a form at all resolutions and numbers of wavelets."""
        for resolution, counts in frames.items():
            if resolution not in self.images:
                view = self.view.resized(*size_of(resolution))
                self.images[resolution] = Image(view, capture(self.mi_scene, view).to(self.device))
            image = self.images[resolution]
            for wavelets in counts:
                work = arithmetic(self.renderer, len(image.gbuffer), wavelets)
                sizes = (len(image.gbuffer), work, MATMUL[self.device])
                image.cases.append(Case(resolution, wavelets, precision, form, token, *sizes))

    def run(self, repetitions: int, slow_repetitions: int) -> None:
        """All rounds; the first ones warm up."""
        for image in self.images.values():
            for case in image.cases:
                case.error = self.error(case, image.gbuffer)
        label = f"frames on {self.device}"
        with Bar(label, (WARMUP + repetitions) * len(self.cases)) as bar:
            for number in range(WARMUP + repetitions):
                for image in self.images.values():
                    due = [case for case in image.cases if not case.done(repetitions, slow_repetitions, SLOW)]
                    self.round(image, due)
                    bar.advance(len(image.cases))
                if number == WARMUP - 1:
                    for case in self.cases:
                        case.seconds.clear()

    def round(self, image: Image, cases: list[Case]) -> None:
        """Every case of a resolution once, with a G-buffer and a denoised image of its own."""
        if not cases:
            return
        seconds = {"gbuffer": self.clock(lambda: capture(self.mi_scene, image.view).to(self.device))[0]}
        radiance, taken = None, []
        for case in cases:
            own: dict[str, float] = {}
            own["light"], code = self.clock(lambda c=case: self.set(c.form, c.precision, c.wavelets))
            own["shade"], radiance = self.clock(lambda code=code: self.renderer.radiance(image.gbuffer, code))
            own["matmul"] = self.matmul(case.precision, own["shade"])
            if case.form == "plain":
                own["products"] = self.products(code.folded, case)
            taken.append(own)
        shown = image.gbuffer
        seconds["denoise"] = self.clock(lambda: denoise(shown.image(radiance), **shown.guides()))[0]
        for case, own in zip(cases, taken, strict=True):
            case.seconds.append({**seconds, **own})

    def matmul(self, precision: str, seconds: float) -> float:
        """Seconds of a large product, from so many as take about the given time.

        A busy machine interrupts long work and not short work; only works of one length compare.
        """
        square = self.squares[precision]
        first = self.clock(lambda: square @ square)[0]
        more = min(MOST, int(seconds / first))
        rest = self.clock(lambda: [square @ square for _ in range(more)])[0]
        return (first + rest) / (1 + more)

    def products(self, folded: Tensor, case: Case) -> float:
        """Seconds of nothing but the products of the plain form's two layers."""
        chunk, net = chunk_on(self.device, self.renderer.chunk), self.renderer.net
        space = folded.new_ones((chunk, net.terms))
        second = folded.new_ones((net.width, net.width))
        first, hidden = folded.new_empty((2, chunk * case.wavelets, net.width))

        chunks = max(1, min(MOST, case.pixels // chunk))

        def run() -> None:
            for _ in range(chunks):
                torch.mm(space, folded, out=first.view(chunk, -1))
                torch.mm(first, second, out=hidden)

        return self.clock(run)[0] * case.pixels / (chunks * chunk)

    def error(self, case: Case, gbuffer: GBuffer) -> float:
        """Norm of the difference to the readable form in float32, over its norm, on some of the pixels."""
        some = gbuffer.rows(torch.linspace(0, len(gbuffer) - 1, min(SAMPLE, len(gbuffer))).long())
        truth = self.renderer.radiance(some, self.set("readable", "float32", case.wavelets))
        found = self.renderer.radiance(some, self.set(case.form, case.precision, case.wavelets))
        return float((found - truth).norm() / truth.norm())

    def clock(self, work: Callable[[], Any]) -> tuple[float, Any]:
        """Seconds of a call, the device idle before and after, and what it returned."""
        wait = torch.cuda.synchronize if self.device == "cuda" else lambda: None
        wait()
        started = time.perf_counter()
        result = work()
        wait()
        return time.perf_counter() - started, result


def arithmetic(method: WaveletNeural, pixels: int, wavelets: int) -> float:
    """Floating-point operations of a folded frame's matrix products: two layers and the sum over k."""
    width, terms = method.width, method.net.terms
    return 2.0 * pixels * wavelets * (terms * width + width * width + 3 * width)

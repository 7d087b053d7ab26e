"""Rows of a report from the frames that :mod:`prt.methods.benchmark_frame` measured."""

import dataclasses
import statistics
from collections.abc import Sequence
from typing import Any

import torch

from prt.metrics.timing import device_name

METHOD = "wavelet_neural"
#: as they stand beside a device
FORM_WORDS = {"readable": "Algorithm 1 as printed", "plain": "plain torch", "fused": "fused kernels"}
#: of a frame, one after the other
SCOPES = ("gbuffer", "light", "shade", "denoise")


@dataclasses.dataclass
class Case:
    """A frame of one kind, and the seconds of its parts in every round.

    Attributes:
        token: what else its variant says.
        pixels: that are shaded.
        work: floating-point operations of its matrix products in the folded form.
        side: of the large square matrices.
        error: against the readable form.
        seconds: by round: ``gbuffer``, ``light``, ``shade``, ``denoise``; ``matmul``: a product of large
            matrices in the same precision; ``products``, of the plain form: what its layers' products take.
    """

    resolution: str
    wavelets: int
    precision: str
    form: str
    token: str
    pixels: int
    work: float
    side: int
    error: float = float("nan")
    seconds: list[dict[str, float]] = dataclasses.field(default_factory=list)

    @property
    def variant(self) -> str:
        words = [f"resolution={self.resolution}", f"wavelets={self.wavelets}", f"precision={self.precision}"]
        return join_words(*words, self.token)

    def done(self, repetitions: int, slow_repetitions: int, slow: float) -> bool:
        """Whether enough rounds are measured; fewer where a frame takes more than ``slow`` seconds."""
        frames = self.of("frame")
        wanted = slow_repetitions if frames and statistics.median(frames) > slow else repetitions
        return len(frames) >= wanted

    def of(self, scope: str) -> list[float]:
        """Seconds of a scope by round; ``frame`` is all of them."""
        scopes = SCOPES if scope == "frame" else (scope,)
        return [sum(one[name] for name in scopes) for one in self.seconds]


def rows_of(cases: Sequence[Case], device: str) -> list[dict[str, Any]]:
    """Medians over rounds with the 5th and 95th percentile.

    Times in seconds: ``time/gbuffer`` (capture, and the way to the device), ``time/light``, ``time/shade``
    (from a G-buffer to radiance, both on the device), ``time/denoise`` (Open Image Denoise) and
    ``time/frame``, their sum. ``frames/whole`` is of that sum.

    Ratios, of one round's figures: ``ratio/limit``, the folded form's arithmetic per second over that of a
    large matrix product in the same precision; ``ratio/products``, the same if the plain form did nothing but
    the products of its two layers: unfused code cannot exceed it; ``ratio/speedup``, the readable form's time
    over this one's, where it is measured. ``growth/frame_per_wavelet`` and ``growth/shade_per_wavelet``: the
    time a wavelet over that with the fewest wavelets of the resolution; ``growth/frame_per_pixel`` and
    ``growth/shade_per_pixel``: the time a pixel over that at the first resolution; 1 is linear.
    ``ratio/error``: see :meth:`prt.methods.benchmark_frame.Bench.error`.
    """
    machine = device_name(device) + (f", {torch.get_num_threads()} threads" if device == "cpu" else "")
    rows = []
    for case in cases:
        where = f"{machine}, {FORM_WORDS[case.form]}"
        for scope in (*SCOPES, "frame"):
            ran_on = f"{denoiser()} (denoising)" if scope == "denoise" else where
            rows.append(row(case.variant, f"time/{scope}", case.of(scope), ran_on))
        rows.append(row(case.variant, "frames/whole", [1 / one for one in case.of("frame")], where))
        for metric, values in ratios(case, cases).items():
            rows.append(row(case.variant, metric, values, where))
    return rows


def ratios(case: Case, cases: Sequence[Case]) -> dict[str, list[float]]:
    """The ratios of a case, by round."""
    found = {"ratio/error": [case.error]}
    large = 2.0 * case.side**3
    for metric, scope in (("ratio/limit", "shade"), ("ratio/products", "products")):
        if case.form == "plain" or (case.form == "fused" and scope == "shade"):
            pairs = zip(case.of(scope), case.of("matmul"), strict=True)
            found[metric] = [case.work / taken / (large / matmul) for taken, matmul in pairs]
    alike = [one for one in cases if (one.form, one.precision) == (case.form, case.precision)]
    same_size = [one for one in alike if one.resolution == case.resolution]
    fewest = min(same_size, key=lambda one: one.wavelets)
    first = next(one for one in alike if one.wavelets == case.wavelets)
    for name, base, share in (
        ("wavelet", fewest, fewest.wavelets / case.wavelets),
        ("pixel", first, first.pixels / case.pixels),
    ):
        if base is not case:
            for scope in ("frame", "shade"):
                pairs = zip(case.of(scope), base.of(scope), strict=False)
                found[f"growth/{scope}_per_{name}"] = [share * mine / its for mine, its in pairs]
    for one in cases:
        if one.form == "readable" and (one.resolution, one.wavelets) == (case.resolution, case.wavelets):
            pairs = zip(one.of("shade"), case.of("shade"), strict=False)
            found["ratio/speedup"] = [slow / fast for slow, fast in pairs]
    return found


def row(variant: str, metric: str, values: list[float], device: str) -> dict[str, Any]:
    """A row of ``results.csv``: times are of the whole, ratios of indirect radiance."""
    component = "" if metric.startswith(("time/", "frames/")) else "indirect"
    return {
        "method": METHOD, "device": device, "variant": variant, "component": component, "metric": metric,
        **spread(values),
    }  # fmt: skip


def absent(token: str, reason: str) -> dict[str, Any]:
    """A row without a figure for what could not be measured; ``device`` says why."""
    nothing = float("nan")
    return {
        "method": METHOD, "device": reason, "variant": token, "component": "", "metric": "time/frame",
        "value": nothing, "lo": nothing, "hi": nothing, "n": 0,
    }  # fmt: skip


def join_words(*words: str) -> str:
    """Words of a variant; empty ones are left out."""
    return ",".join(filter(None, words))


def spread(values: list[float]) -> dict[str, float | int]:
    """Median, 5th and 95th percentile."""
    if len(values) == 1:
        return {"value": values[0], "lo": float("nan"), "hi": float("nan"), "n": 1}
    cuts = statistics.quantiles(values, n=20, method="inclusive")
    return {"value": statistics.median(values), "lo": cuts[0], "hi": cuts[-1], "n": len(values)}


def denoiser() -> str:
    """The device that Open Image Denoise takes for images in the CPU's memory: the fastest there is."""
    import mitsuba_oidn

    return mitsuba_oidn.physical_devices()[0].name

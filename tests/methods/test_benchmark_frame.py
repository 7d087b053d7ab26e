"""Frames are measured in all forms, absent devices and forms are said to be absent, settings are checked."""

import math
from types import SimpleNamespace

import pytest
import tiny
import torch

from prt.errors import PrtError
from prt.methods import benchmark_frame
from prt.methods.benchmark_frame import frame_time, size_of
from prt.methods.frame_rows import Case, ratios

METHOD = dict(
    selection="magnitude", scale_outputs=False, texture="independent", width=16,
    directions=dict(kind="sh", degree=1, bins=2),
    grid=dict(levels=3, features=2, log2_table=8, base_resolution=4, scale=1.5),
    training=dict(
        draw="uniform", target="full", supervision="images", lightings_per_view=None, gain_points=0
    ),
)  # fmt: skip
SETTINGS = dict(
    method=METHOD, frames={"8x6": [2, 4]}, precisions=["float32"], forms=["plain"], devices=["cpu"],
    repetitions=2, slow_repetitions=2,
)  # fmt: skip


@pytest.fixture
def measure(tiny_task, monkeypatch, own_cache):
    monkeypatch.setattr(benchmark_frame, "MATMUL", {"cpu": 64, "cuda": 64})
    lighting = SimpleNamespace(test=lambda: (["a"], tiny.random_cubemap()[None]))
    return lambda **changes: frame_time(tiny_task.scene, lighting, **{**SETTINGS, **changes})


def table(rows):
    return {(row["variant"], row["metric"]): row["value"] for row in rows}


def test_every_scope_is_measured_and_a_frame_is_their_sum(measure):
    found = table(measure())
    name = "resolution=8x6,wavelets=4,precision=float32"
    scopes = [found[name, f"time/{scope}"] for scope in ("gbuffer", "light", "shade", "denoise")]
    assert min(scopes) > 0
    # of two rounds the median is the mean, and so the sum of medians that of the sums
    assert found[name, "time/frame"] == pytest.approx(sum(scopes))
    assert found[name, "ratio/limit"] > 0 and found[name, "ratio/products"] > found[name, "ratio/limit"] / 2
    assert found[name, "ratio/error"] < 1e-5
    assert {variant for variant, _ in found} == {name, name.replace("wavelets=4", "wavelets=2")}


def test_forms_and_precisions_are_told_apart(measure):
    found = table(
        measure(forms=["readable", "plain"], precisions=["float32", "bfloat16"], frames={"8x8": [2]})
    )
    name = "resolution=8x8,wavelets=2,precision="
    assert found[name + "float32,form=readable", "ratio/speedup"] == 1
    assert found[name + "float32,form=plain", "ratio/speedup"] > 0
    assert 0 < found[name + "bfloat16,form=plain", "ratio/error"] < 0.1
    assert (name + "bfloat16,form=readable", "time/shade") not in found


def test_what_is_absent_has_a_row_that_says_why(measure, monkeypatch):
    if not torch.cuda.is_available():
        with pytest.raises(PrtError, match="devices=cuda: torch sees no CUDA device"):
            measure(devices=["cuda"])
        rows = [row for row in measure(devices=["cuda", "cpu"]) if row["variant"] == "device=cuda"]
        assert len(rows) == 1 and math.isnan(rows[0]["value"]) and "no CUDA device" in rows[0]["device"]
    from prt.methods import wavelet_fused

    monkeypatch.setattr(wavelet_fused, "compiled_problem", lambda _: "the processor has none")
    with pytest.raises(PrtError, match="forms=fused: .*the processor has none"):
        measure(forms=["fused"], precisions=["bfloat16"])
    rows = measure(forms=["fused", "plain"], precisions=["bfloat16"])
    assert "the processor has none" in next(row for row in rows if "form=fused" in row["variant"])["device"]
    fastest = measure(forms=["fastest"], precisions=["bfloat16"])
    assert any("plain torch" in row["device"] for row in fastest)


def test_time_in_proportion_is_a_ratio_of_one():
    def case(resolution, wavelets, pixels):
        shade = 1e-6 * wavelets * pixels
        rest = {"gbuffer": 0.0, "light": 0.0, "denoise": 0.0, "matmul": 1.0, "products": shade / 2}
        made = Case(resolution, wavelets, "float32", "plain", "", pixels, 1e6, 100)
        made.seconds = [{**rest, "shade": shade}] * 3
        return made

    cases = [case("8x8", 32, 64), case("8x8", 64, 64), case("16x8", 64, 128)]
    assert ratios(cases[1], cases)["growth/shade_per_wavelet"] == pytest.approx([1.0] * 3)
    assert ratios(cases[2], cases)["growth/frame_per_pixel"] == pytest.approx([1.0] * 3)
    assert ratios(cases[1], cases)["ratio/limit"] == pytest.approx([1e6 / 4.096e-3 / 2e6] * 3)
    assert "growth/shade_per_pixel" not in ratios(cases[0], cases)


@pytest.mark.parametrize(
    "change, word",
    [
        (dict(precisions=["half"]), "precisions: 'half'"),
        (dict(forms=["quick"]), "forms: 'quick'"),
        (dict(devices=["gpu"]), "devices: 'gpu'"),
        (dict(frames={"512": [1]}), "'512' is no <width>x<height>"),
        (dict(frames={"8x8": [0]}), "0 wavelets"),
        (dict(repetitions=1), "repetitions=1"),
    ],
)
def test_bad_settings_are_named(change, word):
    with pytest.raises(PrtError, match=word):
        frame_time(None, None, **{**SETTINGS, **change})


def test_a_resolution_need_not_be_square():
    assert size_of("800x600") == (800, 600)

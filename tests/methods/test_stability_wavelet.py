"""Benchmarks of wavelet-neural on the real task at a tiny size: what they report, and in which direction."""

import pytest
import tiny
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light.cubemap import rotate, yaw
from prt.methods import figures_wavelet, stability_wavelet
from prt.metrics.diagnostics import diagnostic_of


@pytest.fixture(scope="module")
def model(tiny_task, maps):
    settings = ["method=wavelet_neural", "method.training.steps=60", "method.wavelets=8"]
    method = build(compose([*tiny.TASK, *tiny.lights(maps), *settings]), "method")
    method.fit(tiny_task, tiny.Log(), 0, "cpu")
    return method


def values(rows, metric):
    return {row["variant"]: row["value"] for row in rows if row["metric"] == metric}


def test_flicker_of_every_selection(tiny_task, model, own_cache):
    rows = stability_wavelet.flicker(tiny_task, model, 2.0, 6, 2, [8, 6 * tiny.RESOLUTION**2], 16)
    jump, share = values(rows, "flicker/jump"), values(rows, "flicker/share")
    found, truth = values(rows, "flicker/relative"), values(rows, "flicker/truncation")
    assert len(found) == 2 * 6 == len(truth) == len(share) == len(jump) - 1
    assert "selection=none" in jump, "what the light itself does"
    everything = f"wavelets={6 * tiny.RESOLUTION**2}"
    # nothing is cut away: the truth under the kept light is the truth
    assert truth[f"selection=magnitude,{everything}"] < 1e-4 < truth["selection=magnitude,wavelets=8"]
    # with all wavelets there is nothing to swap, whatever the selection
    assert max(value for name, value in jump.items() if everything in name) < 1e-5
    assert jump["selection=none"] > 1e-3 and jump["selection=magnitude,wavelets=8"] > 1e-3
    assert all(value == 1 for name, value in share.items() if "magnitude,wavelets=8" in name)
    assert share["selection=hysteresis_and_fading,wavelets=8"] < 1
    assert (model.wavelets, model.selection) == (8, "transport"), "the model was left changed"
    assert all(diagnostic_of(row["metric"]) for row in rows)
    one = next(row for row in rows if row["variant"] == "selection=area,wavelets=8")
    assert one["lo"] <= one["value"] <= one["hi"] and one["n"] == 2
    with pytest.raises(PrtError, match="frames=2"):
        stability_wavelet.flicker(tiny_task, model, 2.0, 2, 1, [8], 16)


def test_noise_of_the_truth_is_no_flicker():
    """Images without error, truths with much noise: two records say so, one would not."""
    draw = torch.Generator().manual_seed(0)
    image = torch.rand((6, 4000, 3), generator=draw)
    noisy = [image + torch.randn(image.shape, generator=draw) for _ in range(2)]
    wrong = [(image - truth).diff(dim=0) for truth in noisy]
    assert wrong[0].square().mean().sqrt() > 1.3
    assert stability_wavelet.independent_rms(*wrong) < 0.15
    shifted = [part + 2.0 for part in wrong]
    assert stability_wavelet.independent_rms(*shifted) == pytest.approx(2.0, abs=0.05)


def test_all_frames_at_once_are_the_frames_one_by_one(tiny_task, model):
    view = tiny_task.scene.views("far", 1, 16, train_count=tiny_task.train_view_count)[0]
    gbuffer = tiny_task.recorded(view, 4, 5)[0]
    lighting = tiny_task.lighting.test()[1][0]
    turning = [rotate(lighting, yaw(20.0 * frame)) for frame in range(5)]
    kept = {"few": stability_wavelet.followed(model, turning, model.selection, model.wavelets)}
    kept["all"] = [stability_wavelet.whole_light(model, light) for light in turning]
    fast = stability_wavelet.shaded(model, gbuffer, kept)
    slow = torch.stack([model.shade(gbuffer, model.light(light)) for light in turning])
    assert fast["few"].shape == slow.shape == (5, len(gbuffer), 3)
    torch.testing.assert_close(fast["few"], slow, rtol=1e-4, atol=1e-5 * float(slow.abs().max()))
    assert not torch.allclose(slow[0], slow[4], rtol=1e-3), "the light turns"
    model.wavelets, before = 6 * tiny.RESOLUTION**2, model.wavelets
    whole = torch.stack([model.shade(gbuffer, model.light(light)) for light in turning])
    model.wavelets = before
    torch.testing.assert_close(fast["all"], whole, rtol=1e-4, atol=1e-5 * float(whole.abs().max()))


def test_a_light_that_stands_still_flickers_with_no_selection(tiny_task, model, own_cache):
    rows = stability_wavelet.flicker(tiny_task, model, 0.0, 4, 1, [8], 16)
    assert max(row["value"] for row in rows) < 1e-6


def test_lights_unlike_training(tiny_task, model, own_cache, tmp_path):
    rows = stability_wavelet.unlike_lights(
        tiny_task, model, "wavelet_neural", ["same", "red", "bright", "black"], 1, tmp_path
    )
    error = values(rows, "error/relative")
    # linear in the lighting: a thousand times the light is a thousand times the image
    assert error["lighting=bright"] == pytest.approx(error["lighting=same"], rel=1e-3)
    scaled = values(rows, "error/scaled")
    assert set(scaled) == {"lighting=same", "lighting=bright"} and max(scaled.values()) < 1e-4
    assert values(rows, "error/black") == {"lighting=black": 0.0}
    assert set(values(rows, "chroma/shift")) == {"lighting=same", "lighting=red", "lighting=bright"}
    assert (tmp_path / "lights_cornell_glossy_wavelet_neural.png").stat().st_size > 1000


def test_chroma_shift_is_that_of_colour_alone():
    image = torch.rand((8, 8, 3), generator=torch.Generator().manual_seed(0)) * 0.5 + 0.2
    assert stability_wavelet.chroma_shift(image, image) == 0
    redder = image * torch.tensor([1.3, 1.0, 1.0])
    assert stability_wavelet.chroma_shift(redder, image) > 3


def test_views_nearer_and_farther(tiny_task, model, own_cache):
    rows = stability_wavelet.views_outside(tiny_task, model, [1.0, 1.3], 1)
    assert set(values(rows, "psnr")) == {"distance=1", "distance=1.3"}
    with pytest.raises(PrtError, match="distances=0"):
        stability_wavelet.views_outside(tiny_task, model, [0.0], 1)


def test_points_fall_where_their_strategy_says(tiny_task, tmp_path):
    rows = figures_wavelet.training_points(tiny_task, tmp_path, view=0, draws=20_000, smooth=0.35)
    found = values(rows, "points/smooth")
    smooth = (tiny_task.training().gbuffer.roughness[:, 0] < 0.35).float().mean()
    assert found["strategy=uniform"] == pytest.approx(float(smooth), abs=0.02)
    assert found["strategy=specular"] > 1.5 * found["strategy=uniform"]
    assert (tmp_path / "points.png").stat().st_size > 1000


def test_spectrum_is_a_share_that_grows(tiny_task, model, own_cache, tmp_path):
    rows = figures_wavelet.transport_spectrum(tiny_task, model, tmp_path, size=8, spp=16, largest=64)
    for name in ("recorded", "predicted"):
        shares = [row["value"] for row in rows if f"transport={name}," in row["variant"]]
        assert len(shares) == 7 and shares[-1] == pytest.approx(1.0)
        assert shares[0] > 1 / 64
    assert (tmp_path / "histogram_cornell_glossy.png").stat().st_size > 1000


def test_noise_is_not_counted_as_energy():
    """Of pure noise, the largest coefficients of one record say nothing about another."""
    generator = torch.Generator().manual_seed(0)
    first, second = torch.randn((2, 200, 384), generator=generator)
    own = figures_wavelet.in_order(first, first, 64).mean()
    other = figures_wavelet.in_order(first, second, 64).mean()
    assert own > 2 and abs(other) < 0.1

"""What a training step of wavelet-neural draws and holds against what, on the real task at a tiny size."""

import pytest
import tiny
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light import haar
from prt.methods.wavelet_neural import measure
from prt.methods.wavelet_training import WaveletTraining


@pytest.fixture
def make(tiny_task, maps):
    """A training of the smoke settings with changes, its network untrained."""

    def made(**changes) -> WaveletTraining:
        torch.manual_seed(0)
        method = build(compose([*tiny.TASK, *tiny.lights(maps), "method=wavelet_neural"]), "method")
        data = tiny_task.training()
        sigma = torch.rand(6 * tiny.RESOLUTION**2, generator=torch.Generator().manual_seed(1)) + 0.1
        method.build(data.bounds, tiny.RESOLUTION, sigma, "cpu")
        settings = {**method.training, **changes}
        generator = torch.Generator().manual_seed(2)
        return WaveletTraining(
            method.net, data, tiny_task.train_lightings(), sigma, True, settings, generator, "cpu"
        )

    return made


def test_drawn_wavelets_are_distinct_and_hold_the_largest(make):
    training = make(wavelets=32, largest_share=0.5)
    which = torch.tensor([0, 2])
    drawn = training.draw_wavelets(which)
    assert len(drawn) == 32 == len(torch.unique(drawn))
    strength = training.coefficients[which].square().sum(dim=2) * training.rank.square()
    for row in strength:
        assert set(row.argsort(descending=True)[:4].tolist()) <= set(drawn.tolist())


@pytest.mark.parametrize("share, all_random", [(0.0, True), (1.0, False)])
def test_the_share_of_the_largest_is_a_setting(make, share, all_random):
    training = make(wavelets=16, largest_share=share, draw="uniform")
    which = torch.tensor([0])
    strength = training.coefficients[0].square().sum(dim=1) * training.rank.square()
    largest = set(strength.topk(16).indices.tolist())
    drawn = set(training.draw_wavelets(which).tolist())
    assert (drawn == largest) != all_random


def test_a_view_is_seen_under_its_few_lightings_only(make, tiny_task):
    """The targets of a step are those of pairs of a view and one of its lightings."""
    training = make(lightings_per_view=1, lightings=4, pixels=64)
    assert training.lightings_of_view.shape == (4, 1)
    asked = []
    original = training.data.transport

    class Spy:
        def rows(self, points):
            asked.append(training.data.point_view[points])
            return original.rows(points)

    import dataclasses

    training.data = dataclasses.replace(training.data, transport=Spy())
    loss = training.loss()
    assert loss.isfinite() and len(asked) == 4
    for views in asked:
        assert len(views.unique()) == 1, "a lighting was held against points of another view"


def test_all_lightings_a_view_are_as_many_as_there_are(make):
    assert make(lightings_per_view=10**6).lightings_of_view.shape[1] == len(make().lightings)


def test_rows_are_held_against_recorded_transport(make, monkeypatch):
    """A network that says what was recorded has no loss, whatever the draw; another one has."""
    training = make(supervision="rows")
    dense = haar.forward(training.data.transport.dense())
    monkeypatch.setattr(training, "predict", lambda chosen, k: dense[chosen][:, k])
    assert float(training.loss()) == 0
    monkeypatch.setattr(training, "predict", lambda chosen, k: 0 * dense[chosen][:, k])
    assert float(training.loss()) > 0


def test_the_loss_of_rows_is_the_expected_error_of_images(make, monkeypatch):
    """However wavelets are drawn, the mean over draws is the sum over all wavelets."""
    for draw in ("uniform", "transport"):
        training = make(supervision="rows", draw=draw, strategies={"uniform": 1})
        dense = haar.forward(training.data.transport.dense())
        error = dense * training.prior_power[:, None] * training.slope[:, None, None]
        truth = float(error.square().sum(dim=2).sum(dim=1).mean() / 3)
        monkeypatch.setattr(training, "predict", lambda chosen, k, d=dense: 0 * d[chosen][:, k])
        found = torch.stack([training.loss() for _ in range(400)]).mean()
        assert float(found) == pytest.approx(truth, rel=0.1), draw


def test_a_step_lowers_the_loss_with_every_supervision(make):
    for changes in (
        {},
        {"supervision": "rows"},
        {"lightings_per_view": 2},
        {"target": "full", "lightings": 1},
    ):
        training = make(pixels=64, precision="float32", **changes)
        optimiser = torch.optim.Adam(training.net.parameters(), lr=5e-3)
        losses = []
        for _ in range(60):
            optimiser.zero_grad()
            loss = training.loss()
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
        assert sum(losses[-15:]) < 0.9 * sum(losses[:15]), changes


def test_solid_angles_change_no_radiance(tiny_task):
    """Lightings times and transport over solid angle: the same image, other wavelets."""
    weight = measure(tiny.RESOLUTION, True)
    assert weight.mean() == pytest.approx(1.0) and weight.max() > 1.5 * weight.min()
    data, lighting = tiny_task.training(), tiny_task.train_lightings()[:1]
    rows = data.transport.rows(torch.arange(20)).dense()
    plain = torch.einsum("ptc,ltc->lpc", haar.forward(rows), haar.forward(lighting))
    weighed = torch.einsum("ptc,ltc->lpc", haar.forward(rows / weight), haar.forward(lighting * weight))
    assert torch.allclose(plain, weighed, rtol=1e-3, atol=1e-5 * float(plain.abs().max()))
    assert torch.equal(measure(tiny.RESOLUTION, False), torch.ones(6 * tiny.RESOLUTION**2, 1))


def test_a_model_of_solid_angles_fits_and_truncates_nothing_with_all_wavelets(tiny_task, maps):
    settings = ["method=wavelet_neural", "method.solid_angle=true", "method.training.steps=2",
                f"method.wavelets={6 * tiny.RESOLUTION**2}"]  # fmt: skip
    method = build(compose([*tiny.TASK, *tiny.lights(maps), *settings]), "method")
    method.fit(tiny_task, tiny.Log(), 0, "cpu")
    lighting = tiny.random_cubemap()
    assert torch.allclose(method.truncated(lighting), lighting, atol=1e-4)


@pytest.mark.parametrize(
    "change", ["supervision=pictures", "lightings_per_view=0", "draw=all", "target=none", "gain_points=-1"]
)
def test_settings_out_of_range_are_named(maps, change):
    with pytest.raises(PrtError, match=f"method.training.{change.split('=')[0]}"):
        build(
            compose([*tiny.TASK, *tiny.lights(maps), "method=wavelet_neural", f"method.training.{change}"]),
            "method",
        )

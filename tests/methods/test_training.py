"""What methods share in training: losses, point sampling, the loop that resumes, the running average."""

import numpy as np
import pytest
import tiny
import torch

from prt.bench.fit_log import RunLog
from prt.bench.run_folder import RunFolder
from prt.errors import PrtError
from prt.methods.training import (
    Average,
    PointSampler,
    apportion,
    fit_loop,
    image_loss,
    mu_law,
    mu_law_slope,
    warm_up_then_cosine,
)


@pytest.mark.parametrize(("mu", "epsilon"), [(10.0, 1.0), (64.0, 0.5), (1.0, 2.0)])
def test_mu_law_slope_is_the_derivative(mu, epsilon):
    x = torch.cat([-torch.logspace(-3, 2, 40), torch.logspace(-3, 2, 40)]).double()
    step = 1e-6 * x.abs()
    difference = (mu_law(x + step, mu, epsilon) - mu_law(x - step, mu, epsilon)) / (2 * step)
    assert torch.allclose(mu_law_slope(x, mu, epsilon), difference, rtol=1e-6)


def test_mu_law_maps_zero_to_zero_and_one_to_one():
    assert mu_law(torch.tensor([0.0, 1.0, -1.0])).tolist() == pytest.approx([0.0, 1.0, -1.0])


def test_both_losses_agree_to_first_order_and_only_one_is_unbiased():
    target = torch.rand((4, 50, 3), generator=torch.Generator().manual_seed(0)).double() + 0.2
    near = target * 1.0001
    assert image_loss(near, target, "mu_law_slope") == pytest.approx(
        float(image_loss(near, target)), rel=1e-3
    )
    # where the target is noisy, the gradient at its mean must vanish
    noise = torch.rand(200_000, generator=torch.Generator().manual_seed(1)).double() * 4
    gradients = {}
    for form in ("mu_law", "mu_law_slope"):
        x = torch.tensor(float(noise.mean()), dtype=torch.float64, requires_grad=True)
        image_loss(x.expand_as(noise), noise, form).backward()
        gradients[form] = abs(float(x.grad))
    assert gradients["mu_law_slope"] < 1e-12 < 0.01 < gradients["mu_law"]


def test_an_unknown_loss_is_refused():
    with pytest.raises(PrtError, match="'l2' is not one of mu_law"):
        image_loss(torch.ones(1), torch.ones(1), "l2")


# ---- which points


def importances(count: int) -> dict:
    return {name: torch.ones(count) for name in ("view_variance", "high_frequency", "specular")}


def test_points_are_drawn_in_proportion_to_their_importance():
    weights = torch.tensor([1.0, 0.0, 2.0, 3.0, 0.0, 4.0, -5.0])  # a negative weight counts as zero
    sampler = PointSampler({"specular": 1.0}, {**importances(7), "specular": weights}, 100_000)
    counts = torch.bincount(sampler.draw(torch.Generator().manual_seed(0)), minlength=7)
    assert counts[[1, 4, 6]].tolist() == [0, 0, 0]
    expected = 10_000 * weights[[0, 2, 3, 5]]
    chi2 = float(((counts[[0, 2, 3, 5]] - expected) ** 2 / expected).sum())
    assert chi2 < 16.3  # the 99.9th percentile with three degrees of freedom


def test_shares_split_the_points_and_uniform_reaches_all():
    weights = {**importances(10), "specular": torch.eye(10)[3], "view_variance": torch.eye(10)[7]}
    shares = {"uniform": 2, "specular": 1, "view_variance": 1, "high_frequency": 0}
    points = PointSampler(shares, weights, 40_000).draw(torch.Generator().manual_seed(1))
    counts = torch.bincount(points, minlength=10).numpy()
    assert len(points) == 40_000
    others = np.delete(counts, [3, 7])
    assert counts[3] == pytest.approx(12_000, rel=0.03) == counts[7]
    assert others == pytest.approx(np.full(8, 2_000), rel=0.1)


def test_no_point_is_lost_where_shares_do_not_divide():
    thirds = {"a": 1 / 3, "b": 1 / 3, "c": 1 / 3}
    assert apportion(2, thirds) == {"a": 1, "b": 1, "c": 0} and sum(apportion(11, thirds).values()) == 11
    assert apportion(2, dict.fromkeys("abcd", 0.25)) == {"a": 1, "b": 1, "c": 0, "d": 0}
    assert apportion(1024, dict.fromkeys("abcd", 0.25)) == dict.fromkeys("abcd", 256)
    assert apportion(10, {"a": 0.9, "b": 0.1}) == {"a": 9, "b": 1}


def test_an_importance_of_zero_everywhere_falls_back_to_uniform():
    sampler = PointSampler({"specular": 1.0}, {**importances(5), "specular": torch.zeros(5)}, 5_000)
    counts = torch.bincount(sampler.draw(torch.Generator().manual_seed(0)), minlength=5)
    assert (counts > 800).all()


def test_equal_generators_draw_equal_points():
    sampler = PointSampler({"uniform": 1, "specular": 1}, importances(30), 64)
    a, b = (sampler.draw(torch.Generator().manual_seed(4)) for _ in range(2))
    assert torch.equal(a, b) and not torch.equal(a, sampler.draw(torch.Generator().manual_seed(5)))


def test_bad_shares_are_refused():
    with pytest.raises(PrtError, match="'speculer'"):
        PointSampler({"speculer": 1.0}, importances(3), 8)
    with pytest.raises(PrtError, match="share of 0"):
        PointSampler({"uniform": 0.0}, importances(3), 8)


# ---- the loop


class Fit:
    """A small network fitted to a noisy sine; everything random comes from the generator."""

    def __init__(self, steps: int = 40):
        torch.manual_seed(3)
        self.net = torch.nn.Sequential(torch.nn.Linear(1, 8), torch.nn.Tanh(), torch.nn.Linear(8, 1))
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=0.02)
        self.average = Average(self.net, 0.9)
        self.generator, self.steps = torch.Generator().manual_seed(3), steps

    def step(self) -> torch.Tensor:
        x = torch.rand((16, 1), generator=self.generator) * 2 - 1
        noise = 0.1 * torch.randn((16, 1), generator=self.generator)
        return (self.net(x) - torch.sin(3 * x) - noise).square().mean()

    def run(self, log) -> "Fit":
        fit_loop(log, "test", self.steps, self.generator, {"net": self.net}, self.step, self.optimiser,
                 warm_up_then_cosine(), self.average)  # fmt: skip
        return self

    def weights(self) -> list[torch.Tensor]:
        return [value.detach().clone() for value in self.net.parameters()]


@pytest.mark.parametrize("stop", [1, 2, 17, 40])
@pytest.mark.parametrize("every", [1, 7])
def test_an_interrupted_fit_resumes_to_equal_weights(stop, every):
    whole = Fit().run(log := tiny.Log())
    first = tiny.Log(every, stop_at=stop)
    with pytest.raises(InterruptedError):
        Fit().run(first)
    kept = first.kept
    resumed = Fit().run(second := tiny.Log(every, kept=kept))
    assert all(torch.equal(a, b) for a, b in zip(whole.weights(), resumed.weights(), strict=True))
    done = kept[0] if kept else 0
    assert done == (stop - 1) // every * every
    assert second.losses == log.losses[done:] and first.losses == log.losses[: stop - 1]


def test_resuming_through_the_run_folder_changes_nothing(tmp_path):
    """The same with the real log: state packed to a file, rates and the average among it."""
    whole = Fit().run(tiny.Log())

    class Stops(RunLog):
        def step(self, step, **values):
            if step == 23:
                raise InterruptedError
            super().step(step, **values)

    folder = RunFolder(tmp_path)
    with Stops(folder, 0.0) as log, pytest.raises(InterruptedError):
        Fit().run(log)
    torch.manual_seed(99)
    with RunLog(folder, 0.0) as log:
        resumed = Fit().run(log)
    assert all(torch.equal(a, b) for a, b in zip(whole.weights(), resumed.weights(), strict=True))
    assert list(folder.log().step) == list(range(1, 41))


def test_a_finished_fit_is_not_fitted_again():
    whole = Fit().run(log := tiny.Log())
    again = Fit().run(second := tiny.Log(kept=log.kept))
    assert second.losses == []
    assert all(torch.equal(a, b) for a, b in zip(whole.weights(), again.weights(), strict=True))


def test_nan_stops_the_fit_before_it_reaches_the_weights(tmp_path):
    fit = Fit()
    clean, bad = fit.step, iter([False] * 5 + [True] * 99)
    fit.step = lambda: clean() * (float("nan") if next(bad) else 1.0)
    folder = RunFolder(tmp_path)
    with RunLog(folder, 0.0) as log, pytest.raises(PrtError, match="NaN at step 6, last good.*step 5"):
        fit.run(log)
    assert all(value.isfinite().all() for value in fit.weights())
    with RunLog(folder, 0.0) as log:
        step, state = log.resume()
    assert step == 5 and all(value.isfinite().all() for value in state["net"].values())


def test_a_gradient_that_is_infinite_leaves_no_checkpoint(tmp_path):
    """The square root of zero: a finite loss, whose slope is not."""
    fit, clean = Fit(), Fit.step
    steps = iter(range(1, 99))

    def step():
        slope = clean(fit)
        return slope if next(steps) < 6 else slope + (0 * fit.net[0].weight).abs().sum().sqrt()

    fit.step = step
    folder = RunFolder(tmp_path)
    with (
        RunLog(folder, 0.0) as log,
        pytest.raises(PrtError, match="a weight became NaN or infinite by step 6"),
    ):
        fit.run(log)
    with RunLog(folder, 0.0) as log:
        kept, state = log.resume()
    assert kept == 5 and all(value.isfinite().all() for value in state["net"].values())


def test_the_rate_warms_up_and_ends_low():
    factor = warm_up_then_cosine(warm_up=0.1, last=0.02)
    assert 0 < factor(0.0) < 0.02 and factor(0.1) == pytest.approx(1.0) and factor(1.0) == pytest.approx(0.02)
    rates = [factor(i / 100) for i in range(101)]
    assert max(rates) <= 1.0 and rates[10:] == sorted(rates[10:], reverse=True)


# ---- the running average


def parameter(value: float) -> torch.nn.Module:
    module = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.constant_(module.weight, value)
    return module


def test_the_average_forgets_its_start_and_follows_the_weights():
    module = parameter(0.0)
    average = Average(module, 0.5)
    torch.nn.init.constant_(module.weight, 1.0)
    # its own decay is (1 + n) / (10 + n) while that is smaller: 2/11, 3/12, ...
    average.update()
    assert float(average.shadow["weight"]) == pytest.approx(1 - 2 / 11)
    average.update()
    assert float(average.shadow["weight"]) == pytest.approx(1 - 2 / 11 * 3 / 12)
    for _ in range(60):
        average.update()
    assert float(average.shadow["weight"]) == pytest.approx(1.0)
    torch.nn.init.constant_(module.weight, 3.0)
    average.update()  # by now the decay is the one asked for
    assert float(average.shadow["weight"]) == pytest.approx(2.0)
    assert module.weight.item() == 3.0
    average.swap_in()
    assert module.weight.item() == pytest.approx(2.0)


def test_the_average_comes_back_from_its_state():
    one, two = Average(parameter(0.0), 0.9), Average(parameter(5.0), 0.9)
    torch.nn.init.constant_(one.module.weight, 1.0)
    one.update(), one.update()
    two.load_state_dict(one.state_dict())
    torch.nn.init.constant_(two.module.weight, 1.0)
    one.update(), two.update()
    assert one.updates == two.updates == 3 and torch.equal(one.shadow["weight"], two.shadow["weight"])
    assert one.shadow["weight"].data_ptr() != two.shadow["weight"].data_ptr()


def test_the_average_of_noisy_weights_is_nearer_to_their_mean():
    module, generator = parameter(0.0), torch.Generator().manual_seed(0)
    average, last, mean = Average(module, 0.98), [], []
    for _ in range(600):
        torch.nn.init.constant_(module.weight, float(torch.randn((), generator=generator)))
        average.update()
        last.append(module.weight.item()), mean.append(float(average.shadow["weight"]))
    assert np.std(mean[200:]) < 0.2 * np.std(last[200:])

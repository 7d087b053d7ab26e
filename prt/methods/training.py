"""What methods trained on relit images share: which points, which lightings, which loss, which loop."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.trace.transport import Transport

STRATEGIES = ("uniform", "view_variance", "high_frequency", "specular")


def mu_law(x: Tensor, mu: float = 10.0, epsilon: float = 1.0) -> Tensor:
    """sgn(x) log(mu |x| + epsilon) / log(mu + epsilon) (Raghavan 2023, section 5, after Kalantari 2017)."""
    return x.sign() * torch.log(mu * x.abs() + epsilon) / math.log(mu + epsilon)


def mu_law_slope(x: Tensor, mu: float = 10.0, epsilon: float = 1.0) -> Tensor:
    """Derivative of :func:`mu_law`."""
    return mu / ((mu * x.abs() + epsilon) * math.log(mu + epsilon))


def image_loss(
    prediction: Tensor, target: Tensor, form: str = "mu_law", mu: float = 10.0, epsilon: float = 1.0
) -> Tensor:
    """Mean squared difference after the mu-law tone map.

    ``mu_law`` is the paper's. Its gradient is biased where the target carries Monte Carlo noise, because the
    tone map of a mean is not the mean of the tone map; ``mu_law_slope`` weighs the linear difference by the
    (detached) slope of the tone map at the prediction instead: the same weight to first order, unbiased.
    """
    if form == "mu_law":
        return (mu_law(prediction, mu, epsilon) - mu_law(target, mu, epsilon)).square().mean()
    if form == "mu_law_slope":
        return ((prediction - target) * mu_law_slope(prediction.detach(), mu, epsilon)).square().mean()
    raise PrtError(f"loss form {form!r} is not one of mu_law, mu_law_slope")


@dataclasses.dataclass
class Batch:
    """Some points under some lightings, with their radiance."""

    points: Int[Tensor, "P"]
    lighting_index: Int[Tensor, "L"]
    target: Float[Tensor, "L P 3"]


class PointSampler:
    """Draws training points by the four strategies of Raghavan 2023, section 5, figure 2.

    ``uniform``; ``view_variance``, how much the radiance of one place on the surface changes between views;
    ``high_frequency``, the image minus its low-pass; ``specular``, k_s (1 - sigma). The statistics come from
    the training images under the lighting prior.

    Args:
        shares: strategy to share of the points drawn with it; shares are normalised.
        importance: the per-point weights of each strategy (``task.training().importance``).
    """

    def __init__(self, shares: dict[str, float], importance: dict[str, Tensor], count: int):
        unknown = set(shares) - set(STRATEGIES)
        if unknown:
            raise PrtError(
                f"unknown sampling strategy {sorted(unknown)[0]!r}; choose from {', '.join(STRATEGIES)}"
            )
        positive = {name: share for name, share in shares.items() if share > 0}
        if not positive:
            raise PrtError(
                "method.strategies gives every strategy a share of 0; give at least one a positive share"
            )
        total = sum(positive.values())
        self.counts = apportion(count, {name: share / total for name, share in positive.items()})
        self.cumulative = {
            name: None if name == "uniform" else importance[name].double().clamp(min=0).cumsum(0)
            for name in positive
        }
        self.size = len(importance["specular"])

    def draw(self, generator: torch.Generator, within: range | None = None) -> Int[Tensor, "P"]:
        """Points of the next step; ``within``: only of these, as the points of one view are."""
        first, last = (within.start, within.stop) if within else (0, self.size)
        parts = []
        for name, count in self.counts.items():
            cumulative = self.cumulative[name]
            uniform = torch.rand(count, generator=generator, dtype=torch.float64)
            low = high = 0.0
            if cumulative is not None:
                low, high = float(cumulative[first - 1]) if first else 0.0, float(cumulative[last - 1])
            if cumulative is None or not high > low:
                parts.append((first + uniform * (last - first)).long())
            else:
                place = torch.searchsorted(cumulative, low + uniform * (high - low))
                parts.append(place.clamp(first, last - 1))
        return torch.cat(parts)


def apportion(count: int, shares: dict[str, float]) -> dict[str, int]:
    """Whole numbers in proportion to shares of 1, whose sum is ``count``: largest remainders first."""
    whole = {name: int(count * share) for name, share in shares.items()}
    by_remainder = sorted(shares, key=lambda name: whole[name] - count * shares[name])
    for name in by_remainder[: count - sum(whole.values())]:
        whole[name] += 1
    return whole


def radiance(
    transport: Transport, points: Int[Tensor, "P"], lightings: Float[Tensor, "L T 3"]
) -> Float[Tensor, "L P 3"]:
    """Radiance of some recorded points under some lightings (with the record's noise)."""
    return transport.rows(points).relight(lightings)


class BatchSampler:
    """Points and lightings of a training step with their recorded radiance."""

    def __init__(
        self,
        training: Any,
        lightings: Float[Tensor, "n T 3"],
        pixels: int,
        lightings_per_step: int,
        strategies: dict[str, float],
        device: str = "cpu",
    ):
        self.points = PointSampler(strategies, training.importance, pixels)
        self.training, self.lightings, self.per_step, self.device = (
            training,
            lightings,
            lightings_per_step,
            device,
        )

    def draw(self, generator: torch.Generator) -> Batch:
        points = self.points.draw(generator)
        which = torch.randint(len(self.lightings), (self.per_step,), generator=generator)
        target = radiance(self.training.transport, points, self.lightings[which])
        return Batch(points, which, target.to(self.device))


def fit_loop(
    log: FitLog,
    label: str,
    steps: int,
    generator: torch.Generator,
    modules: dict[str, Any],
    step_fn: Callable[[], Tensor],
    optimiser: torch.optim.Optimizer,
    schedule: Callable[[float], float] = lambda progress: 1.0,
    average: "Average | None" = None,
) -> None:
    """Train to ``steps`` steps with checkpoints; resumes where the log left off, random state included.

    Args:
        modules: everything with ``state_dict`` and ``load_state_dict`` that training changes.
        step_fn: computes the loss of one step, drawing only from ``generator``.
        schedule: factor on every learning rate as a function of progress in [0, 1].
        average: running average of the weights, swapped in at the end.

    Raises:
        PrtError: through ``log.step`` when the loss is NaN or infinite, and for such weights.
    """
    parts = {**modules, "optimiser": optimiser} | ({"average": average} if average else {})
    rates = [group["lr"] for group in optimiser.param_groups]
    first = 0
    kept = log.resume()
    if kept is not None:
        first, state = kept
        for name, part in parts.items():
            part.load_state_dict(state[name])
        generator.set_state(state["generator"])
    log.start(steps, label)
    for step in range(first + 1, steps + 1):
        factor = schedule((step - 1) / steps)
        for group, rate in zip(optimiser.param_groups, rates, strict=True):
            group["lr"] = rate * factor
        optimiser.zero_grad(set_to_none=True)
        loss = step_fn()
        log.step(step, loss=loss.item())
        loss.backward()
        optimiser.step()
        if average:
            average.update()
        if log.checkpoint_due(step):
            check_weights(optimiser, step)
            state = {name: part.state_dict() for name, part in parts.items()}
            log.save(step, {**state, "generator": generator.get_state()})
    if average:
        average.swap_in()


def check_weights(optimiser: torch.optim.Optimizer, step: int) -> None:
    """Refuse weights that are no checkpoint: a gradient can be infinite where the loss was not.

    Raises:
        PrtError: where one of them is NaN or infinite.
    """
    trained = [p.detach() for group in optimiser.param_groups for p in group["params"]]
    if not all(bool(p.isfinite().all()) for p in trained):
        raise PrtError(
            f"a weight became NaN or infinite by step {step}, after the last checkpoint; lower the "
            "method's learning rates or check the lighting, then run again"
        )


def fit_network(
    log: FitLog,
    label: str,
    net: torch.nn.Module,
    settings: dict[str, Any],
    generator: torch.Generator,
    step_fn: Callable[[], Tensor],
    optimiser: torch.optim.Optimizer,
) -> None:
    """:func:`fit_loop` as both learnt methods use it: warm-up, cosine, and averaged weights in the end.

    Args:
        settings: ``steps``, and ``average``, the decay of the running average (0 for none).
    """
    average = Average(net, settings["average"]) if settings["average"] else None
    fit_loop(
        log,
        label,
        settings["steps"],
        generator,
        {"net": net},
        step_fn,
        optimiser,
        warm_up_then_cosine(),
        average,
    )


def warm_up_then_cosine(warm_up: float = 0.02, last: float = 0.02) -> Callable[[float], float]:
    """Linear warm-up over a share of the steps, then a cosine down to ``last``."""

    def factor(progress: float) -> float:
        if progress < warm_up:
            return (progress + 1e-3) / (warm_up + 1e-3)
        done = (progress - warm_up) / (1 - warm_up)
        return last + (1 - last) * 0.5 * (1 + math.cos(math.pi * done))

    return factor


class Average:
    """Exponential running average of a module's parameters."""

    def __init__(self, module: torch.nn.Module, decay: float):
        self.module, self.decay, self.updates = module, decay, 0
        self.shadow = {name: value.detach().clone() for name, value in module.named_parameters()}

    @torch.no_grad()
    def update(self) -> None:
        self.updates += 1
        decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
        names = list(self.shadow)
        current = dict(self.module.named_parameters())
        torch._foreach_lerp_([self.shadow[n] for n in names], [current[n].detach() for n in names], 1 - decay)

    @torch.no_grad()
    def swap_in(self) -> None:
        for name, value in self.module.named_parameters():
            value.copy_(self.shadow[name])

    def state_dict(self) -> dict[str, Any]:
        return {"updates": self.updates, "shadow": dict(self.shadow)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.updates = int(state["updates"])
        for name, value in state["shadow"].items():
            self.shadow[name].copy_(value)

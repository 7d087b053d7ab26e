"""Which state of the scene to train on next: a Markov chain towards large errors (Diolatzis 2022)."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


class StateChain:
    """Metropolis-Hastings over [0, 1]^D, with a density proportional to the training error there.

    The D numbers are the scene vector and whatever else is drawn for a sample, such as the place of the view.
    A large step is uniform, a small one Gaussian in all dimensions and reflected at the borders: both are as
    likely forwards as backwards, so a proposal is accepted with probability ``min(1, error / error before)``.
    Large steps reach everything, so the chain is ergodic.

    One round is ``u = chain.propose()``, the error of a training step on the sample of ``u``, and
    ``chain.accept(u, error)``. Every proposal is trained on, also the rejected ones: rendering it is what
    costs. Errors fall in training, and a chain that remembers an old one would hardly leave: where the
    current sample is trained on again, tell the chain with :meth:`refresh`.

    Args:
        dimension: D, at least 1.
        generator: of all random numbers, on the CPU; its state is not part of :meth:`state`.
        small_step: standard deviation of a small step, of the unit interval.
        large_step_probability: of a uniform step; above 0, at most 1.

    Attributes:
        current: (D,) where the chain is, None before the first sample was accepted.
        error: of the current sample.
        proposed, accepted: counts of (small, large) steps, for the acceptance rates.

    Raises:
        PrtError: for a setting out of range.
    """

    def __init__(
        self,
        dimension: int,
        generator: torch.Generator,
        small_step: float = 0.05,
        large_step_probability: float = 0.3,
    ):
        if not isinstance(dimension, int) or dimension < 1:
            raise PrtError(f"state chain dimension={dimension!r} must be an integer of at least 1")
        if not 0 < small_step <= 1:
            raise PrtError(f"state chain small_step={small_step!r} must be above 0 and at most 1")
        if not 0 < large_step_probability <= 1:
            raise PrtError(
                f"state chain large_step_probability={large_step_probability!r} must be above 0 and "
                "at most 1; without large steps some states may never be reached"
            )
        self.dimension, self.generator = dimension, generator
        self.small_step, self.large_step_probability = small_step, large_step_probability
        self.current: Tensor | None = None
        self.error = 0.0
        self.proposed, self.accepted = [0, 0], [0, 0]
        self.large = True

    def propose(self) -> Float[Tensor, "D"]:
        """Where to take the next sample; uniform as long as there is no current one."""
        draw = self._uniform() < self.large_step_probability
        self.large = draw or self.current is None
        if self.current is None or draw:
            return torch.rand(self.dimension, generator=self.generator)
        step = self.small_step * torch.randn(self.dimension, generator=self.generator)
        return reflected(self.current + step)

    def accept(self, u: Float[Tensor, "D"], error: float) -> bool:
        """Whether the chain moves to the last proposal, whose training error was found to be ``error``.

        Raises:
            ValueError: for an error that is negative or not finite.
        """
        check_error(error)
        moves = self.current is None or self._uniform() * self.error < error or self.error == 0
        self.proposed[self.large] += 1
        self.accepted[self.large] += moves
        if moves:
            self.current, self.error = u.detach().clone(), float(error)
        return moves

    def refresh(self, error: float) -> None:
        """The error that the current sample has by now.

        Raises:
            ValueError: for an error that is negative or not finite.
        """
        check_error(error)
        self.error = float(error)

    def rates(self) -> tuple[float, float]:
        """Shares of accepted small and large steps; NaN where none was proposed."""
        small, large = (
            a / p if p else float("nan") for a, p in zip(self.accepted, self.proposed, strict=True)
        )
        return small, large

    def _uniform(self) -> float:
        return torch.rand((), generator=self.generator).item()

    # ---- checkpoints

    def state(self) -> dict[str, Any]:
        """What :meth:`restore` needs between two rounds, without the generator."""
        current = torch.zeros(0) if self.current is None else self.current.clone()
        return {
            "current": current,
            "error": self.error,
            "proposed": torch.tensor(self.proposed),
            "accepted": torch.tensor(self.accepted),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a kept :meth:`state`."""
        self.current = state["current"].clone() if len(state["current"]) else None
        self.error = float(state["error"])
        self.proposed, self.accepted = state["proposed"].tolist(), state["accepted"].tolist()


def reflected(u: Float[Tensor, "D"]) -> Float[Tensor, "D"]:
    """Values folded back into [0, 1] at its borders, as often as it takes."""
    return 1 - (u.remainder(2) - 1).abs()


def check_error(error: float) -> None:
    """Refuse what is no density; it would stop the chain for ever or silently."""
    if not 0 <= error < float("inf"):
        raise ValueError(f"an error of {error} is no density: it must be finite and not negative")

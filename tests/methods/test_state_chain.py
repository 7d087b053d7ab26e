import math

import pytest
import torch

from prt.errors import PrtError
from prt.methods.state_chain import StateChain, reflected

BINS = 16


def visits(error, count: int, dimension: int = 1, seed: int = 0, **settings) -> torch.Tensor:
    """(count, D) where the chain is after each round; rejected proposals repeat it."""
    chain = StateChain(dimension, torch.Generator().manual_seed(seed), **settings)
    out = []
    for _ in range(count):
        u = chain.propose()
        chain.accept(u, error(u))
        assert chain.current is not None
        out.append(chain.current)
    return torch.stack(out)


def chi_square(values: torch.Tensor, expected: torch.Tensor) -> float:
    counts = torch.histc(values, BINS, 0, 1)
    expected = expected / expected.sum() * len(values)
    return ((counts - expected) ** 2 / expected).sum().item()


def error_function(u: torch.Tensor) -> float:
    """A narrow peak at 0.8 over a floor."""
    return 0.2 + math.exp(-0.5 * ((u[0].item() - 0.8) / 0.07) ** 2)


def expected_share() -> torch.Tensor:
    middle = (torch.arange(BINS * 64) + 0.5) / (BINS * 64)
    return (0.2 + torch.exp(-0.5 * ((middle - 0.8) / 0.07) ** 2)).view(BINS, 64).sum(1)


@pytest.mark.parametrize(
    ("small_step", "large_step_probability"), [(0.1, 0.3), (0.05, 0.8), (0.7, 0.1), (0.1, 1.0)]
)
def test_stationary_distribution_is_the_error(small_step, large_step_probability):
    """Every 10th of 16 000: nearly independent. 15 degrees of freedom: 37.7 is passed once in a thousand."""
    settings = {"small_step": small_step, "large_step_probability": large_step_probability}
    seen = visits(error_function, 16_000, **settings)[::10, 0]
    assert chi_square(seen, expected_share()) < 37.7
    assert chi_square(seen, torch.ones(BINS)) > 500  # the bound does tell distributions apart


@pytest.mark.parametrize("small_step", [0.1, 0.9])
def test_constant_error_gives_uniform_states(small_step):
    """All proposals are accepted; the borders are neither avoided nor preferred."""
    seen = visits(lambda u: 3.0, 16_000, small_step=small_step)[::10, 0]
    assert chi_square(seen, torch.ones(BINS)) < 37.7
    assert seen.min() < 0.01 and seen.max() > 0.99


def test_dimensions_are_explored_together():
    """Density u_0 u_1: the mean of each coordinate is 2/3, and they are independent."""
    seen = visits(lambda u: (u[0] * u[1]).item(), 12_000, dimension=2, small_step=0.2)
    torch.testing.assert_close(seen.mean(0), torch.full((2,), 2 / 3), rtol=0, atol=0.02)
    assert torch.corrcoef(seen.T)[0, 1].abs() < 0.06


def test_small_steps_are_small_and_large_ones_uniform():
    chain = StateChain(3, torch.Generator().manual_seed(0), small_step=0.01, large_step_probability=0.4)
    chain.accept(torch.full((3,), 0.5), 1.0)
    steps = []
    for _ in range(2000):
        u = chain.propose()
        assert (u >= 0).all() and (u <= 1).all()
        steps.append((chain.large, (u - 0.5).abs().max().item()))
    assert max(step for large, step in steps if not large) < 0.06
    assert max(step for large, step in steps if large) > 0.49
    assert sum(large for large, _ in steps) / 2000 == pytest.approx(0.4, abs=0.04)


def test_errors_of_zero():
    chain = StateChain(1, torch.Generator().manual_seed(0))
    assert chain.accept(chain.propose(), 0.0)  # the first sample always
    assert chain.accept(chain.propose(), 0.0)  # nothing is worse than the current one
    assert chain.accept(chain.propose(), 1.0)
    assert not any(chain.accept(chain.propose(), 0.0) for _ in range(50))
    chain.refresh(0.0)
    assert chain.accept(chain.propose(), 1e-9)


def test_refreshed_error_frees_the_chain():
    chain = StateChain(1, torch.Generator().manual_seed(0))
    chain.accept(chain.propose(), 1e9)
    assert not any(chain.accept(chain.propose(), 1.0) for _ in range(50))
    chain.refresh(1.0)
    assert chain.accept(chain.propose(), 1.0)
    small, large = chain.rates()
    assert 0 <= small < 0.1 and 0 < large < 0.2


def test_goes_on_from_a_checkpoint():
    generator = torch.Generator().manual_seed(0)
    chain = StateChain(2, generator)
    for _ in range(20):
        u = chain.propose()
        chain.accept(u, u[0].item())
    kept, random_numbers = chain.state(), generator.get_state()

    def rounds(chain: StateChain) -> list[list[float]]:
        out = []
        for _ in range(20):
            u = chain.propose()
            chain.accept(u, u[0].item())
            out.append(u.tolist())
        return out

    other_generator = torch.Generator()
    other_generator.set_state(random_numbers)
    other = StateChain(2, other_generator)
    other.restore(kept)
    assert rounds(chain) == rounds(other)
    assert chain.rates() == other.rates()


def test_fresh_chain_survives_a_checkpoint():
    chain = StateChain(2, torch.Generator())
    chain.restore(chain.state())
    assert chain.current is None


def test_reflection():
    u = torch.tensor([-0.25, 0.0, 0.3, 1.0, 1.25, 2.5, -1.5])
    torch.testing.assert_close(reflected(u), torch.tensor([0.25, 0.0, 0.3, 1.0, 0.75, 0.5, 0.5]))


@pytest.mark.parametrize("error", [float("nan"), float("inf"), -1.0])
def test_error_that_is_no_density(error):
    chain = StateChain(1, torch.Generator())
    with pytest.raises(ValueError, match="density"):
        chain.accept(chain.propose(), error)


@pytest.mark.parametrize(
    ("setting", "value"), [("dimension", 0), ("small_step", 0.0), ("large_step_probability", 0.0)]
)
def test_mistakes(setting, value):
    with pytest.raises(PrtError, match=f"{setting}={value}"):
        StateChain(**{"dimension": 1, "generator": torch.Generator(), setting: value})

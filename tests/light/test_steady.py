"""Selections of a moving light: no more than K at a time, no jumps, no swapping back and forth."""

import pytest
import torch

from prt.errors import PrtError
from prt.light.steady import SteadySelection


def swapping(frame: int) -> torch.Tensor:
    """Two wavelets that trade the last of three places in every frame, far above a fourth."""
    wobble = 0.1 if frame % 2 else -0.1
    return torch.tensor([5.0, 4.0, 1 + wobble, 1 - wobble, 0.1])


def test_the_first_frame_keeps_the_largest():
    index, level = SteadySelection(2).next(torch.tensor([1.0, 3.0, 2.0]))
    assert index.tolist() == [1, 2] and level.tolist() == [1, 1]


def test_wavelets_of_about_the_last_rank_are_not_swapped():
    steady = SteadySelection(3, leave=0.7, fade=4)
    kept = {tuple(steady.next(swapping(frame))[0].tolist()) for frame in range(10)}
    assert len(kept) == 1
    plain = SteadySelection(3, leave=1.0, fade=1)
    assert len({tuple(sorted(plain.next(swapping(frame))[0].tolist())) for frame in range(10)}) == 2


def test_a_wavelet_that_falls_leaves_in_steps_and_another_takes_its_place():
    steady = SteadySelection(2, leave=0.7, fade=4)
    steady.next(torch.tensor([3.0, 2.0, 0.0]))
    after = torch.tensor([3.0, 0.5, 2.0])
    seen = []
    for _ in range(10):
        index, level = steady.next(after)
        assert len(index) <= 2
        seen.append(dict(zip(index.tolist(), level.tolist(), strict=True)))
    assert [round(frame.get(1, 0.0), 2) for frame in seen[:4]] == [0.75, 0.5, 0.25, 0.0]
    assert seen[-1] == {0: 1.0, 2: 1.0}
    levels = [frame.get(2, 0.0) for frame in seen]
    assert max(b - a for a, b in zip(levels, levels[1:], strict=False)) <= 0.25 + 1e-6


def test_a_wavelet_that_recovers_fades_in_again():
    steady = SteadySelection(2, leave=0.7, fade=4)
    for rank in ([3.0, 2.0, 0.0], [3.0, 0.5, 2.0], [3.0, 0.5, 2.0]):
        steady.next(torch.tensor(rank))
    levels = []
    for _ in range(3):
        index, level = steady.next(torch.tensor([3.0, 2.0, 1.0]))
        levels.append(float(level[index == 1]))
    assert levels == pytest.approx([0.75, 1.0, 1.0])


def test_without_hysteresis_or_fading_it_is_the_plain_selection():
    steady = SteadySelection(4, leave=1.0, fade=1)
    generator = torch.Generator().manual_seed(0)
    first = torch.rand(20, generator=generator)
    steady.next(first)
    # what leaves is gone in the frame after, so a plain selection is reached one frame late
    target = torch.rand(20, generator=generator)
    for _ in range(2):
        index, level = steady.next(target)
    assert set(index.tolist()) == set(target.topk(4).indices.tolist()) and bool((level == 1).all())


@pytest.mark.parametrize("change", [dict(count=0), dict(leave=1.5), dict(fade=0)])
def test_settings_out_of_range_are_named(change):
    with pytest.raises(PrtError, match=next(iter(change))):
        SteadySelection(**{"count": 3, **change})

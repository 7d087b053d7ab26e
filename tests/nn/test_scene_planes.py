"""Planes of coordinates and variables: the folded lookup against the plain one; the state's network."""

import pytest
import torch

from prt.errors import PrtError
from prt.nn.scene_planes import PlainState, ScenePlanes, StateNetwork

BOUNDS = ((-1.0, 0.0, 2.0), (1.0, 3.0, 2.5))


def planes(variables=3, **changes):
    settings = {"levels": 2, "features": 2, "base_resolution": 4, "scale": 2.0, "bounds": BOUNDS}
    made = ScenePlanes(variables, **(settings | changes), generator=torch.Generator().manual_seed(0))
    for plane in made.planes:
        torch.nn.init.normal_(plane, generator=torch.Generator().manual_seed(1))
    return made


def points(count=40):
    generator = torch.Generator().manual_seed(2)
    low, high = (torch.tensor(corner) for corner in BOUNDS)
    return low + (high - low) * (1.4 * torch.rand((count, 3), generator=generator) - 0.2)  # some are outside


def by_variable(found, variables, features):
    """Outputs ordered as the readable version has them: level, axis, variable, feature."""
    return found.reshape(len(found), -1, variables, features).flatten(1)


@pytest.mark.parametrize("v", [[0.0, 1.0, 0.37], [0.5, 0.999, 0.25], [-0.2, 1.3, 0.61]])
def test_lines_give_what_planes_give(v):
    made, where, v = planes(), points(), torch.tensor(v)
    fast, slow = made(where, made.at(v)), made.forward_readable(where, v)
    assert fast.shape == (40, made.outputs) == slow.shape
    torch.testing.assert_close(by_variable(fast, 3, 2), slow)
    weights = torch.randn(slow.shape, generator=torch.Generator().manual_seed(3))
    gradients = [
        torch.autograd.grad((found * weights).sum(), list(made.planes))
        for found in (made(where, made.at(v)), made.forward_readable(where, v))
    ]
    for fast, slow in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, slow)


def test_it_is_exact_at_its_own_corners_and_linear_between():
    made = planes(variables=1, levels=1)
    low, high = (torch.tensor(corner) for corner in BOUNDS)
    where = torch.stack([low, low + (high - low) / 4, (low + low + (high - low) / 4) / 2])
    found = made(where, made.at(torch.tensor([0.25])))[:, :2]
    table = made.planes[0][0, 0, 1]
    torch.testing.assert_close(found, torch.stack([table[0], table[1], (table[0] + table[1]) / 2]))


def test_a_variable_may_have_a_resolution_of_its_own():
    made, where, v = planes(variable_resolution=3), points(), torch.tensor([0.1, 0.5, 0.9])
    torch.testing.assert_close(by_variable(made(where, made.at(v)), 3, 2), made.forward_readable(where, v))
    assert made.nbytes() < planes().nbytes()


def test_cost_is_linear_in_the_variables():
    sizes = [planes(variables=n).nbytes() for n in (1, 2, 3, 4)]
    assert len({b - a for a, b in zip(sizes, sizes[1:], strict=False)}) == 1


def test_the_state_network_sees_all_octaves():
    net = StateNetwork(2, 8, 1, 8, generator=torch.Generator().manual_seed(0))
    a, b = (net(torch.tensor([0.3, v])) for v in (0.5, 0.5 + 1 / 256))
    assert a.shape == (8,) == (net.outputs,)
    assert (a - b).abs().max() > 1e-3
    assert torch.equal(PlainState(2)(torch.tensor([0.0, 1.0])), torch.tensor([-1.0, 1.0]))


@pytest.mark.parametrize("change", [{"levels": 0}, {"features": 0}, {"base_resolution": 0}, {"scale": 0.5}])
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(PrtError, match=next(iter(change))):
        planes(**change)

import pytest
import torch

from prt.errors import PrtError
from prt.nn.kplanes import KPlanes

BOUNDS = ((-1.0, -2.0, 0.0), (1.0, 2.0, 1.0))


def planes(variables: int = 3, **changes) -> KPlanes:
    settings = dict(levels=2, features=3, base_resolution=4, scale=1.7, variable_resolution=5, bounds=BOUNDS)
    generator = torch.Generator().manual_seed(0)
    made = KPlanes(variables, **{**settings, **changes}, generator=generator)
    with torch.no_grad():
        for plane in (*made.mixed, *made.states):
            plane.uniform_(0.5, 1.5, generator=generator)
    return made


def points(count: int = 200) -> torch.Tensor:
    """Some in the box, some on its corners, some outside."""
    low, high = torch.tensor(BOUNDS)
    inside = low + (high - low) * torch.rand(count, 3, generator=torch.Generator().manual_seed(1))
    return torch.cat([inside, low[None], high[None], low[None] - 3, high[None] + 3])


STATES = ([0.3, 0.62, 0.91], [0.0, 1.0, 0.4], [-0.5, 0.5, 1.5])


@pytest.mark.parametrize("v", STATES)
@pytest.mark.parametrize(("variables", "features"), [(1, 3), (2, 1), (3, 8)])
def test_fast_equals_slow_with_gradients(variables, features, v, monkeypatch):
    monkeypatch.setattr("prt.nn.kplanes.BLOCK", 64)  # several blocks, the last of them short
    net, x, state = planes(variables, features=features), points(), torch.tensor(v[:variables])
    weight = torch.randn(net.outputs, generator=torch.Generator().manual_seed(2))
    outputs, gradients = [], []
    for evaluate in (lambda: net(x, net.at(state)), lambda: net.slow(x, state)):
        net.zero_grad()
        out = evaluate()
        (out * weight).sin().sum().backward()
        outputs.append(out.detach())
        gradients.append([p.grad.clone() for p in net.parameters() if p.numel()])
    assert outputs[0].shape == (len(x), 2 * features) == (len(x), net.outputs)
    torch.testing.assert_close(outputs[0], outputs[1], rtol=1e-5, atol=1e-6)
    for fast, slow in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, slow, rtol=1e-4, atol=1e-5)
        assert fast.abs().sum() > 0


def test_gradient_holds_where_factors_are_zero():
    net, x, v = planes(2), points(20), torch.tensor([0.2, 0.7])
    with torch.no_grad():
        net.space[0][: 5 * 5] = 0  # all of the plane xy
        net.mixed[0][0, 0] = 0
    gradients = []
    for out in (net(x, net.at(v)), net.slow(x, v)):
        net.zero_grad()
        out.sum().backward()
        gradients.append([p.grad.clone() for p in net.parameters()])
    for fast, slow in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, slow, rtol=1e-4, atol=1e-5)


def test_fresh_planes_know_no_state():
    """The planes that involve a variable start at 1, the identity of the product; space within [0.1, 0.5]."""
    net = KPlanes(2, 2, 3, 4, 1.7, 5, BOUNDS, torch.Generator().manual_seed(0))
    x = points()
    first, second = (net(x, net.at(torch.tensor(v))) for v in ([0.1, 0.2], [0.8, 0.4]))
    torch.testing.assert_close(first, second)
    assert 0.1**3 <= first.min() and first.max() <= 0.5**3


def test_states_and_points_are_clamped():
    net, x = planes(2), points(4)
    inside, outside = net.at(torch.tensor([0.0, 1.0])), net.at(torch.tensor([-3.0, 7.0]))
    assert torch.equal(net(x, inside), net(x, outside))
    out = net(x, inside)
    assert torch.equal(out[-2:], out[-4:-2])


def test_a_product_of_functions_of_one_coordinate_is_exact():
    """f(x) g(v) with linear f and g, stored in the planes (x, v), is reproduced between the corners."""
    net = planes(1, levels=1, features=1)
    with torch.no_grad():
        for plane in (*net.space, *net.mixed):
            plane.fill_(1)
        along_x, along_v = torch.linspace(0, 1, 5), torch.linspace(0, 1, 6)
        net.mixed[0][0, 0, :, :, 0] = (2 + along_v)[:, None] * (1 + 3 * along_x)
    x = points()[:200]
    expected = (2 + 0.37) * (1 + 3 * (x[:, 0] + 1) / 2)
    torch.testing.assert_close(net(x, net.at(torch.tensor([0.37])))[:, 0], expected)


def test_bytes_and_number_of_planes():
    net = planes(4, levels=1, features=2)
    assert len(net.space[0]) // 5**2 + 4 * 3 + len(net.states[0]) == 7 * 6 // 2
    assert net.nbytes() == 4 * 2 * (3 * 5 * 5 + 4 * 3 * 6 * 5 + 6 * 6 * 6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"features": 0}, "features=0"),
        ({"variable_resolution": 2.5}, "variable_resolution=2.5"),
        ({"scale": 0.5}, "scale=0.5"),
        ({"bounds": ((0, 0, 0), (0, 0, 0))}, "bounds"),
        ({"variables": 0}, "variables=0"),
    ],
)
def test_mistakes(change, said):
    with pytest.raises(PrtError, match=said):
        planes(**change)

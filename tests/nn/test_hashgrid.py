import pytest
import torch

from prt.errors import PrtError
from prt.nn.hashgrid import HashGrid

BOUNDS = ((-1.0, -2.0, 0.0), (1.0, 2.0, 1.0))


def grid(**changes) -> HashGrid:
    settings = dict(levels=6, features=2, log2_table=9, base_resolution=4, scale=1.7, bounds=BOUNDS)
    made = HashGrid(**{**settings, **changes}, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        made.table.mul_(1e4)
    return made


def points(count: int = 200) -> torch.Tensor:
    low, high = torch.tensor(BOUNDS)
    return low + (high - low) * torch.rand(count, 3, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("features", [1, 2, 4])
def test_fast_equals_readable(features):
    net, x = grid(features=features), points()
    assert 0 < net.dense_levels < net.levels  # both kinds of level are covered
    weight = torch.randn(net.out_features, generator=torch.Generator().manual_seed(2))
    gradients = []
    outputs = []
    for evaluate in (net.forward, net.forward_readable):
        net.table.grad = None
        out = evaluate(x)
        (out * weight).sin().sum().backward()
        outputs.append(out.detach())
        gradients.append(net.table.grad.clone())
    assert outputs[0].shape == (200, 6 * features)
    torch.testing.assert_close(outputs[0], outputs[1], rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-5, atol=1e-5)
    assert gradients[0].abs().sum() > 0


def test_cached_corners_equal_forward():
    net, x = grid(), points()
    chosen = torch.tensor([5, 3, 3, 150])
    torch.testing.assert_close(net.lookup(net.corners(x).rows(chosen)), net(x[chosen]))


def test_gradient_is_deterministic():
    net, x = grid(), points(5000)
    first = torch.autograd.grad(net(x).square().sum(), net.table)[0]
    second = torch.autograd.grad(net(x).square().sum(), net.table)[0]
    assert torch.equal(first, second)


def test_dense_level_interpolates_linearly():
    # A linear function stored at the corners of a dense level is reproduced everywhere.
    net = grid(levels=1, log2_table=12, features=1)
    assert net.dense_levels == 1
    cells = net.last_cell[0] + 1
    assert cells.tolist() == [2, 4, 1]  # cubes of side 1: 4 along the longest side
    z, y, x = torch.meshgrid(*(torch.arange(n + 1.0) for n in reversed(cells.tolist())), indexing="ij")
    with torch.no_grad():
        net.table[:, 0] = (x - 1 + 2 * (y - 2) - 3 * z).flatten()
    where = points()
    torch.testing.assert_close(net(where)[:, 0], where @ torch.tensor([1.0, 2.0, -3.0]), rtol=1e-4, atol=1e-5)


def test_weights_sum_to_one_and_rows_are_inside():
    net = grid()
    indices, weights = net.corners(torch.cat([points(), torch.tensor(BOUNDS)]))
    torch.testing.assert_close(weights.sum(2), torch.ones(202, 6))
    assert weights.min() >= 0
    ends = [*net.offsets.tolist()[1:], len(net.table)]
    for level in range(net.levels):
        assert indices[:, level].min() >= net.offsets[level] and indices[:, level].max() < ends[level]


def test_points_outside_are_clamped():
    net = grid()
    outside = torch.tensor([[-5.0, 0.0, 0.5], [0.0, 9.0, 7.0]])
    inside = torch.tensor([[-1.0, 0.0, 0.5], [0.0, 2.0, 1.0]])
    assert torch.equal(net(outside), net(inside))


def test_sizes():
    assert grid().nbytes() == len(grid().table) * 2 * 4
    # the paper's settings (section 5) come to about 107 MB: 32 levels, 2 features, 2^19 rows
    rows = [min((int(16 * 1.3**level) + 1) ** 3, 1 << 19) for level in range(32)]
    small = HashGrid(32, 2, 10, 16, 1.3, ((0, 0, 0), (1, 1, 1)))
    assert len(small.table) == sum(min(row, 1 << 10) for row in rows)
    assert 95e6 < sum(rows) * 2 * 4 < 112e6


def test_empty_batch():
    assert grid()(torch.zeros((0, 3))).shape == (0, 12)


WRONG = [
    dict(levels=0), dict(log2_table=40), dict(scale=0.5), dict(scale=9.0, levels=20),
    dict(bounds=((0, 0, 0), (0, 0, 0))), dict(bounds=((0, 0, 1), (1, 1, 0))),
]  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_settings(wrong):
    with pytest.raises(PrtError, match=next(iter(wrong))):
        grid(**wrong)

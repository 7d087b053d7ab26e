import itertools

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.nn.hashgrid_4d import HashGrid4d

BOUNDS = ((-1.0, -2.0, 0.0), (1.0, 2.0, 1.0))
PRIMES = (1, 2654435761, 805459861, 3674653429)


def grid(**changes) -> HashGrid4d:
    settings = dict(
        variables=1, levels=4, features=2, log2_table=9, base_resolution=3, scale=1.7, bounds=BOUNDS
    )
    made = HashGrid4d(**{**settings, **changes}, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        made.table.mul_(1e4)
    return made


def points(count: int = 100) -> torch.Tensor:
    low, high = torch.tensor(BOUNDS)
    inside = low + (high - low) * torch.rand(count, 3, generator=torch.Generator().manual_seed(1))
    return torch.cat([inside, low[None], high[None], high[None] + 3])


def direct(net: HashGrid4d, x: torch.Tensor, v: float, table: np.ndarray) -> np.ndarray:
    """16 corners a point and level, in float64 and with unbounded integers; sides of the box are 2, 4, 1."""
    low, high = np.array(BOUNDS)
    unit = (np.clip(x.double().numpy(), low, high) - low) / 4
    out = []
    for level, r in enumerate(net.cells):
        count = [max(1, int(np.ceil(side * r - 1e-6))) for side in (0.5, 1, 0.25)] + [r]
        place = np.column_stack([unit * r, np.full(len(unit), min(max(v, 0), 1) * r)])
        cell = np.minimum(place.astype(int), np.array(count) - 1)
        part = place - cell
        dense = np.prod(np.array(count) + 1) <= 512
        feature = np.zeros((len(unit), net.table.shape[1]))
        for corner in itertools.product((0, 1), repeat=4):
            weight = np.where(corner, part, 1 - part).prod(1)
            for n, at in enumerate(cell + np.array(corner)):
                if dense:
                    row, stride = 0, 1
                    for index, axis in zip(at, count, strict=True):
                        row, stride = row + int(index) * stride, stride * (axis + 1)
                else:
                    row = 0
                    for index, prime in zip(at, PRIMES, strict=True):
                        row ^= int(index) * prime
                    row %= 512
                feature[n] += weight[n] * table[net.offsets[level] + row]
        out.append(feature)
    return np.concatenate(out, 1)


@pytest.mark.parametrize("v", [0.0, 0.37, 1.0, 1.4])
def test_equals_direct_interpolation(v):
    net, x = grid(), points()
    out = net(x, net.at(torch.tensor([v])))
    assert out.shape == (len(x), net.outputs) == (len(x), 8)
    expected = direct(net, x, v, net.table.detach().double().numpy())
    np.testing.assert_allclose(out.detach().numpy(), expected, rtol=1e-4, atol=1e-5)


def test_dense_levels_come_first_and_all_kinds_are_covered():
    """Dense in four dimensions, dense only in three, hashed in both."""
    net = grid()
    kinds = [
        (
            "dense" if level < net.space.dense_levels else "hashed",
            int((net.space.last_cell[level] + 2).prod()),
        )
        for level in range(4)
    ]
    assert kinds[0] == ("dense", 4 * 3 * 2)
    assert any(kind == "hashed" and corners <= 512 for kind, corners in kinds)
    assert any(kind == "hashed" and corners > 512 for kind, corners in kinds)


def test_gradient_is_that_of_the_direct_interpolation():
    """The interpolation is linear in the table: its gradient is the weight that a direct one gives a row."""
    net, x, v = grid(features=1), points(20), torch.tensor([0.61])
    weight = torch.randn(net.outputs, generator=torch.Generator().manual_seed(2))
    (net(x, net.at(v)) * weight).sum().backward()
    change = torch.randn(net.table.shape, generator=torch.Generator().manual_seed(3)).double()
    expected = (direct(net, x, 0.61, change.numpy()) * weight.double().numpy()).sum()
    assert (net.table.grad * change).sum().item() == pytest.approx(expected, rel=1e-4)
    assert net.table.grad.count_nonzero() > 100


def test_a_linear_function_of_four_coordinates_is_exact():
    net = grid(levels=1, features=1, log2_table=12)
    assert net.space.dense_levels == 1
    with torch.no_grad():
        v, z, y, x = torch.meshgrid(*(torch.arange(n + 1.0) for n in (3, 1, 3, 2)), indexing="ij")
        net.table[:, 0] = (2 * x - y + 3 * z + 5 * v).flatten()
    at = points()[:100]
    place = (at - torch.tensor(BOUNDS[0])) / 4 * 3
    expected = 2 * place[:, 0] - place[:, 1] + 3 * place[:, 2] + 5 * 0.4 * 3
    torch.testing.assert_close(net(at, net.at(torch.tensor([0.4])))[:, 0], expected, rtol=1e-4, atol=1e-4)


def test_making_one_leaves_torchs_random_numbers_alone():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    grid()
    assert torch.equal(torch.rand(1), expected)


@pytest.mark.parametrize("variables", [0, 2, 7])
def test_other_numbers_of_variables_are_refused(variables):
    with pytest.raises(PrtError, match=f"1 variable, not {variables}"):
        grid(variables=variables)


def test_settings_are_those_of_the_hash_grid():
    with pytest.raises(PrtError, match="log2_table=0"):
        grid(log2_table=0)
    assert grid().nbytes() == 4 * 2 * len(grid().table)

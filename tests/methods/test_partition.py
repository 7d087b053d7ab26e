"""Cells of a large scene: who serves a place, who learns from beyond the rim, and which cells are merged."""

import pytest
import torch

from prt.errors import PrtError
from prt.methods.partition import partition, whole

BOX = ((0.0, 0.0, 0.0), (4.0, 1.0, 1.0))


def row_of_points(values):
    """100 points in each of four cells along x; the transfer of a cell is a constant."""
    x = torch.linspace(0.005, 3.995, 400)
    position = torch.stack([x, torch.full_like(x, 0.5), torch.full_like(x, 0.5)], 1)
    return position, torch.tensor(values)[(x.long()).clamp(max=3)][:, None].repeat(1, 2)


def test_no_partition_is_one_group():
    grid = whole(BOX)
    assert grid.groups == 1 and grid.group_of(torch.rand((5, 3))).tolist() == [0] * 5


def test_the_most_alike_neighbours_are_merged_first():
    position, transfer = row_of_points([0.0, 0.1, 1.0, 1.05])
    assert partition(BOX, (4, 1, 1), 4, position, transfer).group.tolist() == [0, 1, 2, 3]
    assert partition(BOX, (4, 1, 1), 3, position, transfer).group.tolist() == [0, 1, 2, 2]
    assert partition(BOX, (4, 1, 1), 2, position, transfer).group.tolist() == [0, 0, 1, 1]
    assert partition(BOX, (4, 1, 1), 1, position, transfer).group.tolist() == [0, 0, 0, 0]


def test_cells_far_apart_are_not_merged_however_alike():
    position, transfer = row_of_points([0.0, 1.0, 0.0, 0.4])
    assert partition(BOX, (4, 1, 1), 3, position, transfer).group.tolist() == [0, 1, 2, 2]


def test_a_cell_without_points_goes_to_the_nearest_group():
    position, transfer = row_of_points([0.0, 0.0, 1.0, 2.0])
    keep = (position[:, 0] < 1) | (position[:, 0] > 2)
    grid = partition(BOX, (4, 1, 1), 3, position[keep], transfer[keep])
    assert grid.group[1] in (grid.group[0], grid.group[2]) and grid.groups == 3


def test_islands_are_merged_in_the_end():
    position, transfer = row_of_points([0.0, 5.0, 5.0, 0.0])
    keep = (position[:, 0] < 1) | (position[:, 0] > 3)
    assert partition(BOX, (4, 1, 1), 1, position[keep], transfer[keep]).groups == 1


def test_margins_and_places_outside():
    position, transfer = row_of_points([0.0, 1.0, 2.0, 3.0])
    grid = partition(BOX, (4, 1, 1), 4, position, transfer)
    assert grid.near(position, 1, 0.0).sum() == 100
    assert grid.near(position, 1, 0.25).sum() == 150
    assert grid.near(position, 0, 0.25).sum() == 125
    outside = torch.tensor([[-3.0, 9.0, 0.5], [7.0, 0.5, -2.0]])
    assert grid.group_of(outside).tolist() == [0, 3]
    assert bool(grid.near(outside, 0, 0.0)[0])  # a cell at the rim has no end


@pytest.mark.parametrize(("cells", "networks", "message"), [
    ((0, 1, 1), 1, r"cells=\[0, 1, 1\]"), ((4, 1, 1), 5, "networks=5 must lie between 1 and 4"),
    ((4, 1, 1), 0, "networks=0"),
])  # fmt: skip
def test_refusals(cells, networks, message):
    with pytest.raises(PrtError, match=message):
        partition(BOX, cells, networks, *row_of_points([0.0, 1.0, 2.0, 3.0]))

"""A large scene cut into cells with a network each, cells that are alike merged (Dhawal 2022, 4.4)."""

import dataclasses
import itertools

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError


@dataclasses.dataclass
class Partition:
    """A box cut into ``cells`` equal boxes, each belonging to one of several groups.

    Attributes:
        low, high: corners of the box, world units.
        cells: number along x, y and z.
        group: of each cell, x fastest; a group is a union of neighbouring cells.
    """

    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]
    cells: tuple[int, int, int]
    group: Int[Tensor, "C"]

    @property
    def groups(self) -> int:
        """How many there are."""
        return int(self.group.max()) + 1

    def to(self, device: str) -> "Partition":
        return dataclasses.replace(
            self, low=self.low.to(device), high=self.high.to(device), group=self.group.to(device)
        )

    def cell_of(self, position: Float[Tensor, "N 3"]) -> Int[Tensor, "N"]:
        """The cell a place lies in; places outside of the box count to the nearest one."""
        many = torch.tensor(self.cells, device=position.device)
        size = (self.high - self.low).clamp_min(1e-12)
        place = ((position - self.low) / size * many).floor().long().clamp_min(0).minimum(many - 1)
        return place[:, 0] + many[0] * (place[:, 1] + many[1] * place[:, 2])

    def group_of(self, position: Float[Tensor, "N 3"]) -> Int[Tensor, "N"]:
        """The group whose network serves a place."""
        return self.group[self.cell_of(position)]

    def near(self, position: Float[Tensor, "N 3"], group: int, margin: float) -> Bool[Tensor, "N"]:
        """Whether a place lies in a group's cells or no further than ``margin`` from one along each axis.

        Figure 4: "We sample delta area more into the adjacent sub-scene".
        """
        out = torch.zeros(len(position), dtype=torch.bool, device=position.device)
        for cell in (self.group == group).nonzero()[:, 0].tolist():
            low, high = self.box_of(cell)
            out |= ((position >= low - margin) & (position <= high + margin)).all(1)
        return out

    def box_of(self, cell: int) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
        """Corners of a cell; those at the rim of the scene reach beyond it without end."""
        x, y, _ = self.cells
        place = (cell % x, cell // x % y, cell // (x * y))
        low, high = self.low.clone(), self.high.clone()
        step = (self.high - self.low) / torch.tensor(self.cells, device=self.low.device)
        for axis in range(3):
            at, last = place[axis], self.cells[axis] - 1
            low[axis] = -torch.inf if at == 0 else self.low[axis] + at * step[axis]
            high[axis] = torch.inf if at == last else self.low[axis] + (at + 1) * step[axis]
        return low, high


def whole(bounds: tuple[tuple[float, ...], tuple[float, ...]]) -> Partition:
    """One cell and one group: no partition."""
    low, high = (torch.tensor(corner, dtype=torch.float32) for corner in bounds)
    return Partition(low, high, (1, 1, 1), torch.zeros(1, dtype=torch.long))


def partition(
    bounds: tuple[tuple[float, ...], tuple[float, ...]],
    cells: tuple[int, int, int],
    networks: int,
    position: Float[Tensor, "N 3"],
    transfer: Float[Tensor, "N K"],
) -> Partition:
    """Merge neighbouring cells until ``networks`` groups are left, the most alike first.

    Each step joins the two neighbouring groups whose union has the least sum of squared deviations of its
    transfer vectors from their mean (the variance analysis that section 4.4 takes from CPCA, Sloan 2003): a
    cell of little variance or few points is cheap to serve along with its neighbour. Cells without a point
    go to the nearest group.

    Raises:
        PrtError: for cells that are no three positive numbers, or more networks than cells with points.
    """
    if len(cells) != 3 or min(cells) < 1:
        raise PrtError(
            f"method.cells={list(cells)} must be three numbers of at least 1 (cells along x, y, z)"
        )
    low, high = (torch.tensor(corner, dtype=torch.float32) for corner in bounds)
    one = Partition(low, high, cells, torch.arange(cells[0] * cells[1] * cells[2]))
    cell = one.cell_of(position)
    used = cell.unique().tolist()
    if not 1 <= networks <= len(used):
        raise PrtError(
            f"method.networks={networks} must lie between 1 and {len(used)}, the cells of "
            f"method.cells={list(cells)} that hold surface"
        )
    moments = {k: _Moments.of(transfer[cell == k]) for k in used}
    members = {k: {k} for k in used}
    while len(members) > networks:
        pairs = [
            (float((moments[a] + moments[b]).deviation), a, b)
            for a, b in itertools.combinations(sorted(members), 2)
            if _touch(members[a], members[b], cells)
        ]
        if not pairs:  # islands: the cells between them are empty
            pairs = [
                (float((moments[a] + moments[b]).deviation), a, b)
                for a, b in itertools.combinations(sorted(members), 2)
            ]
        _, a, b = min(pairs)
        moments[a] = moments[a] + moments.pop(b)
        members[a] |= members.pop(b)
    group = torch.full((len(one.group),), -1)
    for number, name in enumerate(sorted(members)):
        group[list(members[name])] = number
    return dataclasses.replace(one, group=_filled(group, cells))


@dataclasses.dataclass
class _Moments:
    """Number, mean and summed squared deviation of vectors (Chan et al. 1979)."""

    count: int
    mean: Tensor
    deviation: Tensor

    @classmethod
    def of(cls, values: Float[Tensor, "N K"]) -> "_Moments":
        mean = values.double().mean(0)
        return cls(len(values), mean, (values.double() - mean).square().sum())

    def __add__(self, other: "_Moments") -> "_Moments":
        count = self.count + other.count
        apart = other.mean - self.mean
        deviation = self.deviation + other.deviation + apart.square().sum() * self.count * other.count / count
        return _Moments(count, self.mean + apart * (other.count / count), deviation)


def _places(cell: int, cells: tuple[int, int, int]) -> tuple[int, int, int]:
    x, y, _ = cells
    return cell % x, cell // x % y, cell // (x * y)


def _apart(a: int, b: int, cells: tuple[int, int, int]) -> int:
    return sum(abs(p - q) for p, q in zip(_places(a, cells), _places(b, cells), strict=True))


def _touch(a: set[int], b: set[int], cells: tuple[int, int, int]) -> bool:
    """Whether two groups share a face."""
    return any(_apart(p, q, cells) == 1 for p in a for q in b)


def _filled(group: Int[Tensor, "C"], cells: tuple[int, int, int]) -> Int[Tensor, "C"]:
    known = (group >= 0).nonzero()[:, 0].tolist()
    out = group.clone()
    for cell in (group < 0).nonzero()[:, 0].tolist():
        out[cell] = group[min(known, key=lambda k: (_apart(cell, k, cells), k))]
    return out

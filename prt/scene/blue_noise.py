"""Blue noise on a surface by weighted sample elimination, and groups of neighbouring points.

Yuksel 2015, "Sample Elimination for Generating Poisson Disk Sample Sets": too many random points are drawn,
then the most crowded one is removed until as many are left as are wanted. Belcour 2022 places its measurement
points so (section 4.1) and averages groups of neighbours (section 5.1, figure 4 b).
"""

import heapq
import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from torch import Tensor

from prt.errors import PrtError

#: random candidates per point that is kept; the paper recommends 3 to 5 (section 3)
CANDIDATES = 5
#: exponent of the weights, and the two constants of weight limiting (the paper's values)
ALPHA, BETA, GAMMA = 8.0, 0.65, 1.5
#: points up to which one assignment is solved exactly; it takes the cube of this in time, seconds
MOST_ASSIGNED = 2048
#: what a member whose normal is opposed to its centre's counts as, in spacings of the centres
OPPOSED = 4.0


def largest_radius(count: int, area: float) -> float:
    """r_max: half the distance of ``count`` points packed as densely as ``area`` allows (section 3)."""
    return math.sqrt(area / (2 * math.sqrt(3) * count))


def eliminate(points: Any, count: int, area: float, normals: Any = None) -> Int[Tensor, "count"]:
    """Which of the points are left when the others are eliminated; ascending, always the same.

    Weights are w_ij = (1 - d_ij / (2 r_max))^8 with weight limiting, distances are Euclidean.

    Args:
        points: (M, 3), tensor or array, more or less evenly spread over a surface.
        count: how many to keep.
        area: of that surface, in the square of the unit of the points.
        normals: (M, 3); points whose normals are opposed (negative dot product) do not repel each other:
            they lie on the two sides of a thin sheet. None: all repel.

    Raises:
        PrtError: if count is no whole number from 1 to M.
    """
    place = _array(points)
    many = len(place)
    _check_whole("count", count, 1, many)
    if count == many:
        return torch.arange(many)
    reach = 2 * largest_radius(count, area)
    pairs = cKDTree(place).query_pairs(reach, output_type="ndarray")
    if normals is not None:
        facing = _array(normals)
        same_side = np.einsum("pk,pk->p", facing[pairs[:, 0]], facing[pairs[:, 1]]) >= 0
        pairs = pairs[same_side]
    nearest = reach * (1 - (count / many) ** GAMMA) * BETA
    distance = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1).clip(nearest, reach)
    weight = (1 - distance / reach) ** ALPHA

    # the pairs of each point next to each other
    end, other, weight = pairs.T.ravel(), pairs[:, ::-1].T.ravel(), np.concatenate([weight, weight])
    order = np.argsort(end, kind="stable")
    other, weight = other[order], weight[order]
    first = np.searchsorted(end[order], np.arange(many + 1))
    return torch.from_numpy(_least_crowded(first, other, weight, many, count))


def _least_crowded(
    first: np.ndarray, other: np.ndarray, weight: np.ndarray, many: int, count: int
) -> np.ndarray:
    """Greedy removal; neighbours of point i are the rows first[i] to first[i + 1] of other and weight."""
    crowd = np.add.reduceat(np.append(weight, 0.0), first[:-1])
    crowd[first[1:] == first[:-1]] = 0.0  # of an empty run, reduceat returns the next element
    kept = np.ones(many, dtype=bool)
    heap = [(-value, i) for i, value in enumerate(crowd.tolist())]
    heapq.heapify(heap)
    left = many
    while left > count:
        value, i = heap[0]
        now = -float(crowd[i])
        if now > value:  # weights only ever fall, so a stale entry is put right when it comes to the top
            heapq.heapreplace(heap, (now, i))
            continue
        heapq.heappop(heap)
        kept[i], left = False, left - 1
        run = slice(first[i], first[i + 1])
        crowd[other[run]] -= weight[run]
    return np.flatnonzero(kept)


def scatter_points(
    triangles: Float[Tensor, "F 3 3"],
    normals: Float[Tensor, "F 3 3"],
    count: int,
    supersample: int,
    seed: int,
) -> tuple[Int[Tensor, "P"], Float[Tensor, "P 2"], Int[Tensor, "P"]]:
    """``count`` compact groups of ``supersample`` blue-noise points each, P in all, the same for a seed.

    Args:
        triangles, normals: corners of the surface, world units, and the unit normals there.
        count, supersample: groups, themselves spread as blue noise, and points in each.
        seed: of the candidates.

    Returns:
        For every point its triangle, the barycentric weights of that triangle's second and third corner, and
        its group. Points come group by group: ``group`` is 0, 0, ..., 1, 1, ...

    Raises:
        PrtError: for counts below 1, or a surface without finite area above 0.
    """
    _check_whole("points", count, 1)
    _check_whole("supersample", supersample, 1)
    corners, corner_normals = _array(triangles).reshape(-1, 3, 3), _array(normals).reshape(-1, 3, 3)
    total = count * supersample
    triangle, weights, area = _candidates(corners, CANDIDATES * total, seed)
    full = np.concatenate([1 - weights.sum(1, keepdims=True), weights], axis=1)[:, :, None]
    place, facing = (corners[triangle] * full).sum(1), (corner_normals[triangle] * full).sum(1)

    kept = eliminate(place, total, area, facing).numpy()
    place, facing = place[kept], facing[kept]
    centre = eliminate(place, count, area, facing).numpy()
    penalty = (OPPOSED * 2 * largest_radius(count, area)) ** 2
    group = balanced_groups(place, facing, centre, penalty)
    order = np.argsort(group, kind="stable")
    kept, group = kept[order], group[order]
    return (
        torch.from_numpy(triangle[kept]),
        torch.from_numpy(weights[kept]).float(),
        torch.from_numpy(group),
    )


def _candidates(corners: np.ndarray, many: int, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Random points, uniform in area: triangles, weights of corners 2 and 3, and the whole area."""
    if not np.isfinite(corners).all():
        raise PrtError("the asset has no surface to put points on: it has vertices that are not finite")
    edge = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1) / 2
    total = float(area.sum())
    if not total > 0:
        raise PrtError(
            f"the asset has no surface to put points on: {len(corners)} triangles without area; mend its mesh"
        )
    random = torch.rand((many, 3), generator=torch.Generator().manual_seed(seed), dtype=torch.float64).numpy()
    # one in each of so many equal shares of the area: even before anything is eliminated
    share = (np.arange(many) + random[:, 0]) / many * total
    upto = area.cumsum()
    triangle = np.searchsorted(upto, share, side="right").clip(max=np.flatnonzero(area)[-1])
    root = np.sqrt(random[:, 1])
    return triangle, np.stack([root * (1 - random[:, 2]), root * random[:, 2]], axis=1), total


def balanced_groups(
    place: Float[np.ndarray, "P 3"],
    normal: Float[np.ndarray, "P 3"],
    centre: Int[np.ndarray, "G"],
    penalty: float,
) -> Int[np.ndarray, "P"]:
    """Groups of P / G points each, around the points ``centre``, of least total squared distance.

    Exact up to ``MOST_ASSIGNED`` points; more are cut in two along their longest side until few enough.

    Args:
        penalty: added to the squared distance where the normals of a point and its centre are opposed.
    """
    group = np.empty(len(place), dtype=np.int64)
    each = len(place) // len(centre)
    todo = [(np.arange(len(place)), np.arange(len(centre)))]
    while todo:
        members, groups = todo.pop()
        middle = place[centre[groups]]
        if len(members) > MOST_ASSIGNED and len(groups) > 1:
            axis = int(np.ptp(middle, axis=0).argmax())
            members = members[np.argsort(place[members, axis], kind="stable")]
            groups = groups[np.argsort(middle[:, axis], kind="stable")]
            half = len(groups) // 2
            todo += [(members[: half * each], groups[:half]), (members[half * each :], groups[half:])]
            continue
        cost = ((place[members, None] - middle) ** 2).sum(2)
        cost += penalty * (normal[members] @ normal[centre[groups]].T < 0)
        # as many columns for a group as it has room for
        row, column = linear_sum_assignment(np.repeat(cost, each, axis=1))
        group[members[row]] = groups[column // each]
    return group


def _array(values: Any) -> np.ndarray:
    """As a double precision array."""
    return np.asarray(torch.as_tensor(values).detach().cpu(), dtype=np.float64)


def _check_whole(name: str, value: Any, least: int, most: int | None = None) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        upto = "" if most is None else f" to {most}, the number of candidates"
        raise PrtError(f"{name}={value!r} must be a whole number from {least}{upto}")

"""Blue-noise points on surfaces, and their groups."""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from prt.errors import PrtError
from prt.scene import blue_noise
from prt.scene.blue_noise import balanced_groups, eliminate, largest_radius, scatter_points
from prt.scene.shapes import torus_mesh


def torus():
    mesh = torus_mesh(1.0, 0.4, columns=48, rows=24)
    return torch.from_numpy(mesh.position[mesh.face]), torch.from_numpy(mesh.normal[mesh.face])


def square(side=1.0, height=0.0, up=1.0):
    corner = torch.tensor([[0, 0, height], [side, 0, height], [side, side, height], [0, side, height]])
    return corner[torch.tensor([[0, 1, 2], [0, 2, 3]])], torch.tensor([0.0, 0.0, up]).expand(2, 3, 3)


def area_of(triangles):
    edge = triangles[:, 1:] - triangles[:, :1]
    return float(torch.linalg.cross(edge[:, 0], edge[:, 1]).norm(dim=1).sum() / 2)


def places(triangles, triangle, weights):
    full = torch.cat([1 - weights.sum(1, keepdim=True), weights], 1).to(triangles)
    return (triangles[triangle] * full[:, :, None]).sum(1)


def nearest(points):
    return cKDTree(points).query(points, k=2)[0][:, 1]


@pytest.mark.parametrize("count, supersample, least", [(512, 1, 0.65), (128, 8, 0.65)])
def test_points_keep_their_distance(count, supersample, least):
    """Yuksel 2015, section 5: a radius of about 0.7 of the largest possible; random ones are far below."""
    triangles, normals = torus()
    triangle, weights, _ = scatter_points(triangles, normals, count, supersample, 3)
    points = places(triangles, triangle, weights)
    packed = 2 * largest_radius(count * supersample, area_of(triangles))
    distance = nearest(points.numpy())
    assert distance.min() > least * packed
    assert distance.mean() > 0.75 * packed
    random = blue_noise._candidates(triangles.numpy(), count * supersample, 0)
    crowded = nearest(places(triangles, torch.from_numpy(random[0]), torch.from_numpy(random[1])).numpy())
    assert crowded.min() < 0.2 * packed < distance.min() / 3


def test_centres_of_groups_are_blue_noise_too():
    """What is measured is as evenly spread as single points: means of groups keep their distance."""
    triangles, normals = torus()
    triangle, weights, group = scatter_points(triangles, normals, 64, 8, 0)
    mean = places(triangles, triangle, weights).view(64, 8, 3).mean(1)
    packed = 2 * largest_radius(64, area_of(triangles))
    assert nearest(mean.numpy()).min() > 0.5 * packed


def test_groups_are_of_one_size_and_compact():
    triangles, normals = torus()
    count, each = 100, 8
    triangle, weights, group = scatter_points(triangles, normals, count, each, 1)
    assert torch.equal(group, torch.arange(count).repeat_interleave(each))
    points = places(triangles, triangle, weights).view(count, each, 3)
    spread = (points - points.mean(1, keepdim=True)).norm(dim=2)
    packed = 2 * largest_radius(count, area_of(triangles))
    # the radius of a disk of one group's area is 0.525 packed distances
    assert spread.max() < packed
    assert spread.square().mean().sqrt() < 0.5 * packed


def test_each_point_is_a_group_without_supersampling():
    triangle, weights, group = scatter_points(*torus(), 40, 1, 0)
    assert group.tolist() == list(range(40))
    assert triangle.shape == (40,) and weights.shape == (40, 2)
    assert bool((weights >= 0).all()) and bool((weights.sum(1) <= 1 + 1e-6).all())
    assert triangle.dtype == group.dtype == torch.int64 and weights.dtype == torch.float32


def test_the_same_places_for_a_seed_and_others_for_another():
    first, second, other = (scatter_points(*torus(), 32, 4, seed) for seed in (5, 5, 6))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
    assert not torch.equal(first[1], other[1])


def test_density_follows_area():
    """A torus of three times the size gets nine times the points, though its triangles are no more."""
    small, normals = torus()
    triangles, normals = torch.cat([small, 3 * small + 50]), torch.cat([normals, normals])
    triangle, _, _ = scatter_points(triangles, normals, 1000, 1, 0)
    assert int((triangle < len(small)).sum()) == pytest.approx(100, abs=8)


def test_density_is_even_over_the_parts_of_a_surface():
    """Eight sectors of equal area: the same number in each, though those of random points differ by 12."""
    triangles, normals = torus()
    triangle, weights, _ = scatter_points(triangles, normals, 128, 8, 0)
    x, _, z = places(triangles, triangle, weights).T
    sector = ((torch.atan2(z, x) / (2 * math.pi) % 1) * 8).long()
    assert sector.bincount().tolist() == pytest.approx([128] * 8, abs=6)


def test_triangles_without_area_get_no_points():
    triangles, normals = square()
    flat = triangles[:1, :1].expand(1, 3, 3)
    triangle, _, _ = scatter_points(torch.cat([triangles, flat]), normals[:1].expand(3, 3, 3), 64, 2, 0)
    assert int(triangle.max()) <= 1


def test_the_sides_of_a_thin_sheet_do_not_repel_each_other():
    """Each side is as evenly covered as it would be alone; without the normals they share the room."""
    sheets = [square(), square(height=1e-3, up=-1.0)]
    triangles, normals = torch.cat([s[0] for s in sheets]), torch.cat([s[1] for s in sheets])
    rng = np.random.default_rng(0)
    place = rng.random((2000, 3)) * [1, 1, 0]
    place[1000:, 2] = 1e-3
    up = np.where(np.arange(2000)[:, None] < 1000, [0, 0, 1.0], [0, 0, -1.0])
    packed = 2 * largest_radius(200, 2.0)
    kept = eliminate(place, 200, 2.0, up).numpy()
    across = cKDTree(place[kept[kept < 1000]]).query(place[kept[kept >= 1000]])[0]
    assert across.min() < 0.2 * packed
    for side in (kept[kept < 1000], kept[kept >= 1000]):
        assert len(side) == pytest.approx(100, abs=6)
        assert nearest(place[side]).min() > 0.6 * packed
    shared = eliminate(place, 200, 1.0).numpy()  # what the normals change: else the sides share their room
    assert nearest(place[shared]).min() > 0.4 * packed > 2 * nearest(place[kept]).min()

    triangle, _, group = scatter_points(triangles, normals, 24, 8, 0)
    top = (triangle < 2).view(24, 8).sum(1)
    mixed = int(((top > 0) & (top < 8)).sum())
    assert mixed <= 2  # a count that 8 does not divide must go somewhere


def test_the_most_crowded_goes_first():
    """Three on a line, the middle one too many; then nothing depends on the order of the points."""
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.1, 0, 0]])
    area = 2 * math.sqrt(3) * 2  # r_max of two points is 1
    for order in itertools.permutations(range(3)):
        kept = eliminate(points[list(order)], 2, area)
        assert {order[i] for i in kept.tolist()} == {0, 2}


@pytest.mark.parametrize("seed", range(4))
def test_elimination_is_the_papers_greedy(seed):
    """Against weights recomputed from nothing after each removal; every tenth point has no neighbours."""
    rng = np.random.default_rng(seed)
    points = rng.random((60, 3)) * [1, 1, 0]
    points[::10] += 100 * np.arange(1, 7)[:, None]
    count, area = 30, 1.0
    reach = 2 * largest_radius(count, area)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    low = reach * (1 - (count / 60) ** 1.5) * 0.65
    weight = np.where(distance < reach, (1 - distance.clip(low, reach) / reach) ** 8, 0)
    np.fill_diagonal(weight, 0)
    kept = list(range(60))
    while len(kept) > count:
        kept.pop(int(weight[np.ix_(kept, kept)].sum(1).argmax()))
    assert eliminate(torch.from_numpy(points), count, area).tolist() == kept
    assert set(range(0, 60, 10)) < set(kept)


def test_keeping_all_and_points_far_apart():
    points = torch.eye(3) * 100
    assert eliminate(points, 3, 1.0).tolist() == [0, 1, 2]
    assert len(eliminate(points, 2, 1.0)) == 2


def test_groups_are_of_least_squared_distance():
    """Against all assignments of six points to three centres."""
    rng = np.random.default_rng(1)
    place, normal = rng.random((6, 3)), np.tile([0, 0, 1.0], (6, 1))
    centre = np.array([0, 2, 5])
    group = balanced_groups(place, normal, centre, 0.0)

    def cost(of):
        return float(((place - place[centre[np.asarray(of)]]) ** 2).sum())

    assert sorted(group.tolist()) == [0, 0, 1, 1, 2, 2]
    best = min(cost(of) for of in itertools.permutations([0, 0, 1, 1, 2, 2]))
    assert cost(group) == pytest.approx(best)


def test_many_points_are_grouped_part_by_part(monkeypatch):
    """Cut into small parts the groups are still exact in size, and hardly less compact."""
    triangles, normals = torus()

    def spread():
        triangle, weights, group = scatter_points(triangles, normals, 96, 4, 0)
        assert group.bincount().tolist() == [4] * 96
        points = places(triangles, triangle, weights).view(96, 4, 3)
        return float((points - points.mean(1, keepdim=True)).square().mean().sqrt())

    exact = spread()
    monkeypatch.setattr(blue_noise, "MOST_ASSIGNED", 64)
    assert exact < spread() < 1.25 * exact


@pytest.mark.parametrize(
    "count, supersample, named",
    [(0, 1, "points=0"), (4, 0, "supersample=0"), (2.5, 1, "points=2.5"), (True, 1, "points=True")],
)
def test_refuses_counts(count, supersample, named):
    with pytest.raises(PrtError, match=named):
        scatter_points(*torus(), count, supersample, 0)


@pytest.mark.parametrize("spoil", ["none", "point", "nan", "infinite"])
def test_refuses_an_asset_without_surface(spoil):
    triangles, normals = square()
    if spoil == "none":
        triangles, normals = triangles[:0], normals[:0]
    elif spoil == "point":
        triangles = torch.zeros_like(triangles)
    else:
        triangles = triangles.clone()
        triangles[0, 0, 0] = math.nan if spoil == "nan" else math.inf
    with pytest.raises(PrtError, match="no surface") as caught:
        scatter_points(triangles, normals, 4, 1, 0)
    assert "\n" not in str(caught.value)


def test_refuses_to_keep_more_than_there_are():
    with pytest.raises(PrtError, match="count=4 must be a whole number from 1 to 3"):
        eliminate(torch.eye(3), 4, 1.0)

"""The texture atlas: every point of an asset in a place of its own."""

import numpy as np
import pytest
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from prt.bench.compose import compose
from prt.errors import PrtError
from prt.scene import atlas as module
from prt.scene.atlas import Atlas, interpolate, nearest_covered, rasterise, unwrap, usable
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.meshes import one_mesh

SIZE = 64


@pytest.fixture(autouse=True)
def cache(own_cache):
    return own_cache


@pytest.fixture(scope="module", params=["bending", "cornell_box"])
def mesh(request):
    from hydra.utils import instantiate

    scene = instantiate(compose([f"scene={request.param}", "budget=smoke"]).scene)
    return request.param, one_mesh(list(scene.load().shapes()))[0]


def grid_mesh(cells: int) -> tuple[TriangleMesh, torch.Tensor]:
    """A square of 2 x cells x cells triangles and its texture coordinates, which are an atlas."""
    x, y = np.meshgrid(np.arange(cells + 1) / cells, np.arange(cells + 1) / cells)
    position = torch.from_numpy(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)).float()
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    face = np.concatenate([
        np.stack([corner, corner + 1, corner + cells + 2], 1),
        np.stack([corner, corner + cells + 2, corner + cells + 1], 1),
    ])  # fmt: skip
    face = torch.from_numpy(face)
    normal = torch.tensor([0.0, 0.0, 1.0]).expand_as(position)
    return TriangleMesh(position, normal, face, torch.zeros(len(face))), position[face][..., :2]


def areas(corner: torch.Tensor) -> torch.Tensor:
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).abs() / 2


def charts(corner: torch.Tensor) -> np.ndarray:
    """Which chart each triangle belongs to: triangles that share corners in texture space."""
    _, same = np.unique(np.round(corner.reshape(-1, 2).numpy() * 1e6), axis=0, return_inverse=True)
    same = same.reshape(-1, 3)
    count = same.max() + 1
    links = np.concatenate([same[:, :2], same[:, 1:]])
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), (count, count))
    return connected_components(graph, directed=False)[1][same[:, 0]]


def test_nothing_is_covered_twice(mesh):
    name, whole = mesh
    atlas = unwrap(whole, SIZE, {"test": name})
    height, width = atlas.size
    assert 0.5 * SIZE < min(height, width) and max(height, width) < 2 * SIZE
    corner = atlas.corner
    assert bool(((corner >= 0) & (corner <= 1)).all())
    triangle, _ = rasterise(corner, atlas.size, 8)
    covered = float((triangle >= 0).float().mean())
    # an overlap is area that the rasteriser sees only once
    assert float(areas(corner).sum()) == pytest.approx(covered, rel=0.01)
    assert covered > 0.3
    # and each triangle gets its share of it: none lies below another
    seen = torch.bincount(triangle[triangle >= 0], minlength=len(corner)) / len(triangle)
    large = areas(corner) > 40 / len(triangle)
    assert int(large.sum()) > 10
    assert float((seen[large] / areas(corner)[large]).min()) > 0.7


def test_the_lightmap_is_as_dense_everywhere(mesh):
    name, whole = mesh
    atlas = unwrap(whole, SIZE, {"test": name})
    world = whole.position[whole.face]
    area = torch.linalg.cross(world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]).norm(dim=1) / 2
    scale = torch.tensor([atlas.size[1], atlas.size[0]])
    density = areas(atlas.corner * scale) / area.clamp_min(1e-12)
    large = area > area.median()
    assert float(density[large].quantile(0.9) / density[large].quantile(0.1)) < 2


def test_charts_keep_their_distance(mesh):
    name, whole = mesh
    atlas = unwrap(whole, SIZE, {"test": name})
    height, width = atlas.size
    triangle, _ = rasterise(atlas.corner, atlas.size, 8)
    label = torch.where(triangle >= 0, torch.from_numpy(charts(atlas.corner))[triangle.clamp_min(0)], -1)
    label = label.view(height, width, 64)
    assert len(label.unique()) > 3
    low = torch.where(label < 0, 1 << 30, label).amin(2)
    high = label.amax(2)
    assert bool((low[high >= 0] == high[high >= 0]).all())  # no texel shows two charts
    for dy in range(-1, 2):
        for dx in range(-2, 3):
            here = high[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
            there = high[max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)]
            both = (here >= 0) & (there >= 0)
            assert bool((here[both] == there[both]).all()), (dy, dx)


def test_weights_lead_back_to_the_texel(mesh):
    name, whole = mesh
    atlas = unwrap(whole, SIZE, {"test": name})
    height, width = atlas.size
    triangle, weights = rasterise(atlas.corner, atlas.size, 2)
    assert len(triangle) == height * width * 4
    on = (triangle >= 0).nonzero()[:, 0]
    texel, sub = on // 4, on % 4
    place = torch.stack([texel % width + (sub % 2 + 0.5) / 2, texel // width + (sub // 2 + 0.5) / 2], 1)
    uv = place / torch.tensor([width, height])
    assert torch.allclose(atlas.at(triangle[on], weights[on]), uv, atol=1e-4)
    assert bool((weights[on] >= -1e-5).all()) and bool((weights[on].sum(1) <= 1 + 1e-5).all())
    # so the point of the mesh with these weights lies in its triangle
    corners = whole.position[whole.face][triangle[on]]
    point = interpolate(corners, weights[on])
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height_above = ((point - corners[:, 0]) * torch.nn.functional.normalize(normal, dim=1)).sum(1)
    assert float(height_above.abs().max()) < 1e-5


def test_interpolation_weights_are_of_the_second_and_third_corner():
    corners = torch.tensor([[[1.0, 0.0], [0.0, 10.0], [100.0, 100.0]]])
    atlas = Atlas((1, 1), corners)
    at = atlas.at(torch.tensor([0, 0, 0]), torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.25, 0.5]]))
    assert torch.allclose(at, torch.tensor([[1.0, 0.0], [0.0, 10.0], [50.25, 52.5]]))


def test_own_coordinates_are_used_where_they_are_an_atlas(monkeypatch):
    whole, uv = grid_mesh(6)
    monkeypatch.setattr(module, "_xatlas", lambda *_: pytest.fail("own coordinates are usable"))
    found = unwrap(whole, 32, {"test": "own"}, uv)
    assert found.size == (32, 32) and torch.equal(found.corner, uv)


@pytest.mark.parametrize("fault", ["overlap", "outside", "empty", "none"])
def test_own_coordinates_that_are_no_atlas_are_not(fault):
    whole, uv = grid_mesh(6)
    uv = 0.8 * uv + 0.1
    if fault == "overlap":  # two rows of cells on top of each other
        uv[:12] = uv[12:24].clone()
        uv[36:48] = uv[48:60].clone()
    elif fault == "outside":
        uv[3, 1, 0] = 1.01
    elif fault == "empty":
        uv[:20] = 0.5
    assert usable(uv) == (fault == "none")
    found = unwrap(whole, 32, {"test": fault}, uv)
    assert torch.equal(found.corner, uv) == (fault == "none")


def test_vertices_that_are_doubled_make_no_seams():
    whole, _ = grid_mesh(5)
    loose = TriangleMesh(whole.position[whole.face].reshape(-1, 3), whole.normal[whole.face].reshape(-1, 3),
                         torch.arange(3 * len(whole.face)).view(-1, 3), whole.shape)  # fmt: skip
    found = unwrap(loose, 32, {"test": "loose"})
    assert len(set(charts(found.corner))) == 1


def test_the_same_asset_is_unwrapped_once(monkeypatch):
    whole, _ = grid_mesh(4)
    first = unwrap(whole, 32, {"test": "once"})
    monkeypatch.setattr(module, "_xatlas", lambda *_: pytest.fail("it is in the cache"))
    assert torch.equal(unwrap(whole, 32, {"test": "once"}).corner, first.corner)


@pytest.mark.parametrize("texels", [7, 8193])
def test_mistakes_are_one_line(texels):
    whole, _ = grid_mesh(2)
    with pytest.raises(PrtError, match=f"task.texels={texels} must lie between 8 and 8192") as caught:
        unwrap(whole, texels, {})
    assert "\n" not in str(caught.value)
    empty = TriangleMesh(whole.position, whole.normal, whole.face[:0], whole.shape[:0])
    with pytest.raises(PrtError, match="no triangles"):
        unwrap(empty, 16, {})
    with pytest.raises(PrtError, match="no texel is covered"):
        nearest_covered(torch.zeros(12, dtype=torch.bool), (3, 4))


def test_empty_texels_take_the_nearest():
    covered = torch.rand((9 * 14,), generator=torch.Generator().manual_seed(2)) < 0.1
    fill = nearest_covered(covered, (9, 14))
    flat = covered.nonzero()[:, 0]
    place = torch.stack([torch.arange(9 * 14) // 14, torch.arange(9 * 14) % 14], 1).float()
    distance = torch.cdist(place, place[flat])
    assert fill.shape == (9 * 14,) and int(fill.max()) < len(flat)
    assert torch.allclose(distance.gather(1, fill[:, None])[:, 0], distance.min(1).values)
    assert torch.equal(fill[flat], torch.arange(len(flat)))

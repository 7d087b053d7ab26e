"""Transfer vectors against closed forms, a furnace, and random walks between two rectangles."""

import dataclasses
import math
import types

import numpy as np
import pytest
import torch

from prt.light.sh import sh_basis
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.shapes import MeshData, sphere_mesh, torus_mesh
from prt.trace import sh_transfer
from prt.trace.sh_transfer import cosine_directions, interreflect, trace_links, vertex_transfer

#: of the clamped cosine over pi, band by band (Ramamoorthi and Hanrahan 2001)
COSINE = [1, 2 / 3, 1 / 4, 0, -1 / 24]
BAND = torch.tensor([l for l in range(5) for _ in range(2 * l + 1)])


def triangle_mesh(*parts: MeshData, inside_out: bool = False) -> TriangleMesh:
    """One mesh of several; ``inside_out`` turns its faces and normals."""
    first, rows = 0, []
    for number, part in enumerate(parts):
        face = torch.from_numpy(part.face.astype(np.int64)) + first
        first += len(part.position)
        shape = torch.full((len(face),), number)
        rows.append((torch.tensor(part.position).float(), torch.tensor(part.normal).float(), face, shape))
    mesh = TriangleMesh(*(torch.cat(column) for column in zip(*rows, strict=True)))
    if inside_out:
        mesh = dataclasses.replace(mesh, normal=-mesh.normal, face=mesh.face[:, [0, 2, 1]])
    return mesh


def asset(mesh: TriangleMesh, albedo=(0.5, 0.5, 0.5)):
    """What is asked of an asset."""
    colour = torch.tensor(albedo).expand(len(mesh.position), 3)
    return types.SimpleNamespace(mesh=lambda pose=0: mesh, vertex_albedo=lambda pose=0: colour)


def sheet(corner, along, up, cells: int = 12) -> MeshData:
    """A rectangle of cells x cells squares that faces ``along x up``."""
    corner, along, up = (np.asarray(v, dtype=float) for v in (corner, along, up))
    u, v = (grid.ravel() for grid in np.meshgrid(*[np.linspace(0, 1, cells + 1)] * 2))
    normal = np.cross(along, up)
    low = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    right, above, across = low + 1, low + cells + 1, low + cells + 2
    return MeshData(
        position=corner + u[:, None] * along + v[:, None] * up,
        normal=np.tile(normal / np.linalg.norm(normal), (len(u), 1)),
        uv=np.stack([u, v], 1),
        face=np.concatenate([np.stack([low, right, across], 1), np.stack([low, across, above], 1)]),
    )


def ball() -> MeshData:
    return sphere_mesh(1.0, columns=32, rows=16)


def room(cells: int = 2) -> TriangleMesh:
    """A closed cube of six separate walls that face inwards: every rim vertex lies on other walls too."""
    axes = np.eye(3)
    walls = []
    for k in range(3):
        along, up = 2 * axes[(k + 1) % 3], 2 * axes[(k + 2) % 3]
        walls.append(sheet([-1, -1, -1], along, up, cells))
        walls.append(sheet(-np.ones(3) + 2 * axes[k], up, along, cells))
    return triangle_mesh(*walls)


# ---- directions


def test_directions_are_unit_and_cosine_weighted():
    normal = torch.nn.functional.normalize(
        torch.tensor([[0.0, 0, 1], [0, 0, -1], [1, 2, -3], [0, 1, 0]]), dim=1
    )
    d = cosine_directions(normal, 4096, torch.rand((4, 1, 2), generator=torch.Generator().manual_seed(0)))
    cosine = (d * normal[:, None]).sum(2)
    assert torch.allclose(d.norm(dim=2), torch.ones(4, 4096), atol=1e-5) and bool((cosine >= -1e-6).all())
    # moments of the density: E[c] = 2/3, E[c^2] = 1/2; the mean direction is the normal itself
    assert torch.allclose(cosine.mean(1), torch.tensor(2 / 3), atol=2e-3)
    assert torch.allclose(cosine.square().mean(1), torch.tensor(0.5), atol=2e-3)
    assert torch.allclose(d.mean(1), 2 / 3 * normal, atol=5e-3)


def test_directions_are_stratified():
    """The mean of 256 is far better than of 256 random ones, whose standard deviation is 0.5 / 16."""
    normal = torch.tensor([[0.0, 1.0, 0.0]]).expand(64, 3)
    d = cosine_directions(normal, 256, torch.rand((64, 1, 2), generator=torch.Generator().manual_seed(0)))
    assert float(d.mean(1)[:, [0, 2]].square().mean().sqrt()) < 0.2 * 0.5 / 16


# ---- direct transfer


def test_a_convex_object_has_the_clamped_cosine_and_nothing_else():
    mesh = triangle_mesh(ball())
    direct, interreflected = vertex_transfer(asset(mesh), 5, 1024, 3, 0)
    assert direct.shape == (len(mesh.position), 25) and interreflected.shape == (*direct.shape, 3)
    expected = torch.tensor(COSINE)[BAND] * sh_basis(mesh.normal, 4)
    assert (direct - expected).abs().max() < 0.012
    assert (direct - expected).square().mean().sqrt() < 0.002
    assert interreflected.abs().max() == 0


def test_the_constant_lighting_arrives_whole_at_a_convex_object():
    direct, _ = vertex_transfer(asset(triangle_mesh(ball())), 1, 16, 1, 0)
    assert torch.allclose(direct * math.sqrt(4 * math.pi), torch.ones_like(direct), atol=1e-5)


def test_higher_orders_only_add_harmonics():
    torus = asset(triangle_mesh(torus_mesh(1.0, 0.5, columns=16, rows=8)))
    few, few_b = vertex_transfer(torus, 2, 64, 2, 0)
    many, many_b = vertex_transfer(torus, 4, 64, 2, 0)
    assert torch.allclose(few, many[:, :4], atol=1e-6) and torch.allclose(few_b, many_b[:, :4], atol=1e-6)
    assert few_b.abs().max() > 0.01


# ---- interreflection


@pytest.mark.parametrize("mesh", [triangle_mesh(ball(), inside_out=True), room(), room(cells=1)],
                         ids=["ball", "room", "coarse room"])  # fmt: skip
def test_nothing_escapes_from_a_closed_room(mesh):
    direct, links = trace_links(mesh, 2, 128, 0)
    assert direct.abs().max() == 0
    total = np.concatenate([part.sum(1) for part in links])
    assert np.abs(total - 1).max() < 1e-5


def test_vertices_that_do_not_draw_back_look_out_of_the_room(monkeypatch):
    """That the test above is able to fail."""
    monkeypatch.setattr(sh_transfer, "DRAW_BACK", 0.0)
    assert trace_links(room(), 2, 128, 0)[0].abs().max() > 0.05


def test_a_furnace_sums_the_powers_of_its_albedo():
    """Inside of a closed sphere that shines with radiance 1 every pass arrives weaker by the albedo."""
    mesh = triangle_mesh(ball(), inside_out=True)
    albedo = torch.tensor([0.9, 0.5, 0.0]).expand(len(mesh.position), 3)
    _, links = trace_links(mesh, 1, 64, 0)
    shining = torch.ones((len(mesh.position), 1, 3))
    for bounces in (1, 2, 7):
        found = interreflect(shining, links, albedo, bounces)
        expected = sum(albedo[0] ** b for b in range(1, bounces + 1))
        assert torch.allclose(found, expected.expand_as(found), atol=1e-4)
    assert interreflect(shining, links, albedo, 0).abs().max() == 0


WALL, FLOOR = (0.8, 0.5, 0.2), (0.3, 0.6, 0.9)


def corner_scene() -> TriangleMesh:
    """A floor [-1, 1]^2 at y = 0, and on it a wall at x = 0, 1 high, that faces +x."""
    floor = sheet([-1, 0, -1], [0, 0, 2], [2, 0, 0], 20)
    wall = sheet([0, 0, 1], [0, 0, -2], [0, 1, 0], 20)
    return triangle_mesh(floor, wall)


def random_walk(start, bounces: int, paths: int) -> np.ndarray:
    """Interreflected transfer to a point of the floor, by walks in the rectangles' own equations.

    The walk ends where it meets the back of the wall, below the floor there is nothing to meet.
    """
    rng = np.random.default_rng(7)
    place, at_wall = np.tile(np.asarray(start, dtype=float), (paths, 1)), np.zeros(paths, dtype=bool)
    weight = np.ones((paths, 3))
    total = np.zeros((25, 3))
    for bounce in range(bounces + 1):
        u, angle = rng.random(len(place)), 2 * np.pi * rng.random(len(place))
        a, b, c = np.sqrt(u) * np.cos(angle), np.sqrt(u) * np.sin(angle), np.sqrt(1 - u)
        d = np.where(at_wall[:, None], np.stack([c, a, b], 1), np.stack([a, c, b], 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(at_wall, -place[:, 1] / d[:, 1], -place[:, 0] / d[:, 0])
        hit = place + t[:, None] * d
        on_wall = ~at_wall & (hit[:, 1] <= 1)
        on_floor = at_wall & (np.abs(hit[:, 0]) <= 1)
        met = (t > 0) & (np.abs(hit[:, 2]) <= 1) & (on_wall | on_floor)
        if bounce > 0:
            values = sh_basis(torch.from_numpy(d[~met]), 4).numpy()
            total += values.T @ weight[~met]
        going = met & (at_wall | (d[:, 0] < 0))  # else the back of the wall
        weight = weight[going] * np.where(at_wall[going, None], FLOOR, WALL)
        place, at_wall = hit[going], ~at_wall[going]
    return total / paths


def test_floor_and_wall_agree_with_random_walks():
    mesh = corner_scene()
    scene = asset(mesh)
    colour = torch.where((mesh.position[:, :1] == 0) & (mesh.normal[:, :1] > 0.5),
                         torch.tensor(WALL), torch.tensor(FLOOR))  # fmt: skip
    scene.vertex_albedo = lambda pose=0: colour
    direct, interreflected = vertex_transfer(scene, 5, 1024, 4, 0)
    for place in ([0.1, 0, 0], [0.5, 0, 0.4]):
        at = int((mesh.position - torch.tensor(place)).norm(dim=1).argmin())
        expected = random_walk(mesh.position[at].tolist(), 4, 400_000)
        assert np.abs(expected).max() > 0.03
        assert np.abs(interreflected[at].numpy() - expected).max() < 0.004
    # behind the wall: as much shadow, but its back is black
    mirrored = [int((mesh.position - torch.tensor([x, 0, 0])).norm(dim=1).argmin()) for x in (0.1, -0.1)]
    assert torch.allclose(direct[mirrored[0], 0], direct[mirrored[1], 0], atol=0.01)
    assert direct[mirrored[0], 0] * math.sqrt(4 * math.pi) < 0.65
    assert interreflected[mirrored[0], 0].min() > 0.01 and interreflected[mirrored[1]].abs().max() == 0


def test_light_is_interpolated_between_the_corners_of_what_is_hit():
    """Corners that shine as their coordinates: a wall of two triangles sends its mean place, as it is."""
    floor, wall = sheet([-1, 0, -1], [0, 0, 2], [2, 0, 0], 20), sheet([0, 0, 1], [0, 0, -2], [0, 1, 0], 1)
    mesh = triangle_mesh(floor, wall)
    _, links = trace_links(mesh, 1, 4096, 0)
    found = interreflect(mesh.position[:, None], links, torch.ones_like(mesh.position), 1)[:, 0]
    at = int((mesh.position - torch.tensor([0.3, 0.0, 0.6])).norm(dim=1).argmin())
    rng = np.random.default_rng(0)
    u, angle = rng.random(1_000_000), 2 * np.pi * rng.random(1_000_000)
    d = np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(1 - u), np.sqrt(u) * np.sin(angle)], 1)
    hit = mesh.position[at].numpy() - d * (mesh.position[at, 0].item() / d[:, :1])
    met = (d[:, 0] < 0) & (hit[:, 1] <= 1) & (np.abs(hit[:, 2]) <= 1)
    expected = np.where(met[:, None], hit, 0).mean(0)
    assert np.abs(found[at].numpy() - expected).max() < 0.003 and expected[1] > 0.05


def test_colours_come_from_the_albedo_alone():
    mesh = corner_scene()
    _, white = vertex_transfer(asset(mesh, (1.0, 1.0, 1.0)), 2, 64, 1, 0)
    _, red = vertex_transfer(asset(mesh, (0.7, 0.2, 0.0)), 2, 64, 1, 0)
    assert torch.allclose(red, white * torch.tensor([0.7, 0.2, 0.0]), atol=1e-6)


# ---- repeatable


def test_the_same_for_a_seed_whatever_is_traced_at_a_time(monkeypatch):
    mesh = corner_scene()
    first = vertex_transfer(asset(mesh), 3, 32, 2, 5)
    monkeypatch.setattr(sh_transfer, "RAYS", 32 * 100)
    second = vertex_transfer(asset(mesh), 3, 32, 2, 5)
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(first, second, strict=True))
    other = vertex_transfer(asset(mesh), 3, 32, 2, 6)
    assert not torch.allclose(first[0], other[0], atol=1e-4)


def test_vertices_of_no_triangle_and_triangles_without_area_do_no_harm():
    mesh = corner_scene()
    mesh = dataclasses.replace(
        mesh,
        position=torch.cat([mesh.position, torch.tensor([[5.0, 5.0, 5.0]])]),
        normal=torch.cat([mesh.normal, torch.tensor([[0.0, 1.0, 0.0]])]),
        face=torch.cat([mesh.face, mesh.face[:1, [0, 0, 1]]]),
        shape=torch.cat([mesh.shape, mesh.shape[:1]]),
    )
    direct, interreflected = vertex_transfer(asset(mesh), 2, 32, 1, 0)
    assert bool(direct.isfinite().all()) and bool(interreflected.isfinite().all())
    assert float(direct[-1, 0]) == pytest.approx(1 / math.sqrt(4 * math.pi), abs=1e-5)


def test_hits_are_told_by_triangle_and_weights():
    """The corners of the triangle that is hit, weighed, lie on the ray; a ray that meets nothing escapes."""
    mesh = corner_scene()
    origin = torch.tensor([[0.3, 0.2, 0.1]]).repeat(200, 1)
    d = cosine_directions(torch.tensor([[-1.0, 0.0, 0.0]]), 200, torch.full((1, 1, 2), 0.3))[0]
    escaped, triangle, weights = sh_transfer._intersect(sh_transfer.triangle_scene(mesh), origin, d)
    assert 5 < int(escaped.sum()) < 180 and bool((triangle[escaped] == -1).all())
    full = torch.cat([1 - weights.sum(1, keepdim=True), weights], 1)[~escaped]
    place = (mesh.position[mesh.face[triangle[~escaped]]] * full[..., None]).sum(1)
    along = torch.nn.functional.normalize(place - origin[~escaped], dim=1)
    assert torch.allclose(along, d[~escaped], atol=1e-4)

"""Subdivision keeps the surface, has no T-junctions and ends where no edge is too long."""

import types

import pytest
import torch

from prt.errors import PrtError
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.subdivide import fine_mesh, subdivided


def fan() -> TriangleMesh:
    """Triangles of very different sizes about a common corner, in two shapes that share no vertex."""
    angle = torch.tensor([0.0, 0.1, 1.0, 2.5, 4.0])
    radius = torch.tensor([5.0, 0.3, 2.0, 4.0, 0.5])
    rim = torch.stack([radius * angle.cos(), 0 * angle, radius * angle.sin()], 1)
    position = torch.cat([torch.zeros(1, 3), rim, torch.tensor([[0.0, 1, 0], [3.0, 1, 0], [0, 1, 1.0]])])
    normal = torch.tensor([[0.0, 1.0, 0.0]]).repeat(9, 1)
    face = torch.tensor([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4], [6, 8, 7]])
    return TriangleMesh(position, normal, face, torch.tensor([0, 0, 0, 0, 1]))


def areas(mesh: TriangleMesh) -> torch.Tensor:
    a, b, c = (mesh.position[mesh.face[:, k]] for k in range(3))
    return torch.linalg.cross(b - a, c - a)[:, 1] / 2  # signed: all lie flat


def open_edges(mesh: TriangleMesh) -> float:
    """Length of the edges that belong to one triangle only."""
    edges = torch.stack([mesh.face.flatten(), mesh.face.roll(-1, 1).flatten()], 1).sort(1).values
    pairs, count = torch.unique(edges, dim=0, return_counts=True)
    assert count.max() <= 2
    ends = mesh.position[pairs[count == 1]]
    return float((ends[:, 0] - ends[:, 1]).norm(dim=1).sum())


@pytest.mark.parametrize("longest", [3.0, 0.5, 0.11])
def test_no_edge_is_too_long_and_the_surface_is_the_same(longest):
    coarse = fan()
    fine = subdivided(coarse, longest, 10**6)
    corners = fine.position[fine.face]
    assert (corners - corners.roll(-1, 1)).norm(dim=2).max() <= longest
    assert len(fine.face) > len(coarse.face)
    assert (areas(fine) * areas(coarse)[0].sign()).min() > 0  # none is turned over
    for shape in (0, 1):
        parts = [areas(mesh)[mesh.shape == shape].sum() for mesh in (coarse, fine)]
        torch.testing.assert_close(parts[1], parts[0], rtol=1e-4, atol=0)
    # a vertex on an edge of a neighbour that has none there would open that edge
    assert open_edges(fine) == pytest.approx(open_edges(coarse), rel=1e-4)
    assert torch.unique(fine.face).numel() == len(fine.position)
    torch.testing.assert_close(fine.normal, torch.tensor([[0.0, 1.0, 0.0]]).expand(len(fine.normal), 3))


def test_a_mesh_that_is_fine_already_stays_as_it_is():
    mesh = fan()
    same = subdivided(mesh, 100.0, 10)
    assert torch.equal(same.face, mesh.face) and torch.equal(same.position, mesh.position)


def test_it_does_not_take_more_than_it_needs():
    """A square of side 1 in two triangles: 8 cells a side whose diagonals are left to be shorter than 0.2."""
    position = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    mesh = TriangleMesh(position, position * 0 + 1.0, torch.tensor([[0, 1, 2], [0, 2, 3]]), torch.zeros(2))
    assert len(subdivided(mesh, 0.2, 100).position) == 81


def test_refusals():
    with pytest.raises(PrtError, match="method.vertices asks for edges of at most 0.01.*50 vertices"):
        subdivided(fan(), 0.01, 50, "method.vertices")
    with pytest.raises(PrtError, match="must be above 0"):
        subdivided(fan(), 0.0, 50)
    hair = types.SimpleNamespace(name="hair", asset=lambda texels: object())
    with pytest.raises(PrtError, match="scene=hair is not made of triangles"):
        fine_mesh(hair, 1.0, 50, "method.vertices")

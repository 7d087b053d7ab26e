"""Points of G-buffers are found on the triangles they lie on, with weights that give them back."""

import types

import pytest
import torch

from prt.scene.capture import capture
from prt.scene.lightmap_points import TriangleMesh
from prt.scene.mesh_places import MeshPlaces, barycentric
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.shapes import diffuse, sphere_mesh, to_mesh, torus_mesh
from prt.scene.subdivide import fine_mesh
from prt.scene.view import View

VIEW = View((2.0, 2.5, 4.0), (0.0, 0.2, 0.0), fov=40.0, width=96, height=96)


class Mixed(Scene):
    """A mesh with smooth normals that stands in a coarse ground, and perhaps a sphere that is no mesh."""

    def __init__(self, sphere: bool):
        nothing = {"train": [lambda places: []], "far": [lambda places: []]}
        super().__init__("mixed", nothing)
        self.sphere = sphere

    def description(self):
        transform, grey = mitsuba().ScalarTransform4f, diffuse((0.5, 0.5, 0.5))
        return {
            "ground": {
                "type": "rectangle",
                "to_world": transform().rotate([1, 0, 0], -90).scale(3.0),
                "bsdf": grey,
            },
            "ring": to_mesh("ring", torus_mesh(0.8, 0.3, columns=24, rows=12), grey),
            **({"ball": {"type": "sphere", "radius": 0.3, "bsdf": grey}} if self.sphere else {}),
        }


def returned(places: MeshPlaces, gbuffer) -> torch.Tensor:
    rows, weights = places(gbuffer)
    assert weights.min() >= 0
    torch.testing.assert_close(weights.sum(1), torch.ones(len(weights)))
    return (places.mesh.position[rows.long()] * weights[..., None]).sum(1)


@pytest.mark.parametrize("longest", [100.0, 0.2])
def test_interpolated_vertices_give_back_the_position(longest):
    scene = Mixed(sphere=False)
    places = MeshPlaces(fine_mesh(scene, longest, 10**6, "longest"))
    gbuffer = capture(scene.load(), VIEW)
    assert len(gbuffer) > 2000
    assert (returned(places, gbuffer) - gbuffer.position).norm(dim=1).max() < 2e-6


def test_points_of_an_analytic_sphere_are_as_near_as_its_triangles():
    scene = Mixed(sphere=True)
    places = MeshPlaces(fine_mesh(scene, 0.5, 10**6, "longest"))
    gbuffer = capture(scene.load(), VIEW)
    off = (returned(places, gbuffer) - gbuffer.position).norm(dim=1)
    on_ball = (gbuffer.position.norm(dim=1) - 0.3).abs() < 1e-5
    assert on_ball.sum() > 50
    # 48 rows from pole to pole: chords lie this far below the sphere
    assert off[on_ball].max() < 0.3 * (1 - torch.cos(torch.tensor(torch.pi / 48)))
    assert off[~on_ball].max() < 2e-6


def sheets() -> TriangleMesh:
    """Two parallel triangles a little apart."""
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    position = torch.cat([corners, corners + torch.tensor([0.0, 3e-4, 0.0])])
    normal = torch.tensor([[0.0, 1.0, 0.0]]).repeat(6, 1)
    return TriangleMesh(position, normal, torch.tensor([[0, 2, 1], [3, 5, 4]]), torch.zeros(2))


def test_of_two_sheets_the_point_lies_on_its_own():
    places, up = MeshPlaces(sheets()), torch.tensor([[0.0, 1.0, 0.0]]).repeat(2, 1)
    position = torch.tensor([[0.2, 0.0, 0.2], [0.2, 3e-4, 0.2]])
    for normal in (up, -up):
        triangle, weights, distance = places.find(position, normal)
        assert triangle.tolist() == [0, 1] and distance.max() < 1e-9
        torch.testing.assert_close(weights, torch.tensor([[0.6, 0.2, 0.2]]).repeat(2, 1))


def test_where_rays_find_nothing_the_nearest_triangle_does():
    data = sphere_mesh(1.0, 16, 8)
    position, normal = torch.tensor(data.position).float(), torch.tensor(data.normal).float()
    mesh = TriangleMesh(position, normal, torch.from_numpy(data.face).long(), torch.zeros(len(data.face)))
    middle = position[mesh.face].mean(1)
    # normals along the surface and points off it: no short ray meets anything
    along = torch.nn.functional.normalize(torch.linalg.cross(middle, torch.ones_like(middle)), dim=1)
    triangle, weights, distance = MeshPlaces(mesh).find(1.1 * middle, along)
    apart = (position[mesh.face[triangle]] * weights[..., None]).sum(1) - middle
    assert (distance < 0.11).all() and (apart.norm(dim=1) < 0.1).all()


def test_an_empty_view_has_no_places():
    nothing = types.SimpleNamespace(position=torch.zeros(0, 3), normal=torch.zeros(0, 3))
    rows, weights = MeshPlaces(sheets())(nothing)
    assert rows.shape == weights.shape == (0, 3)


def test_weights_of_a_triangle_without_area_are_finite():
    line = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    assert torch.equal(barycentric(torch.tensor([[0.5, 0.0, 0.0]]), line), torch.full((1, 3), 1 / 3))

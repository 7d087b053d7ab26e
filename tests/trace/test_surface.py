"""Points on meshes: evenly by area, on the surface, with normals; what blocks light and what is refused."""

import types

import pytest
import torch
from trace_scenes import CORNER_VIEW, DictScene, diffuse, glossy_corner, plane

from prt.errors import PrtError
from prt.trace.surface import MeshSurface, Surface


def test_it_is_a_surface():
    surface = MeshSurface(glossy_corner(), 16)
    assert isinstance(surface, Surface)
    assert surface.extent == pytest.approx(surface.asset.radius)
    low, high = (torch.tensor(corner) for corner in surface.bounds)
    assert bool((high > low).all())


def test_points_fall_evenly_by_area():
    surface = MeshSurface(DictScene({"a": plane(diffuse(0.5)), "b": plane(diffuse(0.5), scale=3.0)}), 16)
    triangle, _ = surface.places(4000, 0)
    small = surface.asset.mesh().shape[triangle] == 0
    # areas 4 and 36
    assert float(small.float().mean()) == pytest.approx(0.1, abs=0.01)
    points = surface.sample(4000, 0)
    assert float(points.position[:, 1].abs().max()) < 1e-6
    # a quarter of the points in each quadrant
    quadrant = 2 * (points.position[:, 0] > 0).long() + (points.position[:, 2] > 0).long()
    assert bool(((torch.bincount(quadrant) / 4000 - 0.25).abs() < 0.03).all())


def test_points_differ_by_seed_only():
    surface = MeshSurface(glossy_corner(), 16)
    a, b, c = (surface.sample(50, seed).position for seed in (1, 1, 2))
    assert torch.equal(a, b) and not torch.equal(a, c)


def test_points_of_a_sphere_look_outwards():
    ball = {"ball": {"type": "sphere", "radius": 2.0, "bsdf": diffuse(0.5)}}
    points = MeshSurface(DictScene(ball), 16).sample(500, 0)
    outward = torch.nn.functional.normalize(points.position, dim=1)
    assert float((outward * points.normal).sum(1).min()) > 0.99


def test_what_blocks_the_light():
    surface = MeshSurface(glossy_corner(), 16)
    origin = torch.tensor([[0.8, 0.1, 0.8]]).repeat(3, 1)
    towards = torch.tensor([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    assert surface.occluded(origin, towards).tolist() == [True, False, True]


def test_a_view_has_places_in_the_atlas():
    gbuffer = MeshSurface(glossy_corner(), 32).capture(CORNER_VIEW)
    assert len(gbuffer) > 50 and bool((gbuffer.uv >= 0).all()) and bool((gbuffer.triangle >= 0).all())


def test_what_moves_or_is_translucent_is_refused():
    for more in ({"poses": 2, "medium": None}, {"poses": 1, "medium": "volume"}):
        with pytest.raises(PrtError, match="needs a static, opaque scene"):
            MeshSurface(types.SimpleNamespace(name="x", **more), 16)

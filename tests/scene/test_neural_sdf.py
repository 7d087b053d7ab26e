"""A small network learns the signed distance of a mesh; distances to meshes against closed forms."""

import dataclasses
import os

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.mesh_distance import MeshDistance, closest
from prt.scene.neural_sdf import (
    Fit,
    NeuralSdf,
    box_of,
    fitted,
    neural_bunny,
    steepest,
    surface_error,
    with_gradient,
)
from prt.scene.neural_sdf_scene import NeuralSdfScene
from prt.scene.shapes import sphere_mesh, torus_mesh
from prt.trace.sdf_surface import SdfSurface

TORUS = torus_mesh(0.6, 0.25)
needs_data = pytest.mark.skipif(not os.environ.get("PRT_DATA"), reason="PRT_DATA is not set")


def cameras():
    from prt.scene.cameras import circular_sweep

    path = circular_sweep(center=[0, 0, 0], radius=4.0)
    return {"train": [path], "far": [path]}


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """Trained for a second or two."""
    before = os.environ.get("PRT_CACHE")
    os.environ["PRT_CACHE"] = str(tmp_path_factory.mktemp("cache"))
    try:
        yield fitted(TORUS, {"mesh": "torus"}, Fit(16, 2, 4.0, 1200, batch=512), points=12_000)
    finally:
        os.environ.pop("PRT_CACHE")
        if before is not None:
            os.environ["PRT_CACHE"] = before


def random_points(count: int, reach: float = 1.2):
    return reach * (2 * torch.rand((count, 3), generator=torch.Generator().manual_seed(0)) - 1)


def torus_distance(position):
    x, y, z = position.unbind(1)
    around = (x * x + z * z).sqrt() - 0.6
    return (around * around + y * y).sqrt() - 0.25


def test_distances_to_a_mesh_are_those_of_the_shape():
    position = random_points(3000)
    distance, gradient = MeshDistance(TORUS, samples=50_000)(position)
    # the mesh lies within the torus by half a percent of the tube
    assert (distance - torus_distance(position)).abs().max() < 5e-3
    x, y, z = position.unbind(1)
    ring = torch.stack([x, torch.zeros_like(y), z], 1)
    out = torch.nn.functional.normalize(position - 0.6 * torch.nn.functional.normalize(ring, dim=1), dim=1)
    assert ((gradient * out).sum(1) > 0.95).float().mean() > 0.97
    assert gradient.norm(dim=1) == pytest.approx(1.0, abs=1e-6)


def test_a_mesh_with_holes_still_has_an_inside():
    whole = sphere_mesh(0.9, 32, 16)
    open_mesh = dataclasses.replace(whole, face=whole.face[np.arange(len(whole.face)) % 40 != 7])
    position = random_points(2000)
    radius = position.norm(dim=1)
    clear = (radius - 0.9).abs() > 0.08
    inside = MeshDistance(open_mesh, samples=20_000)(position)[0] < 0
    assert (inside == (radius < 0.9))[clear].float().mean() > 0.998


def test_the_nearest_point_of_a_triangle():
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]).double()
    points = torch.tensor([[0.2, 0.2, 3], [2, -1, 0], [0.5, -2, 1], [1, 1, 0], [-1, -1, 5]]).double()
    true = torch.tensor([[0.2, 0.2, 0], [1, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0, 0]]).double()
    assert torch.allclose(closest(points, corners.expand(5, 3, 3)), true)


def test_it_learns_a_torus(network):
    found = surface_error(network, MeshDistance(TORUS, samples=5000), 5000)
    assert found["distance"] < 0.01 and found["degrees"] < 12
    position = random_points(5000, 0.8)
    position[:, 1] *= 0.4
    apart = network.distance(position) / network.step - torus_distance(position)
    assert apart.abs().mean() < 0.03


def test_its_gradient_is_nowhere_longer_than_one(network):
    low, high = (torch.tensor(corner) for corner in network.bounds)
    generator = torch.Generator().manual_seed(9)
    position = low + (high - low) * torch.rand((100_000, 3), generator=generator)
    length = with_gradient(network.layers(), position)[1].norm(dim=1)
    assert 0.5 < length.max() <= 1.0 and 0.2 < network.step <= 1.0
    assert steepest(network.layers(), network.bounds, 20_000) <= 1.0


def test_the_documented_formula_is_what_it_computes(network):
    position = random_points(100).requires_grad_()
    h = position.detach().numpy().astype(np.float64)
    *hidden, (weight, bias) = [(w.numpy().astype(np.float64), b.numpy()) for w, b in network.layers()]
    for w, b in hidden:
        h = np.sin(h @ w.T + b)
    value = network.distance(position)
    assert value.detach().numpy() == pytest.approx((h @ weight.T + bias)[:, 0], abs=1e-5)
    slope = torch.autograd.grad(value.sum(), position)[0]
    forward = with_gradient(network.layers(), position.detach())
    assert torch.allclose(forward[0], value, atol=1e-6) and torch.allclose(forward[1], slope, atol=1e-5)


def test_it_is_trained_once_and_alike(network, monkeypatch):
    def never(*_):
        raise AssertionError("trained again")

    monkeypatch.setattr("prt.scene.neural_sdf.train", never)
    again = fitted(TORUS, {"mesh": "torus"}, Fit(16, 2, 4.0, 1200, batch=512), points=12_000)
    assert all(torch.equal(a, b) for x, y in zip(again.layers(), network.layers(), strict=True)
               for a, b in zip(x, y, strict=True))  # fmt: skip
    assert again.fingerprint() == network.fingerprint() and again.step == network.step
    with pytest.raises(AssertionError, match="trained again"):
        fitted(TORUS, {"mesh": "torus"}, Fit(16, 2, 4.0, 1201, batch=512), points=12_000)


def test_it_is_a_surface(network, monkeypatch):
    monkeypatch.setattr("prt.scene.neural_sdf_scene.neural_bunny", lambda neurons, layers: network)
    scene = NeuralSdfScene(cameras(), sdf_neurons=16)
    scene.check()
    assert scene.bounds == box_of(TORUS) and scene.fingerprint()["scene"] == "neural_sdf"
    surface = SdfSurface(scene, cells=32)
    points = surface.sample(2000, 0)
    assert torus_distance(points.position).abs().mean() < 0.01
    assert surface.blocked is None
    origin = points.position + 1e-4 * surface.extent * points.normal
    # what sees itself straight along the normal is on the inner side of the hole
    blocked = surface.occluded(origin, points.normal)
    inner = points.position[:, [0, 2]].norm(dim=1) < 0.6
    assert blocked[inner & (points.normal[:, 1].abs() < 0.15)].float().mean() > 0.9
    assert blocked[~inner].float().mean() < 0.1
    seen = surface.capture(scene.views("far", 1, 24)[0])
    assert len(seen) > 20 and surface.counts["exhausted_rays"] < 20
    with pytest.raises(PrtError, match="no shapes for Mitsuba"):
        scene.load()


def test_impossible_settings_are_refused():
    with pytest.raises(PrtError, match="scene.sdf_neurons=2"):
        NeuralSdfScene(cameras(), sdf_neurons=2)
    with pytest.raises(PrtError, match="scene.sdf_layers=0"):
        NeuralSdfScene(cameras(), sdf_layers=0)
    with pytest.raises(PrtError, match="scene.albedo="):
        NeuralSdfScene(cameras(), albedo=[0.5, 2.0, 0.5])
    none = dataclasses.replace(TORUS, face=TORUS.face[:0])
    with pytest.raises(PrtError, match="no area"):
        MeshDistance(none)


def test_without_the_mesh_there_is_one_line(monkeypatch):
    monkeypatch.delenv("PRT_DATA", raising=False)
    with pytest.raises(PrtError, match="meshes/bunny.ply"):
        neural_bunny()


@needs_data
def test_the_bunny_in_a_hurry(tmp_path, monkeypatch):
    from prt.scene.closing import open_edges
    from prt.scene.neural_sdf import bunny_mesh, train, training_points

    mesh = bunny_mesh()
    assert len(open_edges(mesh)) == 0 and np.ptp(mesh.position, axis=0).max() == pytest.approx(1.8)
    true, bounds = MeshDistance(mesh, samples=50_000), box_of(mesh)
    points = training_points(true, bounds, count=4000)
    # half the points lie on it, a part of the others within
    assert 0.15 < float((points[1] < 0).float().mean()) < 0.4
    weights = train(*points, Fit(16, 2, iterations=300, batch=512))
    found = surface_error(NeuralSdf(weights, bounds, 1.0, {}), true, 3000)
    assert found["distance"] < 0.06 and found["degrees"] < 60

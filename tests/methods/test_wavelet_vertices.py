"""Wavelet-neural with its spatial factors on the vertices of meshes, in the place of the hash grid."""

import pytest
import tiny
import torch

from prt.bench.build import build as build_group
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.nn.vertex_features import VertexFeatures


def method(maps, *changes: str):
    settings = ["method=wavelet_neural", "method.features=vertices", "method.training.steps=5", *changes]
    return build_group(compose([*tiny.TASK, *tiny.lights(maps), *settings]), "method")


@pytest.fixture(scope="module")
def fitted(tiny_task, maps):
    out = method(maps)
    out.fit(tiny_task, tiny.Log(), 0, "cpu")
    return out


def test_features_lie_on_vertices_and_all_else_is_as_with_the_grid(fitted, tiny_task, maps):
    other = method(maps, "method.features=hashgrid")
    other.fit(tiny_task, tiny.Log(), 0, "cpu")
    assert isinstance(fitted.net.grid, VertexFeatures)
    mesh = fitted.net.grid.find.mesh
    assert len(fitted.net.grid.table) == len(mesh.position)
    corners = mesh.position[mesh.face]
    longest = (corners - corners.roll(-1, 1)).norm(dim=2).max()
    width = tiny_task.training().pixel_size
    assert width < longest <= 2 * width
    shapes = [
        {name: value.shape for name, value in m.net.state_dict().items() if not name.startswith("grid.")}
        for m in (fitted, other)
    ]
    assert shapes[0] == shapes[1] and fitted.net.terms == other.net.terms
    table = 4 * len(mesh.position) * fitted.net.terms
    assert fitted.nbytes() - table == other.nbytes() - other.net.grid.nbytes()


def test_fitting_changes_vertices_that_are_seen_and_lowers_the_loss(tiny_task, maps):
    out, log = method(maps, "method.training.steps=60", "method.training.decay.grid=0"), tiny.Log(every=1000)
    out.fit(tiny_task, log, 0, "cpu")
    assert sum(log.losses[-10:]) < 0.8 * sum(log.losses[:10])
    places = out.net.grid.locate(tiny_task.training().gbuffer)
    seen = torch.zeros(len(out.net.grid.table), dtype=torch.bool)
    seen[places.indices[places.weights > 0].long()] = True
    spread = out.net.grid.table.detach().abs().amax(1)
    assert spread[seen].mean() > 0.01 and spread[~seen].max() < 2e-4


def test_a_saved_model_renders_the_same_on_geometry_made_anew(fitted, tiny_task, maps, tmp_path):
    fitted.save(tmp_path / "model.safetensors")
    again = method(maps)
    again.load(tmp_path / "model.safetensors", tiny_task, "cpu")
    item = tiny_task.tests()[0]
    shaded = [m.shade(item.gbuffer, m.light(item.lighting)) for m in (fitted, again)]
    assert shaded[0].abs().mean() > 0 and torch.equal(*shaded)
    nothing = item.gbuffer.rows(torch.zeros(0, dtype=torch.long))
    assert again.shade(nothing, again.light(item.lighting)).shape == (0, 3)


def test_a_model_with_other_features_is_refused(fitted, tiny_task, maps, tmp_path):
    fitted.save(tmp_path / "model.safetensors")
    with pytest.raises(PrtError, match="method.features=vertices, not hashgrid"):
        method(maps, "method.features=hashgrid").load(tmp_path / "model.safetensors", tiny_task, "cpu")


def test_a_model_of_another_scene_is_refused(fitted, tiny_task, maps, tmp_path, monkeypatch):
    fitted.save(tmp_path / "model.safetensors")
    other = build_group(compose([*tiny.TASK, *tiny.lights(maps), "scene=four_shapes"]), "scene")
    monkeypatch.setattr(tiny_task, "scene", other)
    with pytest.raises(PrtError, match="rows of features, this scene"):
        method(maps).load(tmp_path / "model.safetensors", tiny_task, "cpu")


@pytest.mark.parametrize(
    "change, named",
    [
        ("method.features=texture", "method.features='texture' is not one of hashgrid, vertices"),
        ("method.vertices.edge_pixels=0", "edge_pixels=0 must be a number above 0"),
        ("method.vertices.most=none", "most='none' must be a whole number"),
    ],
)
def test_bad_settings_are_named(change, named, maps):
    with pytest.raises(PrtError, match=named) as caught:
        method(maps, change)
    assert "\n" not in str(caught.value)


def test_more_vertices_than_allowed_are_refused(tiny_task, maps):
    with pytest.raises(PrtError, match="method.vertices asks for edges.*more than 100 vertices"):
        method(maps, "method.vertices.most=100").fit(tiny_task, tiny.Log(), 0, "cpu")

"""Classical transfer as a method: closed forms on a sphere, interpolation, storage, and what it refuses."""

import dataclasses
import math
import types

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from kept_log import Log

from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light.cubemap import texel_directions
from prt.light.local import LightRig, LocalLight
from prt.light.sh import sh_basis
from prt.methods.base import Component, Method
from prt.methods.sh_vertex import ShVertex
from prt.scene.gbuffer import GBuffer
from prt.scene.lightmap_points import AtlasGBuffer, TriangleMesh
from prt.scene.shapes import MeshData, sphere_mesh, torus_mesh


def task_of(data: MeshData, albedo=(0.5, 0.5, 0.5), **more):
    """A task whose asset is this mesh."""
    position, normal = torch.tensor(data.position).float(), torch.tensor(data.normal).float()
    face = torch.from_numpy(data.face.astype(np.int64))
    mesh = TriangleMesh(position, normal, face, torch.zeros(len(face), dtype=torch.long))
    asset = types.SimpleNamespace(
        poses=1, stores="incident", mesh=lambda pose=0: mesh, scene=types.SimpleNamespace(max_depth=4),
        vertex_albedo=lambda pose=0: torch.tensor(albedo).expand(len(position), 3),
    )  # fmt: skip
    vars(asset).update(more)
    return types.SimpleNamespace(asset=asset)


def points_on(task, count: int = 300, diffuse: float = 1.0, specular: float = 0.0) -> AtlasGBuffer:
    """A G-buffer of random points of the asset's mesh."""
    mesh = task.asset.mesh(0)
    generator = torch.Generator().manual_seed(0)
    triangle = torch.randint(len(mesh.face), (count,), generator=generator)
    weights = torch.rand((count, 2), generator=generator)
    weights = torch.where(weights.sum(1, keepdim=True) > 1, 1 - weights, weights)
    full = torch.cat([1 - weights.sum(1, keepdim=True), weights], 1)[..., None]
    normal = torch.nn.functional.normalize((mesh.normal[mesh.face[triangle]] * full).sum(1), dim=1)
    position = (mesh.position[mesh.face[triangle]] * full).sum(1)
    one = torch.ones_like(position)
    return AtlasGBuffer(
        position, normal, normal, normal, diffuse * one, specular * one, one[:, :1], weights,
        torch.ones(count, dtype=torch.bool), triangle=triangle, barycentric=weights,
    )  # fmt: skip


def fitted(task, order=5, directions=256, bounces=2) -> ShVertex:
    method = ShVertex(order, directions, bounces)
    method.fit(task, Log(), 0, "cpu")
    return method


SUN = LocalLight("directional", (3.0, 2.0, 1.0), direction=(0.6, -0.8, 0.0))


@pytest.fixture(scope="module")
def torus():
    task = task_of(torus_mesh(1.0, 0.5, columns=32, rows=16))
    return task, fitted(task)


# ---- lighting


def test_a_directional_light_is_a_delta_distribution(torus):
    _, method = torus
    code = method.light(LightRig((SUN,)))
    towards = torch.tensor([[-0.6, 0.8, 0.0]])
    assert torch.allclose(code, sh_basis(towards, 4).T * torch.tensor([3.0, 2.0, 1.0]), atol=1e-6)


def test_lights_add_up(torus):
    _, method = torus
    sky = torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(0))
    other = LocalLight("directional", (0.5, 0.5, 0.5), direction=(0.0, -1.0, 0.0))
    alone = [method.light(LightRig((light,))) for light in (SUN, other)] + [method.light(LightRig((), sky))]
    assert torch.allclose(method.light(LightRig((SUN, other), sky)), sum(alone), atol=1e-5)
    assert torch.equal(method.light(LightRig()), torch.zeros(25, 3))
    # the constant part of the environment is its integral over sqrt(4 pi)
    constant = method.light(LightRig((), torch.full((6, 8, 8, 3), 2.0)))
    assert torch.allclose(constant[0], torch.tensor(2 * math.sqrt(4 * math.pi)), atol=1e-4)
    assert constant[1:].abs().max() < 5e-3  # what the quadrature over 8 texels a side leaves


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_refuses_lights_at_a_finite_distance(torus, kind):
    with pytest.raises(PrtError, match=f"{kind} light.*directional.*environments.*svd_transfer") as caught:
        torus[1].light(LightRig((SUN, LocalLight(kind, (1.0, 1.0, 1.0)))))
    assert "\n" not in str(caught.value)


# ---- shading


def test_a_sphere_in_the_sun_is_the_band_limited_cosine():
    """Irradiance over pi: 2 per cent of the light, and the leak behind the sphere that the bands imply."""
    task = task_of(sphere_mesh(1.0))
    method, g = fitted(task, directions=1024), points_on(task)
    code = method.light(LightRig((SUN,)))
    bands = torch.tensor([l for l in range(5) for _ in range(2 * l + 1)])
    cosine = torch.tensor([1, 2 / 3, 1 / 4, 0, -1 / 24])[bands]
    expected = (cosine * sh_basis(g.normal, 4)) @ code
    found = method.direct(g, code)
    scale = torch.tensor([3.0, 2.0, 1.0]) / math.pi
    assert ((found - expected) / scale).abs().max() < 0.03
    lit = g.normal @ torch.tensor([-0.6, 0.8, 0.0])
    assert ((found / scale)[:, 0] - lit.clamp_min(0)).abs().max() < 0.12
    assert (found / scale)[lit < 0, 0].max() > 0.02
    assert method.shade(g, code).abs().max() == 0


def test_constant_light_adds_its_reflections(torus):
    """Sky of radiance 1: what is hidden from the sky is seen of the torus itself, of albedo 0.5."""
    task, method = torus
    g = points_on(task)
    code = method.light(LightRig((), torch.ones(6, 8, 8, 3)))
    direct, indirect = method.direct(g, code), method.shade(g, code)
    hidden = 1 - direct
    assert float(hidden.max()) > 0.1 and float(hidden.min()) > -1e-4
    # between one reflection of the darkest place and an albedo series of full light
    assert bool((indirect >= 0.5 * hidden * direct.min() - 1e-4).all())
    assert bool((indirect <= hidden * (0.5 + 0.25) + 1e-4).all())


def test_colour_of_a_vertex_shows_at_the_vertex_and_mixes_between(torus):
    task, method = torus
    mesh = task.asset.mesh(0)
    code, g = method.light(LightRig((SUN,))), points_on(task)
    direct, transfer, face = method._fitted()
    colour = torch.einsum("vkc,kc->vc", transfer, code)
    for k, weights in enumerate([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]):
        at = dataclasses.replace(g, barycentric=torch.tensor(weights).expand(len(g), 2))
        assert torch.allclose(method.shade(at, code), colour[mesh.face[g.triangle, k]], atol=1e-6)
        assert torch.allclose(method.direct(at, code), (direct @ code)[mesh.face[g.triangle, k]], atol=1e-6)
    middle = dataclasses.replace(g, barycentric=torch.full((len(g), 2), 1 / 3))
    assert torch.allclose(method.shade(middle, code), colour[mesh.face[g.triangle]].mean(1), atol=1e-6)
    assert torch.equal(face, mesh.face)


def test_both_reflectances_count(torus):
    task, method = torus
    code = method.light(LightRig((SUN,)))
    white = method.shade(points_on(task), code)
    mixed = method.shade(points_on(task, diffuse=0.3, specular=0.25), code)
    assert torch.allclose(mixed, 0.55 * white, atol=1e-6) and white.abs().max() > 1e-3


def test_radiance_is_linear_in_the_light(torus):
    task, method = torus
    g = points_on(task)
    sky = LightRig((), torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(1)))
    both = LightRig((SUN,), sky.environment)
    parts = sum(method.shade(g, method.light(rig)) for rig in (LightRig((SUN,)), sky))
    assert torch.allclose(method.shade(g, method.light(both)), parts, atol=1e-5)


def test_the_environment_is_turned_as_cubemaps_are():
    """Light from above only: the top of a sphere is bright, its underside is not."""
    task = task_of(sphere_mesh(1.0))
    method, g = fitted(task, order=3), points_on(task)
    above = (texel_directions(16)[..., 1:2] > 0).float().expand(-1, -1, -1, 3)
    found = method.direct(g, method.light(LightRig((), above)))[:, 0]
    # irradiance of a half sphere of radiance 1: (1 + cosine) / 2 of pi
    assert (found - (1 + g.normal[:, 1]) / 2).abs().max() < 0.03


# ---- fitting and storage


def test_is_a_method_for_local_lights(torus):
    assert isinstance(torus[1], Method)
    assert ShVertex.component is Component.INDIRECT and ShVertex.tasks == {"local_lights"}


def test_bounces_are_those_of_the_scenes_paths():
    task = task_of(torus_mesh(1.0, 0.5, columns=16, rows=8))
    by_scene, three, one = (fitted(task, 2, 32, bounces) for bounces in (None, 3, 1))
    code, g = three.light(LightRig((SUN,))), points_on(task)
    assert torch.equal(by_scene.shade(g, code), three.shade(g, code))
    assert (one.shade(g, code) - three.shade(g, code)).abs().max() > 1e-5


def test_an_interrupted_fit_goes_on_from_what_was_kept(torus, monkeypatch):
    task, _ = torus
    log = Log()
    first = ShVertex(3, 32, 1)
    first.fit(task, log, 0, "cpu")
    assert log.values["direct"] == pytest.approx(0.8, abs=0.2) and log.values["interreflected"] > 0.01
    monkeypatch.setattr("prt.methods.sh_vertex.vertex_transfer", None)
    again = ShVertex(3, 32, 1)
    again.fit(task, Log(log.kept), 0, "cpu")
    g, code = points_on(task), first.light(LightRig((SUN,)))
    assert torch.equal(again.shade(g, code), first.shade(g, code))


def test_save_and_load_render_the_same(torus, tmp_path):
    task, method = torus
    method.save(tmp_path / "checkpoint.safetensors")
    other = ShVertex(5, 256, 2)
    other.load(tmp_path / "checkpoint.safetensors", task, "cpu")
    g, rig = points_on(task), LightRig((SUN,))
    assert torch.equal(other.shade(g, other.light(rig)), method.shade(g, method.light(rig)))
    assert torch.equal(other.direct(g, other.light(rig)), method.direct(g, method.light(rig)))
    assert other.nbytes() == method.nbytes() == 4 * len(task.asset.mesh(0).position) * 25 * 3


def test_refuses_a_checkpoint_of_something_else(torus, tmp_path):
    task, method = torus
    path = tmp_path / "checkpoint.safetensors"
    method.save(path)
    with pytest.raises(PrtError, match="method.order=4 means 16; set method.order=5"):
        ShVertex(4, 256, 2).load(path, task, "cpu")
    with pytest.raises(PrtError, match="vertices"):
        ShVertex(5, 256, 2).load(path, task_of(sphere_mesh(1.0)), "cpu")


# ---- refusals


@pytest.mark.parametrize(
    "changed, named",
    [
        ({"order": 0}, "order=0.*1 to 16"),
        ({"order": 2.0}, "order=2.0"),
        ({"directions": 0}, "directions=0"),
        ({"bounces": 0}, "bounces=0.*or null"),
        ({"bounces": True}, "bounces=True"),
    ],
)
def test_refuses_settings(changed, named):
    with pytest.raises(PrtError, match=named) as caught:
        ShVertex(**({"order": 5, "directions": 16, "bounces": 1} | changed))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "more, named",
    [({"poses": 4}, "the asset has 4"), ({"stores": "outgoing"}, "light passes through"), (None, "hair")],
)
def test_refuses_assets_it_cannot_do(more, named, torus, tmp_path):
    torus[1].save(tmp_path / "checkpoint.safetensors")
    task = task_of(sphere_mesh(1.0), **(more or {}))
    if more is None:
        del task.asset.mesh
        task.asset.stores = "outgoing"
    with pytest.raises(PrtError, match=f"{named}.*svd_transfer") as caught:
        ShVertex(2, 8, 1).fit(task, Log(), 0, "cpu")
    assert "\n" not in str(caught.value)
    with pytest.raises(PrtError, match=named):
        ShVertex(5, 8, 1).load(tmp_path / "checkpoint.safetensors", task, "cpu")


def test_refuses_to_render_before_it_is_fitted_and_points_without_triangles(torus, tmp_path):
    task, method = torus
    g = points_on(task)
    new = ShVertex(5, 8, 1)
    for use in (lambda: new.light(LightRig()), lambda: new.shade(g, torch.zeros(25, 3)), new.nbytes,
                lambda: new.direct(g, torch.zeros(25, 3)), lambda: new.save(tmp_path / "none")):  # fmt: skip
        with pytest.raises(PrtError, match="no transfer yet"):
            use()
    parts = {name: getattr(g, name) for name in GBuffer.FIELDS}
    with pytest.raises(PrtError, match="triangles"):
        method.shade(GBuffer(**parts, hit=g.hit), torch.zeros(25, 3))


def test_the_configuration_builds_it():
    chosen = ["task=local_lights", "scene=lion", "lighting=directional", "method=sh_vertex"]
    for budget in ("smoke", "laptop", "gpu", "paper"):
        method = instantiate(compose([*chosen, f"budget={budget}"]).method)
        assert isinstance(method, ShVertex) and method.order == 5 and method.bounces is None

"""Stored transfer in all its forms: equal to cast transfer where it can be, on disk, and what is refused."""

import math
import types

import pytest
import torch
from kept_log import Log

from prt.errors import PrtError
from prt.light.sh_products import phong_bands, window
from prt.methods.base import Component, Method
from prt.methods.cast_prt import CastPrt
from prt.methods.irradiance_volume import IrradianceVolume, outside, times_cosine
from prt.methods.texture_prt import TexturePrt
from prt.methods.vertex_prt import VertexPrt
from prt.scene.gbuffer import GBuffer
from prt.scene.shapes import MeshData, sphere_mesh
from prt.scene.view import View
from prt.trace import sh_shading
from prt.trace.surface import MeshSurface
from prt.trace.texture_transfer import texture_transfer


def ball_task(order=4):
    """A unit ball alone: its transfer is the open one everywhere."""
    import sys
    from pathlib import Path

    sys.path.insert(0, str(Path(__file__).parents[1] / "trace"))
    from trace_scenes import DictScene, diffuse

    from prt.scene.shapes import to_mesh

    data: MeshData = sphere_mesh(1.0, 24, 12)
    surface = MeshSurface(DictScene({"ball": to_mesh("ball", data, diffuse(0.5))}), 64)
    return types.SimpleNamespace(
        surface=surface, scene=types.SimpleNamespace(name="ball"), order=order, windowing=0.0, texels=64,
        texture=lambda seed: texture_transfer(surface, order, 256, seed),
    )  # fmt: skip


@pytest.fixture(scope="module")
def task():
    return ball_task()


VIEW = View((0.0, 1.0, 4.0), (0.0, 0.0, 0.0), width=24, height=24)
METHODS = {
    "texture": lambda: TexturePrt(), "vertex": lambda: VertexPrt(256),
    "volume": lambda: IrradianceVolume(9, 256), "cast": lambda: CastPrt(256),
}  # fmt: skip


@pytest.mark.parametrize("name", METHODS)
def test_it_is_a_method_that_survives_the_disk(name, task, tmp_path):
    method = METHODS[name]()
    assert isinstance(method, Method) and method.component is Component.DIRECT
    with pytest.raises(PrtError, match="no transfer yet"):
        method.light(torch.ones((6, 8, 8, 3)))
    method.fit(task, Log(), 0, "cpu")
    gbuffer = task.surface.capture(VIEW)
    code = method.light(torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(0)))
    image = method.shade(gbuffer, code)
    assert image.shape == (len(gbuffer), 3) and (method.nbytes() > 0) == (name != "cast")
    method.save(tmp_path / "x.safetensors")
    again = METHODS[name]()
    again.load(tmp_path / "x.safetensors", task, "cpu")
    torch.testing.assert_close(again.shade(gbuffer, code), image)
    with pytest.raises(PrtError, match="another number of bands than task.order=3"):
        METHODS[name]().load(tmp_path / "x.safetensors", ball_task(3), "cpu")


def test_a_cast_keeps_its_seed(task, tmp_path):
    gbuffer, found = task.surface.capture(VIEW), []
    for seed in (0, 1):
        method = CastPrt(16)
        method.fit(task, Log(), seed, "cpu")
        method.save(tmp_path / "cast.safetensors")
        again = CastPrt(16)
        again.load(tmp_path / "cast.safetensors", task, "cpu")
        torch.testing.assert_close(again.transfer(gbuffer), method.transfer(gbuffer))
        found.append(again.transfer(gbuffer))
    assert not torch.equal(*found)


@pytest.mark.parametrize(("name", "least"), [("texture", 0.004), ("vertex", 0.02), ("cast", 0.003)])
def test_an_open_ball_has_the_open_transfer(name, least, task):
    method = METHODS[name]()
    method.fit(task, Log(), 0, "cpu")
    gbuffer = task.surface.capture(VIEW)
    open_ = times_cosine(torch.eye(16)[:1].expand(len(gbuffer), 16) * math.sqrt(4 * math.pi), gbuffer.normal)
    assert float((method.transfer(gbuffer) - open_).abs().mean()) < least


@pytest.mark.parametrize(("nodes", "most"), [(5, 0.25), (33, 0.08)])
def test_a_volume_around_a_ball_nears_the_cast_transfer(nodes, most):
    """Half a sphere, cut to four bands, times the cosine: a few percent are lost whatever the grid."""
    task, truth, method = ball_task(), METHODS["cast"](), IrradianceVolume(nodes, 128)
    gbuffer = task.surface.capture(VIEW)
    for one in (truth, method):
        one.fit(task, Log(), 0, "cpu")
    wrong = method.transfer(gbuffer) - truth.transfer(gbuffer)
    assert float(wrong.norm() / truth.transfer(gbuffer).norm()) < most


def test_nodes_inside_of_solids_take_the_nearest_that_sees():
    grid = torch.zeros((4, 1, 1, 5))
    grid[0, 0, 0] = torch.tensor([3.0, 0.0, 0.0, 0.0, 2.0])
    grid[1, 0, 0] = torch.tensor([1.0, 9.0, 9.0, 9.0, -1.0])
    filled = outside(grid)
    assert filled[0, 0, 0].tolist()[:2] == [3, 3] and filled[0, 0, 0].tolist()[3:] == [2, 2]
    assert filled[1, 0, 0].tolist()[1] == 1 and filled[1, 0, 0].tolist()[3] == -1
    assert torch.equal(outside(torch.zeros((4, 1, 1, 2))), torch.zeros((4, 1, 1, 2)))


def point(normal=(0.0, 1.0, 0.0), wr=(0.0, 1.0, 0.0), specular=0.0, diffuse=0.0, roughness=1.0):
    one = torch.ones((1, 3))
    n, r = torch.tensor([normal]), torch.tensor([wr])
    return GBuffer(
        0 * one, n, r, r, diffuse * one, specular * one, torch.tensor([[roughness]]), one[:, :2],
        torch.ones(1, dtype=torch.bool),
    )  # fmt: skip


def open_transfer(order):
    whole = torch.zeros((1, order**2))
    whole[0, 0] = math.sqrt(4 * math.pi)
    return times_cosine(whole, torch.tensor([[0.0, 1.0, 0.0]]))


def test_constant_light_on_open_ground_gives_the_albedo():
    code = sh_shading.encode(torch.ones((6, 8, 8, 3)), 4)
    out = sh_shading.shade(open_transfer(4), point(diffuse=0.6), code)
    torch.testing.assert_close(out, torch.full((1, 3), 0.6), atol=1e-4, rtol=0)


def test_glossy_is_the_lobe_on_the_product():
    """By numbers: the product of both expansions, integrated against the lobe cut to the same bands."""
    from prt.light.cubemap import texel_directions, texel_solid_angles
    from prt.light.sh import sh_basis

    order = 4
    # two bands each: the product has three, and none is cut
    transfer, light = torch.zeros((1, 16)), torch.zeros((16, 3))
    generator = torch.Generator().manual_seed(0)
    transfer[:, :4] = torch.randn((1, 4), generator=generator)
    light[:4] = torch.randn((4, 3), generator=generator)
    wr = torch.nn.functional.normalize(torch.tensor([[0.3, 0.8, -0.5]]), dim=1)
    roughness = sh_shading.roughness_of(6.0)
    found = sh_shading.shade(
        transfer, point(wr=tuple(wr[0].tolist()), specular=1.0, roughness=roughness),
        sh_shading.ShCode.of(light),
    )  # fmt: skip
    d, area = texel_directions(96).reshape(-1, 3), texel_solid_angles(96).reshape(-1, 1)
    basis = sh_basis(d, order - 1)
    # an even exponent and the product's three bands: the lobe's own truncation does not show
    lobe = 8 / (2 * math.pi) * (d @ wr[0]).clamp_min(0)[:, None] ** 6
    expected = (area * lobe * math.pi * (basis @ transfer[0])[:, None] * (basis @ light)).sum(0)
    torch.testing.assert_close(found[0], expected, atol=2e-3, rtol=2e-3)


def test_exponents_and_roughness_are_inverse():
    for exponent in (0.5, 10.0, 200.0):
        rough = torch.tensor([[sh_shading.roughness_of(exponent)]])
        assert float(sh_shading.exponent_of(rough)) == pytest.approx(exponent, rel=1e-4)
    assert float(phong_bands(sh_shading.exponent_of(torch.zeros((1, 1))), 4)[0, 3]) == pytest.approx(
        1, abs=1e-3
    )


def test_the_window_is_applied_to_the_light():
    light = torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(3))
    plain, damped = sh_shading.encode(light, 4), sh_shading.encode(light, 4, 0.05)
    torch.testing.assert_close(damped.coefficients, window(4, 0.05)[:, None] * plain.coefficients)


def test_a_field_has_no_vertices_and_no_texture():
    task = types.SimpleNamespace(
        surface=types.SimpleNamespace(), scene=types.SimpleNamespace(name="blob"), order=4, windowing=0.0,
        texture=lambda seed: torch.zeros((4, 16)),
    )  # fmt: skip
    for method in (TexturePrt(), VertexPrt(4)):
        with pytest.raises(PrtError, match="scene=blob has none, or task.texels=0; take method=learnt_sh"):
            method.fit(task, Log(), 0, "cpu")


def test_bad_sizes_of_a_volume():
    with pytest.raises(PrtError, match="method.nodes=1 must be"):
        IrradianceVolume(1, 8)

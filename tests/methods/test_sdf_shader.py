"""Sphere tracing in a fragment shader against the analytic sphere and the torch tracer."""

import dataclasses
import types

import pytest
import torch

from prt.errors import PrtError
from prt.methods.gl_context import available
from prt.methods.sdf_shader import SdfShader
from prt.nn.transfer_network import TransferNetwork
from prt.scene.capture import facing, pixel_directions
from prt.scene.view import View
from prt.trace import sh_shading
from prt.trace.sdf_surface import SdfSurface
from prt.trace.sh_shading import ShCode

NO_OPENGL = available()
drawn = pytest.mark.skipif(NO_OPENGL is not None, reason=NO_OPENGL or "")
BOX = ((-1.1, -1.1, -1.1), (1.1, 1.1, 1.1))
SPHERE = "float sdf(vec3 p) { return length(p - vec3(0.1, 0.0, 0.2)) - 0.8; }\n"
CENTRE, RADIUS = (0.1, 0.0, 0.2), 0.8
VIEW = View((1.5, 1.2, 2.4), (0.0, 0.1, 0.0), fov=50.0, width=48, height=36)
ALBEDO, SPECULAR, ROUGHNESS = (0.8, 0.5, 0.2), (0.3, 0.4, 0.5), 0.4


def network(order=3):
    # one octave: what is judged is the place, not the network's slope
    return TransferNetwork(BOX, 10, 2, order**2, 1, 1, torch.Generator().manual_seed(1))  # pyright: ignore


def light(order=3):
    return ShCode.of(torch.randn((order**2, 3), generator=torch.Generator().manual_seed(2)))


def sphere(position):
    return (position - position.new_tensor(CENTRE)).norm(dim=1) - RADIUS


def shaded(position, normal, wr, order=3):
    """The image's rows by torch."""
    rows = types.SimpleNamespace(
        diffuse=torch.tensor(ALBEDO), specular=torch.tensor(SPECULAR), wr=wr,
        roughness=torch.full((len(wr), 1), ROUGHNESS),
    )  # fmt: skip
    with torch.no_grad():
        return sh_shading.shade(network(order)(position, normal), rows, light(order))  # type: ignore[arg-type]


@drawn
def test_a_sphere_is_the_analytic_one():
    origin, ray = torch.tensor(VIEW.origin), torch.from_numpy(pixel_directions(VIEW))
    towards = torch.tensor(CENTRE) - origin
    along = ray @ towards
    square = RADIUS**2 - (towards.square().sum() - along**2)
    hit = square > 0
    position = origin + (along[hit] - square[hit].sqrt())[:, None] * ray[hit]
    outward = torch.nn.functional.normalize(position - torch.tensor(CENTRE), dim=1)
    normal, _, wr = facing(VIEW, position, outward, outward)
    with SdfShader(SPHERE, BOX, network(), 3, ALBEDO, SPECULAR, ROUGHNESS) as shader:
        image, found, exhausted = shader.render(VIEW, light())
    # rays that graze by less than epsilon may be either
    edge = (square.abs() < 1e-4).view(VIEW.height, VIEW.width)
    assert torch.equal(found | edge, hit.view_as(found) | edge) and exhausted == 0
    truth = torch.zeros((len(ray), 3))
    truth[hit] = shaded(position, normal, wr)
    inside = ((square > 1e-2) | ~hit).view_as(found) & ~edge
    error = (image - truth.view_as(image))[inside].abs().max() / truth.abs().max()
    assert float(error) < 1e-3
    assert (image[~found] == 0).all()


@drawn
def test_steps_and_their_limit_are_those_of_the_torch_tracer():
    scene = types.SimpleNamespace(distance=lambda p: 0.5 * sphere(p), sdf=None, bounds=BOX, albedo=ALBEDO)
    slow = SPHERE.replace("return", "return 0.5 *").replace("length(p - vec3(0.1, 0.0, 0.2)) - 0.8", "(length(p - vec3(0.1, 0.0, 0.2)) - 0.8)")  # fmt: skip # noqa: E501
    wide = dataclasses.replace(VIEW, up=(0.3, 1.0, 0.1), width=37, height=41)
    for steps, view in ((16, VIEW), (200, wide)):
        surface = SdfSurface(scene, steps=steps)
        gbuffer = surface.capture(view)
        truth = gbuffer.image(shaded(gbuffer.position, gbuffer.normal, gbuffer.wr))
        with SdfShader(slow, BOX, network(), 3, ALBEDO, SPECULAR, ROUGHNESS, steps=steps) as shader:
            image, hit, exhausted = shader.render(view, light())
        assert (exhausted > 100) == (steps == 16)
        assert abs(exhausted - surface.counts["exhausted_rays"]) <= 2
        same = hit == gbuffer.hit.view_as(hit)
        assert int((~same).sum()) <= 2
        assert float((image - truth)[same].abs().max() / truth.abs().max()) < 1e-3


@drawn
def test_one_shader_draws_several_views_from_inside_as_well():
    with SdfShader(SPHERE, BOX, network(2), 2, material="diffuse", specular=(9.0, 9.0, 9.0)) as shader:
        first, hit, _ = shader.render(VIEW, light(2))
        away = dataclasses.replace(VIEW, target=(3.0, 2.4, 5.0), width=20)
        nothing, none, exhausted = shader.render(away, light(2))
        assert nothing.shape == (36, 20, 3) and not none.any() and not nothing.any() and exhausted == 0
        _, all_of_it, _ = shader.render(dataclasses.replace(VIEW, origin=(0.1, 0.0, 0.3)), light(2))
        assert all_of_it.all()
        assert torch.equal(shader.render(VIEW, light(2))[0], first) and hit.any()


@drawn
def test_what_makes_no_shader_is_refused():
    with pytest.raises(PrtError, match="is no box"):
        SdfShader(SPHERE, (BOX[1], BOX[0]), network(), 3)
    with pytest.raises(PrtError, match="must be above 0"):
        SdfShader(SPHERE, BOX, network(), 3, epsilon=0.0)
    with pytest.raises(PrtError, match="refuses the fragment shader"):
        SdfShader("float sdf(vec3 p) { return q; }\n", BOX, network(), 3)
    with SdfShader(SPHERE, BOX, network(2), 2, material="diffuse") as shader:
        with pytest.raises(PrtError, match="is no camera"):
            shader.draw(dataclasses.replace(VIEW, target=VIEW.origin), light(2))

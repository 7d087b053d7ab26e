"""Network and shading in a fragment shader against torch, pixel by pixel, and what is refused."""

import dataclasses

import pytest
import torch

from prt.errors import PrtError
from prt.methods import transfer_shader
from prt.methods.gl_context import available
from prt.methods.transfer_shader import TransferShader
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer
from prt.scene.view import View
from prt.trace import sh_shading
from prt.trace.sh_shading import ShCode

NO_OPENGL = available()
drawn = pytest.mark.skipif(NO_OPENGL is not None, reason=NO_OPENGL or "")
WIDTH, HEIGHT = 40, 28
TOLERANCE = 1e-5  # of the image's maximum


def generated(seed):
    return torch.Generator().manual_seed(seed)


def made(share=0.7, width=WIDTH, height=HEIGHT):
    """A G-buffer with holes, random everything, roughness down to a mirror."""
    generator = generated(width)
    hit = torch.rand(width * height, generator=generator) < share
    count = int(hit.sum())
    normal, wo, wr = torch.nn.functional.normalize(torch.randn((3, count, 3), generator=generator), dim=2)
    position, diffuse, specular = torch.rand((3, count, 3), generator=generator)
    roughness = torch.rand((count, 1), generator=generator)
    roughness[:4, 0] = torch.tensor([0.0, 1.0, 0.02, 0.05])
    view = View((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), width=width, height=height)
    return GBuffer(position, normal, wo, wr, diffuse, specular, roughness, wr[:, :2], hit, view)


def network(order, neurons=12, layers=2, octaves=(3, 1), seed=0):
    out = TransferNetwork(
        ([0.0, -0.1, 0.0], [1.0, 1.0, 1.2]), neurons, layers, order**2, *octaves, generated(seed)
    )
    out.scale.copy_(0.5 + torch.rand(order**2, generator=generated(seed + 50)))
    return out


def light(order, seed=0):
    return ShCode.of(torch.randn((order**2, 3), generator=generated(seed + 7)))


def expected(net, gbuffer, code, material="both"):
    black = torch.zeros_like(gbuffer.diffuse)
    without = {"diffuse": {"specular": black}, "glossy": {"diffuse": black}, "both": {}}[material]
    with torch.no_grad():
        transfer = net(gbuffer.position, gbuffer.normal)
        return gbuffer.image(sh_shading.shade(transfer, dataclasses.replace(gbuffer, **without), code))


def difference(image, other):
    return float((image - other).abs().max() / other.abs().max())


@drawn
@pytest.mark.parametrize("material", ["diffuse", "glossy", "both"])
@pytest.mark.parametrize(
    ("order", "neurons", "layers"), [(1, 4, 1), (2, 16, 3), (3, 7, 2), (4, 20, 1), (5, 9, 2)]
)
def test_shader_agrees_with_torch(order, neurons, layers, material):
    net, code, gbuffer = network(order, neurons, layers), light(order), made()
    with TransferShader(net, order, material) as shader:
        shader.set_gbuffer(gbuffer)
        image = shader.render(code)
        assert shader.source_bytes > 1000 and shader.compile_seconds > 0
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert difference(image, expected(net, gbuffer, code, material)) < TOLERANCE
    assert (image.view(-1, 3)[~gbuffer.hit] == 0).all()


@drawn
def test_new_lights_and_images_replace_the_old():
    net = network(2)
    with TransferShader(net, 2) as shader:
        for seed, (share, width) in enumerate([(0.9, 40), (0.05, 40), (0.5, 17), (0.0, 17)]):
            gbuffer, code = made(max(share, 0.05), width), light(2, seed)
            if share == 0:
                gbuffer = dataclasses.replace(gbuffer.rows(torch.arange(0)), hit=gbuffer.hit & False,
                                              view=gbuffer.view)  # fmt: skip
            shader.set_gbuffer(gbuffer)
            for again in (code, light(2, seed + 10)):
                image, truth = shader.render(again), expected(net, gbuffer, again)
                assert float((image - truth).abs().max()) <= TOLERANCE * float(truth.abs().max())


@drawn
def test_each_cell_is_shaded_by_its_network():
    nets, code, gbuffer = [network(3, seed=k) for k in range(3)], light(3), made()
    cell = torch.randint(3, (len(gbuffer),), generator=generated(5))
    apart = torch.stack([expected(net, gbuffer, code) for net in nets])
    number = gbuffer.image(cell[:, None].float())[None].long().expand(1, -1, -1, 3)
    with TransferShader(nets, 3) as shader:
        shader.set_gbuffer(gbuffer, cell)
        assert difference(shader.render(code), apart.gather(0, number)[0]) < TOLERANCE
        shader.set_gbuffer(gbuffer)
        assert difference(shader.render(code), apart[0]) < TOLERANCE


@drawn
def test_what_does_not_fit_is_refused(monkeypatch):
    gbuffer, net = made(), network(2, 4, 1)
    with TransferShader(net, 2, "diffuse") as shader:
        with pytest.raises(PrtError, match="call set_gbuffer first"):
            shader.draw(light(2))
        with pytest.raises(PrtError, match="belongs to none"):
            shader.set_gbuffer(dataclasses.replace(gbuffer, view=None))
        with pytest.raises(PrtError, match="numbers from 0 to 0"):
            shader.set_gbuffer(gbuffer, torch.ones(len(gbuffer)))
        shader.set_gbuffer(gbuffer)
        with pytest.raises(PrtError, match="9 coefficients for a shader of order=2"):
            shader.render(light(3))
    with pytest.raises(PrtError, match="was released"):
        shader.finish()
    with pytest.raises(PrtError, match="material='metal' is not one of diffuse, glossy, both"):
        TransferShader(net, 2, "metal")
    with pytest.raises(PrtError, match="4 outputs for order=3"):
        TransferShader(net, 3)
    with pytest.raises(PrtError, match="order=20 must be 1 to"):
        TransferShader(network(20, 1, 1, (0, 0)), 20, "diffuse")
    monkeypatch.setattr(transfer_shader, "MAIN", "nonsense;")
    with pytest.raises(PrtError, match="refuses the fragment shader .*error.*renderer=torch"):
        TransferShader(net, 2)


def test_a_network_that_does_not_fit_is_refused_before_opengl_is_asked(monkeypatch):
    from prt.methods import gl_context

    monkeypatch.setattr(gl_context, "open_context", lambda: pytest.fail("opened"))
    with pytest.raises(PrtError, match="mat4 constants .* renderer=torch"):
        TransferShader(network(4, 256, 4), 4)

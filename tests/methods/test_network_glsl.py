"""Networks written as GLSL against torch, value by value, and what is refused."""

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.methods.gl_context import VERTEX, available, open_context
from prt.methods.network_glsl import (
    ALWAYS,
    check_fits,
    literal,
    matrices,
    mlp_source,
    sdf_source,
    transfer_source,
    transfers_source,
)
from prt.nn.encodings import frequencies
from prt.nn.transfer_network import TransferNetwork

NO_OPENGL = available()
drawn = pytest.mark.skipif(NO_OPENGL is not None, reason=NO_OPENGL or "")
SIDE = 8
FUNCTIONS = {
    "relu": torch.relu,
    "leaky_relu": lambda x: torch.nn.functional.leaky_relu(x, 0.2),
    "softplus": lambda x: torch.nn.functional.softplus(x, 100.0),
    "sine": lambda x: torch.sin(30.0 * x),
}


def random(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def places(count=SIDE * SIDE):
    return random(count, 3, seed=1), torch.nn.functional.normalize(random(count, 3, seed=2), dim=1)


def values_of(source, statement):
    """What a statement writes into ``vec4 color``, for all places; ``p`` and ``n`` are place and normal."""
    main = f"""
    uniform sampler2D position, normal;
    out vec4 color;
    void main() {{
        vec3 p = texelFetch(position, ivec2(gl_FragCoord.xy), 0).xyz;
        vec3 n = texelFetch(normal, ivec2(gl_FragCoord.xy), 0).xyz;
        {statement}
    }}"""
    context = open_context()
    try:
        program = context.program(VERTEX, fragment_shader=f"#version 330\n{ALWAYS}{source}{main}")
        for unit, (name, values) in enumerate(zip(("position", "normal"), places(), strict=True)):
            texture = context.texture((SIDE, SIDE), 3, values.numpy().tobytes(), dtype="f4")
            texture.use(unit)
            if name in program:
                program[name] = unit
        target = context.framebuffer([context.renderbuffer((SIDE, SIDE), 4, dtype="f4")])
        target.use()
        context.vertex_array(program, []).render(vertices=3)
        return torch.frombuffer(bytearray(target.read(components=4, dtype="f4")), dtype=torch.float32).view(
            -1, 4
        )
    finally:
        context.release()


@drawn
@pytest.mark.parametrize(("neurons", "layers", "octaves"), [(8, 1, (0, 0)), (13, 3, (4, 1)), (10, 2, (2, 0))])
def test_transfer_is_that_of_the_network(neurons, layers, octaves):
    network = TransferNetwork(([-1.0, 0.0, 2.0], [2.0, 1.0, 3.0]), neurons, layers, 9, *octaves,
                              torch.Generator().manual_seed(3))  # fmt: skip
    with torch.no_grad():
        network.scale.copy_(torch.rand(9) + 0.5)
        network.mlp.layers[0].bias.copy_(random(neurons, seed=4))
        expected = network(*places())
    for first in (0, 5):
        found = values_of(
            transfer_source(network),
            f"float t[9]; transfer(p, n, t); color = vec4(t[{first}], t[{first + 1}], t[{first + 2}], t[8]);",
        )
        assert torch.allclose(found, expected[:, [first, first + 1, first + 2, 8]], atol=2e-5)


@drawn
@pytest.mark.parametrize("activation", FUNCTIONS)
@pytest.mark.parametrize("octaves", [0, 2])
def test_a_distance_is_that_of_its_network(activation, octaves):
    parameter = {"relu": None, "leaky_relu": 0.2, "softplus": 100.0, "sine": 30.0}[activation]
    sizes = [3 * (1 + 2 * octaves), 11, 6, 1]
    layers = [
        (0.3 * random(b, a, seed=a), 0.1 * random(b) if b > 6 else None)
        for a, b in zip(sizes[:-1], sizes[1:], strict=True)
    ]
    value = frequencies(places()[0], octaves)
    for number, (weight, bias) in enumerate(layers):
        value = value @ weight.T + (0 if bias is None else bias)
        value = value if number == 2 else FUNCTIONS[activation](value)
    source = sdf_source(layers, activation, parameter, scale=0.7, octaves=octaves)
    found = values_of(source, "color = vec4(sdf(p));")
    # the sines of large angles are worth no more
    assert torch.allclose(found[:, :1], 0.7 * value, atol=1e-3 if activation == "sine" else 1e-5)


@drawn
def test_a_cell_has_its_own_network():
    box = ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])
    networks = [TransferNetwork(box, 5, 1, 4, 1, 0, torch.Generator().manual_seed(k)) for k in range(3)]
    statement = (
        "float t[4]; transfer(int(gl_FragCoord.x) % 3, p, n, t); color = vec4(t[0], t[1], t[2], t[3]);"
    )
    found = values_of(transfers_source(networks), statement).view(SIDE, SIDE, 4)
    with torch.no_grad():
        for cell in range(3):
            expected = networks[cell](*places()).view(SIDE, SIDE, 4)
            assert torch.allclose(found[:, cell::3], expected[:, cell::3], atol=1e-5)


@pytest.mark.parametrize("value", [0.1, 1.0, -3e-30, 1e20, 16777217.0, 1 / 3])
def test_literals_are_exact_floats(value):
    text = literal(value)
    assert np.float32(text) == np.float32(value)
    assert "." in text or "e" in text


def test_blocks_are_padded_to_four():
    source = mlp_source([(random(5, 6), random(5)), (random(3, 5), None)])
    assert "in vec4 x[2], out vec4 y[1]" in source
    assert matrices(source) == 2 * 2 + 2


def test_what_makes_no_shader_is_refused():
    one = (random(4, 3), random(4))
    with pytest.raises(PrtError, match="activation='elu' is not one of relu"):
        mlp_source([one], "elu")
    with pytest.raises(PrtError, match="a slope lies in"):
        mlp_source([one], "leaky_relu", 2.0)
    with pytest.raises(PrtError, match="layer 1 with weights .* does not fit"):
        mlp_source([one, (random(2, 5), None)])
    with pytest.raises(PrtError, match="no layers"):
        mlp_source([])
    with pytest.raises(PrtError, match="not finite"):
        mlp_source([(one[0] / 0, None)])
    with pytest.raises(PrtError, match="is no distance of a place"):
        sdf_source([one], "relu")
    with pytest.raises(PrtError, match="one or more"):
        transfers_source([])


def test_networks_that_do_not_fit_are_refused():
    network = TransferNetwork(([0.0] * 3, [1.0] * 3), 256, 4, 16, 6, 2)
    with pytest.raises(PrtError, match=r"13\d\d\d mat4 constants .* at most 4096 .* renderer=torch"):
        check_fits(transfer_source(network))

"""Networks as GLSL 3.30 source: weights are mat4 constants in the shader (Dhawal 2022, section 4.3.1).

Every product of a layer is written out: a mat4 of literals times a vec4. Loops over constant arrays read
better, but Mesa's compiler either writes them out itself, and takes longer over it, or copies the arrays for
every pixel. Each four neurons stand under an ``if`` that is always true and that the compiler cannot see
through: passes over one long stretch of code take time with the square of its length.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from prt.errors import PrtError
from prt.nn.transfer_network import TransferNetwork

#: of the weights (outputs, inputs), and the biases (outputs) or None
Layer = tuple[Any, Any]
#: what stands between the layers, of a vec4 named ``s``; ``{p}`` is the activation's parameter
ACTIVATIONS = {
    "relu": "max(s, 0.0)",
    "leaky_relu": "max(s, {p} * s)",
    "softplus": "max(s, 0.0) + log(1.0 + exp(-{p} * abs(s))) / {p}",
    "sine": "sin({p} * s)",
}
#: torch's own
PARAMETERS = {"relu": 0.0, "leaky_relu": 0.01, "softplus": 1.0, "sine": 1.0}
#: first part of a shader that uses any of this
ALWAYS = "uniform bool always = true;\n"
#: of all networks in one shader. Compile time grows with the square of the number: see `check_fits`.
MOST_MATRICES = 4096


def matrices(source: str) -> int:
    """Number of mat4 constants in a source of this module."""
    return source.count("mat4(")


def check_fits(source: str, most: int = MOST_MATRICES) -> None:
    """Refuse a shader whose compilation would not end in a time anybody waits for.

    A network of k=64, l=4 and 16 coefficients has about 1100 mat4 constants, k=128 3700, k=256 13500. Mesa's
    software renderer compiles the first in 8 s of CPU time, the second in 83 s; the third would take about
    20 minutes. The limit lies where the paper's does, whose shaders of k=256 and 512 failed (table 4).

    Raises:
        PrtError: for more than ``most`` mat4 constants.
    """
    count = matrices(source)
    if count > most:
        raise PrtError(
            f"the networks have {count} mat4 constants ({len(source) / 1e6:.1f} MB of GLSL), too many for a "
            f"fragment shader: at most {most} (one network of neurons=128, layers=4 is 3700); use smaller or "
            "fewer networks, or renderer=torch"
        )


def mlp_source(
    layers: Sequence[Layer], activation: str = "leaky_relu", parameter: float | None = None, name: str = "mlp"
) -> str:
    """``void name(in vec4 x[I/4], out vec4 y[O/4])``: the layers with the activation in between.

    Inputs and outputs are padded with zeros to a multiple of 4. Needs :data:`ALWAYS` ahead of it.

    Args:
        layers: weights (out, in) and biases (out,) or None, tensors or arrays, from input to output.
        activation: ``relu``, ``leaky_relu`` (parameter: slope below 0, 0 to 1), ``softplus`` (beta) or
            ``sine`` (sin of parameter times the value).
        parameter: of the activation; torch's own default where None (0.01, 1, 1).

    Raises:
        PrtError: for an unknown activation, layers that do not fit each other, or weights that are not
            finite.
    """
    between = _activation(activation, parameter)
    arrays = _checked(layers)
    lines, given = [], "x"
    for number, (weight, bias) in enumerate(arrays):
        last = number == len(arrays) - 1
        blocks, offsets = _blocks(weight), _padded(bias).reshape(-1, 4)
        result = "y" if last else f"h{number}"
        if not last:
            lines.append(f"vec4 {result}[{len(blocks)}];")
        for row, (matrix, offset) in enumerate(zip(blocks, offsets, strict=True)):
            lines.append(f"if (always) {{ vec4 s = vec4({_literals(offset)});")
            lines += [f"s += mat4({_literals(m)}) * {given}[{column}];" for column, m in enumerate(matrix)]
            lines.append(f"{result}[{row}] = {'s' if last else between}; }}")
        given = result
    inputs, outputs = -(-arrays[0][0].shape[1] // 4), -(-arrays[-1][0].shape[0] // 4)
    head = f"void {name}(in vec4 x[{inputs}], out vec4 y[{outputs}]) {{\n"
    return head + "\n".join(lines) + "\n}\n"


def sdf_source(
    layers: Sequence[Layer],
    activation: str,
    parameter: float | None = None,
    scale: float = 1.0,
    octaves: int = 0,
    name: str = "sdf",
) -> str:
    """``float name(vec3 p)``, ``scale`` times the one output of a network of the place.

    Args:
        layers, activation, parameter: as in :func:`mlp_source`; the last has one row. A change of the
            place's coordinates belongs into the first layer's weights.
        octaves: of the encoding of the place (:func:`prt.nn.encodings.frequencies`).

    Raises:
        PrtError: as :func:`mlp_source`; for layers of another number of inputs or outputs.
    """
    inputs, outputs = _checked(layers)[0][0].shape[1], _checked(layers)[-1][0].shape[0]
    if (inputs, outputs) != (3 * (1 + 2 * octaves), 1):
        raise PrtError(
            f"a network of {inputs} inputs and {outputs} outputs is no distance of a place with "
            f"octaves={octaves}: it has {3 * (1 + 2 * octaves)} inputs and 1 output"
        )
    lines, parts = _encoded("p", octaves)
    return (
        f"{mlp_source(layers, activation, parameter, f'{name}_mlp')}float {name}(vec3 p) {{\n{lines}"
        f"{_packed('x', parts)}vec4 y[1];\n{name}_mlp(x, y);\nreturn {literal(scale)} * y[0].x;\n}}\n"
    )


def transfer_source(network: TransferNetwork, name: str = "transfer") -> str:
    """``void name(vec3 position, vec3 normal, out float t[K])``: what ``network.forward`` computes.

    Needs :data:`ALWAYS` ahead of it.

    Raises:
        PrtError: for weights that are not finite.
    """
    layers = [(layer.weight, layer.bias) for layer in network.mlp.layers]
    scale = _array(network.scale)
    place, first = _encoded("place", network.octaves[0])
    turned, second = _encoded("normal", network.octaves[1])
    centre = _literals(_array(network.centre))
    lines = [
        mlp_source(layers, "leaky_relu", network.mlp.slope, f"{name}_mlp"),
        f"void {name}(vec3 position, vec3 normal, out float t[{len(scale)}]) {{\n",
        f"vec3 place = (position - vec3({centre})) / {literal(_array(network.reach))};\n",
        f"{place}{turned}{_packed('x', [*first, *second])}",
        f"vec4 y[{-(-len(scale) // 4)}];\n{name}_mlp(x, y);\n",
        *(f"t[{k}] = {literal(s)} * tanh(y[{k // 4}].{'xyzw'[k % 4]});\n" for k, s in enumerate(scale)),
        "}\n",
    ]
    return "".join(lines)


def transfers_source(networks: Sequence[TransferNetwork], name: str = "transfer") -> str:
    """``void name(int cell, vec3 position, vec3 normal, out float t[K])``: one network for each cell.

    Raises:
        PrtError: as :func:`transfer_source`; for no network, or networks of different numbers of outputs.
    """
    outputs = {len(network.scale) for network in networks}
    if len(outputs) != 1:
        raise PrtError(f"networks of {sorted(outputs)} outputs: one or more, of one number, make a shader")
    parts = [transfer_source(network, f"{name}{cell}") for cell, network in enumerate(networks)]
    parts.append(f"void {name}(int cell, vec3 position, vec3 normal, out float t[{outputs.pop()}]) {{\n")
    if len(networks) == 1:
        return "".join([*parts, f"{name}0(position, normal, t);\n}}\n"])
    cases = (f"case {cell}: {name}{cell}(position, normal, t); break;\n" for cell in range(len(networks)))
    return "".join([*parts, "switch (cell) {\n", *cases, "}\n}\n"])


def literal(value: Any) -> str:
    """The shortest GLSL float literal that is this float32.

    Raises:
        PrtError: if it is not finite.
    """
    number = np.float32(value)
    if not np.isfinite(number):
        raise PrtError(f"a weight of the network is {number}: it is not finite; train it anew")
    return str(number)


def _literals(values: np.ndarray) -> str:
    return ",".join(map(literal, values.reshape(-1)))


def _array(values: Any) -> np.ndarray:
    values = values.detach().cpu().numpy() if isinstance(values, Tensor) else np.asarray(values)
    return values.astype(np.float32)


def _checked(layers: Sequence[Layer]) -> list[tuple[np.ndarray, np.ndarray]]:
    arrays = []
    for weight, bias in layers:
        weight = _array(weight)
        bias = np.zeros(len(weight), np.float32) if bias is None else _array(bias)
        known = arrays[-1][0].shape[0] if arrays else weight.shape[-1]
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or weight.shape[1] != known:
            raise PrtError(
                f"layer {len(arrays)} with weights {weight.shape} and biases {bias.shape} does not fit: "
                f"weights are (out, {known}), biases (out,)"
            )
        arrays.append((weight, bias))
    if not arrays:
        raise PrtError("a network of no layers; give at least one")
    return arrays


def _activation(name: str, parameter: float | None) -> str:
    if name not in ACTIVATIONS:
        raise PrtError(f"activation={name!r} is not one of {', '.join(ACTIVATIONS)}")
    value = PARAMETERS[name] if parameter is None else parameter
    if name == "leaky_relu" and not 0 <= value <= 1 or name == "softplus" and not value > 0:
        raise PrtError(f"activation={name} with {value}: a slope lies in [0, 1], a beta above 0")
    return ACTIVATIONS[name].format(p=literal(value))


def _padded(values: np.ndarray) -> np.ndarray:
    """With zeros at the end of every dimension, up to a multiple of 4."""
    return np.pad(values, [(0, -size % 4) for size in values.shape])


def _blocks(weight: np.ndarray) -> np.ndarray:
    """(rows / 4, columns / 4, 16): the numbers of each mat4, in columns as GLSL has them."""
    full = _padded(weight)
    rows, columns = (size // 4 for size in full.shape)
    return full.reshape(rows, 4, columns, 4).transpose(0, 2, 3, 1).reshape(rows, columns, 16)


def _encoded(vector: str, octaves: int) -> tuple[str, list[str]]:
    """Lines for :func:`prt.nn.encodings.frequencies` of a vec3, and the names of its values in order."""
    lines, names = "", [vector]
    for octave in range(octaves):
        angle = f"{literal(2**octave * np.pi)} * {vector}"
        lines += "".join(f"vec3 {vector}_{f}{octave} = {f}({angle});\n" for f in ("sin", "cos"))
        names += [f"{vector}_sin{octave}", f"{vector}_cos{octave}"]
    return lines, [f"{name}.{axis}" for name in names for axis in "xyz"]


def _packed(name: str, parts: list[str]) -> str:
    """Floats as an array of vec4."""
    parts = [*parts, *["0.0"] * (-len(parts) % 4)]
    lines = [f"vec4 {name}[{len(parts) // 4}];\n"]
    for k in range(0, len(parts), 4):
        lines.append(f"{name}[{k // 4}] = vec4({', '.join(parts[k : k + 4])});\n")
    return "".join(lines)

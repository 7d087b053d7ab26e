"""The network of Active Exploration: a pixel's surface and the scene's state to a colour (Diolatzis 2022)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.nn.encodings import frequencies, log_roughness
from prt.scene.gbuffer import GBuffer

#: of the leaky ReLU (PyTorch's own default, which the authors use)
SLOPE = 0.01
#: of log(1 + radiance / scale): a network that goes astray gives a large number instead of infinity
LARGEST = 30.0


class PixelGenerator(torch.nn.Module):
    """A fully connected network that sees one pixel of the G-buffer at a time, and the scene vector.

    Its input (position code, normal, direction to the viewer, diffuse and specular colour, roughness, scene
    vector) is concatenated to the input of every further layer too, the last included, as in the authors'
    code. There the position goes through a layer of its own; here it is encoded by
    :func:`prt.nn.encodings.frequencies`. Like there, what the network gives is log(1 + radiance), linear
    and of either sign: train on :meth:`log_radiance` against :meth:`compressed` radiance. What a surface
    emits is no part of it, and is to be added.

    The scene vector is usually one for all pixels, and then costs nothing per pixel: it is a bias.

    Args:
        bounds: corners of the box that positions lie in, world units.
        variables: n values of the scene vector, each from 0 to 1.
        width, hidden_layers: of the layers with leaky ReLU; the authors have 700, and 8 behind the first.
        position_frequencies: octaves of the position's encoding; 0 gives the position alone.
        scale: the radiance that counts as 1 in log(1 + radiance).
        generator: of the initial weights.

    Raises:
        PrtError: for a setting out of range.
    """

    def __init__(
        self,
        bounds: tuple[Sequence[float], Sequence[float]],
        variables: int,
        width: int,
        hidden_layers: int,
        position_frequencies: int,
        scale: float = 1.0,
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        for name, value, least in (
            ("variables", variables, 0), ("width", width, 1), ("hidden_layers", hidden_layers, 1),
            ("position_frequencies", position_frequencies, 0),
        ):  # fmt: skip
            if not isinstance(value, int) or value < least:
                raise PrtError(f"pixel generator {name}={value!r} must be an integer of at least {least}")
        if not scale > 0:
            raise PrtError(f"pixel generator scale={scale!r} must be above 0")
        low, high = (torch.tensor([float(c) for c in corner]) for corner in bounds)
        self.register_buffer("centre", (low + high) / 2, persistent=False)
        self.register_buffer("reach", ((high - low).amax() / 2).clamp_min(1e-12), persistent=False)
        self.register_buffer("scale", torch.tensor(float(scale)))
        self.variables, self.width, self.octaves = variables, width, position_frequencies
        self.surface = 3 * (1 + 2 * position_frequencies) + 3 + 3 + 3 + 3 + 1
        sizes = [(self.surface + variables, width)]
        sizes += [(width + self.surface + variables, width)] * (hidden_layers - 1)
        sizes += [(width + self.surface + variables, 3)]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(*size) for size in sizes)
        for layer, (_, outputs) in zip(self.layers, sizes, strict=True):
            kind = "leaky_relu" if outputs == width else "linear"
            torch.nn.init.kaiming_normal_(layer.weight, SLOPE, nonlinearity=kind, generator=generator)
            torch.nn.init.zeros_(layer.bias)

    def features(self, gbuffer: GBuffer) -> Float[Tensor, "N I"]:
        """What the network sees of the surface, without the scene vector."""
        place = ((gbuffer.position - self.centre) / self.reach).clamp(-1, 1)
        parts = [frequencies(place, self.octaves), gbuffer.normal, gbuffer.wo, gbuffer.diffuse]
        return torch.cat([*parts, gbuffer.specular, log_roughness(gbuffer.roughness)], dim=1)

    def log_radiance(
        self, gbuffer: GBuffer, v: Float[Tensor, "n"] | Float[Tensor, "N n"]
    ) -> Float[Tensor, "N 3"]:
        """What the network gives: log(1 + radiance / scale), which training compares."""
        seen, state = self.features(gbuffer), 2 * v.clamp(0, 1) - 1
        if state.dim() == 2:
            seen = torch.cat([seen, state], dim=1)
        x = seen
        for layer in self.layers:
            weight, bias = layer.weight, layer.bias
            if state.dim() == 1 and self.variables:
                bias = bias + weight[:, -self.variables :] @ state
                weight = weight[:, : -self.variables]
            y = torch.nn.functional.linear(x, weight, bias)
            if layer is self.layers[-1]:
                return y
            x = torch.cat([torch.nn.functional.leaky_relu(y, SLOPE, inplace=True), seen], dim=1)
        raise AssertionError("there is always a last layer")

    def compressed(self, radiance: Float[Tensor, "*N 3"]) -> Float[Tensor, "*N 3"]:
        """log(1 + radiance / scale) of what is to be learnt."""
        return torch.log1p(radiance.clamp_min(0) / self.scale)

    def forward(self, gbuffer: GBuffer, v: Float[Tensor, "n"] | Float[Tensor, "N n"]) -> Float[Tensor, "N 3"]:
        """Radiance towards the viewer, not negative, of pixels in one state (n,) or one each (N, n)."""
        return torch.expm1(self.log_radiance(gbuffer, v).clamp(0, LARGEST)) * self.scale

    def nbytes(self) -> int:
        """Bytes of all weights and biases as they are stored."""
        return sum(p.numel() * p.element_size() for p in self.parameters())

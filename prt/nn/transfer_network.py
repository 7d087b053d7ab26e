"""The network of learnt transfer: position and normal to SH coefficients (Dhawal 2022, section 4.1)."""

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.nn.encodings import frequencies
from prt.nn.mlp import Mlp

#: of the leaky ReLU (Maas 2013; PyTorch's own default)
SLOPE = 0.01


class TransferNetwork(torch.nn.Module):
    """l layers of k neurons with leaky ReLU, then ``scale * tanh`` (figure 3).

    The position, moved and scaled so that the longest side of the box becomes [-1, 1], and the normal are
    encoded by :func:`prt.nn.encodings.frequencies`; the network's input is position code, then normal code.

    Args:
        bounds: corners of the box that positions lie in, world units.
        neurons, layers: k and l.
        outputs: K coefficients.
        position_frequencies, normal_frequencies: octaves of the encodings; 0 gives the value alone.
        generator: of the initial weights.

    Attributes:
        scale: (K,) what the tanh is multiplied with, so that no coefficient of the training data lies near
            its limits; 1 until training sets it.
    """

    def __init__(
        self,
        bounds: tuple[list[float], list[float]],
        neurons: int,
        layers: int,
        outputs: int,
        position_frequencies: int,
        normal_frequencies: int,
        generator: torch.Generator | None = None,
    ):
        super().__init__()
        if layers < 1:
            raise PrtError(f"network layers={layers} must be at least 1")
        low, high = torch.tensor(bounds[0]).float(), torch.tensor(bounds[1]).float()
        self.register_buffer("centre", (low + high) / 2)
        self.register_buffer("reach", ((high - low).amax() / 2).clamp_min(1e-12))
        self.register_buffer("scale", torch.ones(outputs))
        self.octaves = (position_frequencies, normal_frequencies)
        inputs = sum(3 * (1 + 2 * count) for count in self.octaves)
        self.mlp = Mlp(inputs, neurons, layers, outputs, generator=generator, slope=SLOPE)

    def encode(self, position: Float[Tensor, "N 3"], normal: Float[Tensor, "N 3"]) -> Float[Tensor, "N I"]:
        """The input of the first layer."""
        place = (position - self.centre) / self.reach
        return torch.cat([frequencies(place, self.octaves[0]), frequencies(normal, self.octaves[1])], dim=1)

    def forward(self, position: Float[Tensor, "N 3"], normal: Float[Tensor, "N 3"]) -> Float[Tensor, "N K"]:
        """SH coefficients of the transfer at surface points, world space, unit normals."""
        return self.scale * torch.tanh(self.mlp(self.encode(position, normal)))

    def nbytes(self) -> int:
        """Bytes of weights and biases, and of the box and the scale."""
        return self.mlp.nbytes() + 4 * (4 + len(self.scale))

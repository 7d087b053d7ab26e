"""A plain multilayer perceptron whose layers can be taken apart (folded renderers do)."""

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError


class Mlp(torch.nn.Module):
    """``hidden_layers`` hidden layers of ``width`` neurons with (leaky) ReLU, then a linear output.

    Kaiming initialisation, biases zero; the output layer is initialised for a linear activation, so that a
    fresh network's outputs have about the variance of its last hidden layer's.

    Args:
        slope: of the activation below zero; 0 is ReLU.

    Attributes:
        layers: the linear layers from input to output; ``forward`` is them with the activation in between.
    """

    def __init__(
        self,
        inputs: int,
        width: int,
        hidden_layers: int,
        outputs: int,
        bias: bool = True,
        generator: torch.Generator | None = None,
        slope: float = 0.0,
    ):
        super().__init__()
        self.slope = slope
        given = {"inputs": inputs, "width": width, "hidden_layers": hidden_layers, "outputs": outputs}
        for name, value in given.items():
            least = 0 if name == "hidden_layers" else 1
            if not isinstance(value, int) or value < least:
                raise PrtError(f"network {name}={value!r} must be an integer of at least {least}")
        sizes = [inputs, *[width] * hidden_layers, outputs]
        self.layers = torch.nn.ModuleList(
            torch.nn.Linear(a, b, bias=bias) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )
        for number, layer in enumerate(self.layers):
            kind = "linear" if number == hidden_layers else "leaky_relu"
            torch.nn.init.kaiming_normal_(layer.weight, slope, nonlinearity=kind, generator=generator)
            if bias:
                torch.nn.init.zeros_(layer.bias)

    def forward(self, x: Float[Tensor, "*N I"]) -> Float[Tensor, "*N O"]:
        for layer in self.layers[:-1]:
            x = layer(x)
            x = torch.nn.functional.leaky_relu(x, self.slope, inplace=True) if self.slope else torch.relu(x)
        return self.layers[-1](x)

    def nbytes(self) -> int:
        """Bytes of all weights and biases as they are stored."""
        return sum(p.numel() * p.element_size() for p in self.parameters())

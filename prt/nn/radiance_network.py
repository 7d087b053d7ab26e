"""Reflected radiance of a point in a direction and a state (Su 2024, figure 3)."""

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh import sh_basis
from prt.nn.encodings import one_blob
from prt.nn.mlp import Mlp


@dataclasses.dataclass
class RadiancePoints:
    """Where radiance is asked for: N points of surfaces and the directions they are seen from.

    Attributes:
        position: world units.
        normal: shading normal on the side of ``wo``, unit.
        wo: the direction light leaves to, unit.
        albedo: diffuse reflectance, or of a metal what its lobe reflects.
        weight: what the radiance counts for on the path that ends here.
        path: number of that path.
    """

    position: Float[Tensor, "N 3"]
    normal: Float[Tensor, "N 3"]
    wo: Float[Tensor, "N 3"]
    albedo: Float[Tensor, "N 3"]
    weight: Float[Tensor, "N 3"]
    path: Int[Tensor, "N"]

    def __len__(self) -> int:
        return len(self.position)

    @property
    def reflected(self) -> Float[Tensor, "N 3"]:
        """``wo`` mirrored about the normal."""
        return 2 * (self.normal * self.wo).sum(1, keepdim=True) * self.normal - self.wo

    def rows(self, index: Tensor | slice) -> "RadiancePoints":
        """Some of them."""
        return RadiancePoints(*(getattr(self, f.name)[index] for f in dataclasses.fields(self)))

    def to(self, device: str | torch.device) -> "RadiancePoints":
        return RadiancePoints(*(getattr(self, f.name).to(device) for f in dataclasses.fields(self)))

    @classmethod
    def concatenate(cls, parts: list["RadiancePoints"]) -> "RadiancePoints":
        return cls(*(torch.cat([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(cls)))


@dataclasses.dataclass
class StateCode:
    """All that depends on the state alone: one entry for each encoding, and the first layer's share."""

    parts: list
    bias: Float[Tensor, "W"]


class RadianceNetwork(torch.nn.Module):
    """Features of the place and the state, of direction, normal and albedo, decoded to RGB radiance.

    The output goes through :func:`positive`: reflected light is not negative, and it may be large.

    Args:
        encodings: modules from positions to features: with ``at(v)`` and ``forward(position, code)``, or
            without ``at`` where they know nothing of the state.
        state: a module from v to values that are the same for all points, or None.
        direction_degree, normal_degree: largest SH band of the reflected direction and of the normal.
        albedo_bins: of the one-blob encoding of each channel of the albedo.
        width, hidden_layers: of the decoder; the paper has 256 and 4.
        scale: the radiance that the output's unit stands for.
        seen: numbers of the variables that the network is told; all by default.
        demodulate: whether the decoder gives two colours, one that the albedo multiplies and one as it is.
            The paper has one, and the albedo as an input alone: textures and walls that change colour then
            have to be learnt.
    """

    def __init__(
        self,
        encodings: list[torch.nn.Module],
        state: torch.nn.Module | None,
        direction_degree: int,
        normal_degree: int,
        albedo_bins: int,
        width: int,
        hidden_layers: int,
        scale: float = 1.0,
        demodulate: bool = True,
        generator: torch.Generator | None = None,
        seen: list[int] | None = None,
    ):
        super().__init__()
        self.demodulate, self.seen = bool(demodulate), seen
        if hidden_layers < 1:
            raise PrtError(f"method.hidden_layers={hidden_layers} must be at least 1")
        self.encodings, self.state = torch.nn.ModuleList(encodings), state
        self.degrees, self.albedo_bins = (direction_degree, normal_degree), albedo_bins
        self.register_buffer("scale", torch.tensor(float(scale)))
        self.inputs = sum(int(e.outputs) for e in encodings)  # pyright: ignore
        self.inputs += sum((degree + 1) ** 2 for degree in self.degrees) + 3 * albedo_bins
        self.shared = int(state.outputs) if state is not None else 0  # pyright: ignore
        outputs = 6 if self.demodulate else 3
        self.decoder = Mlp(self.inputs + self.shared, width, hidden_layers, outputs, generator=generator)

    def at(self, v: Float[Tensor, "n"]) -> StateCode:
        """Once per state; differentiable."""
        return StateCode(self.lines(v), self.bias(v))

    def told(self, v: Float[Tensor, "n"]) -> Float[Tensor, "m"]:
        """The values of the variables that are seen."""
        return v if self.seen is None else v[self.seen]

    def lines(self, v: Float[Tensor, "n"]) -> list:
        """What the encodings need of a state; None for one that knows nothing of it."""
        v = self.told(v)
        return [e.at(v) if hasattr(e, "at") else None for e in self.encodings]  # pyright: ignore

    def bias(self, v: Float[Tensor, "n"]) -> Float[Tensor, "W"]:
        """The state's own values enter the first layer as a bias."""
        first = self.decoder.layers[0]
        if self.state is None:
            return first.bias  # pyright: ignore
        return first.bias + first.weight[:, self.inputs :] @ self.state(self.told(v))

    def places(self, position: Float[Tensor, "N 3"], lines: list) -> list[Tensor]:
        """Features of positions, one entry an encoding."""
        return [
            encoding(position) if part is None else encoding(position, part)
            for encoding, part in zip(self.encodings, lines, strict=True)
        ]

    def features(self, points: RadiancePoints, code: StateCode) -> Float[Tensor, "N I"]:
        """What the decoder sees of each point."""
        parts = self.places(points.position, code.parts)
        parts += [sh_basis(points.reflected, self.degrees[0]), sh_basis(points.normal, self.degrees[1])]
        if self.albedo_bins:
            parts.append(one_blob(points.albedo, self.albedo_bins))
        return torch.cat(parts, dim=1)

    def decode(
        self, features: Float[Tensor, "N I"], code: StateCode, albedo: Float[Tensor, "N 3"]
    ) -> Float[Tensor, "N 3"]:
        """Radiance from the features of points."""
        first, *middle, last = self.decoder.layers
        x = torch.relu(torch.nn.functional.linear(features, first.weight[:, : self.inputs], code.bias))
        for layer in middle:
            x = torch.relu(layer(x))
        out = positive(last(x)) * self.scale
        return torch.addcmul(out[:, 3:], albedo, out[:, :3]) if self.demodulate else out

    def forward(self, points: RadiancePoints, code: StateCode) -> Float[Tensor, "N 3"]:
        """Radiance that the points reflect towards ``wo``, without what they emit and mirror."""
        return self.decode(self.features(points, code), code, points.albedo)

    def nbytes(self) -> int:
        """All weights."""
        return sum(p.numel() * p.element_size() for p in self.parameters())


def positive(x: Float[Tensor, "*N"]) -> Float[Tensor, "*N"]:
    """1 + x above 0 and 1 / (1 - x) below: positive, smooth, and never flat.

    Softplus and the exponential die out below: in a room that is mostly dark the first steps drive them to
    where no gradient is left, and the network stays black.
    """
    return torch.where(x > 0, 1 + x, 1 / (1 - x.clamp(max=0)))

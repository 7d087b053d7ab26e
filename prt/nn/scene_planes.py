"""The part of dynamic neural radiosity that knows the state: planes of one coordinate and one variable, and a
small network of the variables alone (Su 2024, section 4.2, equations 6 and 7)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.nn.cells import cells
from prt.nn.mlp import Mlp

INITIAL = 1e-4
#: numbers of a state as :meth:`ScenePlanes.at` gives it: a (3, cells + 1, n F) tensor a level
Lines = list[Tensor]


class ScenePlanes(torch.nn.Module):
    """f_XV: 3n feature planes over (x, v_i), (y, v_i), (z, v_i), at several resolutions, concatenated.

    A frame has one state, and so has a step of training. At a state each plane is a line along its
    coordinate, which :meth:`at` makes once; a point then reads lines only. A number of variables more costs
    wider rows of the same lines: time and memory are linear in n.

    Args:
        variables: n, at least 1.
        levels, features: of each plane; the paper has 4 and 2.
        base_resolution, scale: cells of the coarsest level along both axes and growth per level. The paper
            gives neither; with 32 and 2 a variable takes the 2 MB of its table 1.
        bounds: corners of the box, world units; points outside are clamped to it, and states to [0, 1].
        variable_resolution: cells along the variable at all levels; None for as many as along the coordinate.

    Raises:
        PrtError: for a setting out of range.
    """

    def __init__(
        self,
        variables: int,
        levels: int,
        features: int,
        base_resolution: int,
        scale: float,
        bounds: tuple[Sequence[float], Sequence[float]],
        generator: torch.Generator | None = None,
        variable_resolution: int | None = None,
    ):
        super().__init__()
        for name, value in (
            ("variables", variables), ("levels", levels), ("features", features),
            ("base_resolution", base_resolution), ("variable_resolution", variable_resolution or 1),
        ):  # fmt: skip
            if not isinstance(value, int) or value < 1:
                raise PrtError(f"feature planes {name}={value!r} must be an integer of at least 1")
        if not 1 <= scale <= 8:
            raise PrtError(f"feature planes scale={scale!r} must be from 1 to 8")
        self.variables, self.levels, self.features = variables, levels, features
        low, high = (torch.tensor([float(c) for c in corner]) for corner in bounds)
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("extent", (high - low).clamp_min(1e-12), persistent=False)
        self.resolutions = [int(base_resolution * scale**level + 1e-9) for level in range(levels)]
        self.along = [variable_resolution or r for r in self.resolutions]
        # variable, coordinate, place along the variable, place along the coordinate, feature
        self.planes = torch.nn.ParameterList(
            torch.empty((variables, 3, s + 1, r + 1, features)).uniform_(
                -INITIAL, INITIAL, generator=generator
            )
            for r, s in zip(self.resolutions, self.along, strict=True)
        )

    @property
    def outputs(self) -> int:
        """C = 3 n levels features."""
        return 3 * self.variables * self.levels * self.features

    def nbytes(self) -> int:
        """Bytes of all planes as they are stored."""
        return sum(plane.numel() * plane.element_size() for plane in self.planes)

    def at(self, v: Float[Tensor, "n"]) -> Lines:
        """The lines of a state, differentiable in the planes."""
        lines = []
        number = torch.arange(self.variables, device=v.device)
        for plane, r, s in zip(self.planes, self.resolutions, self.along, strict=True):
            row, part = cells(v, s)
            part = part[:, None, None, None]
            line = torch.lerp(plane[number, :, row], plane[number, :, row + 1], part)  # n, 3, r + 1, F
            lines.append(line.permute(1, 2, 0, 3).reshape(3, r + 1, -1))
        return lines

    def forward(self, position: Float[Tensor, "N 3"], lines: Lines) -> Float[Tensor, "N C"]:
        """Features at world positions in the state that the lines were made for."""
        unit = (position - self.low) / self.extent
        parts = []
        for line, r in zip(lines, self.resolutions, strict=True):
            cell, part = cells(unit, r)
            for axis in range(3):
                near, far = (
                    line[axis].index_select(0, cell[:, axis]),
                    line[axis].index_select(0, cell[:, axis] + 1),
                )
                parts.append(torch.lerp(near, far, part[:, axis, None]))
        return torch.cat(parts, dim=1)

    def forward_readable(self, position: Float[Tensor, "N 3"], v: Float[Tensor, "n"]) -> Float[Tensor, "N C"]:
        """The same as ``forward(position, at(v))``: a bilinear lookup in every plane, point by point."""
        unit = ((position - self.low) / self.extent).clamp(0, 1)
        parts = []
        for plane, r, s in zip(self.planes, self.resolutions, self.along, strict=True):
            for axis in range(3):
                for i in range(self.variables):
                    u, t = v[i].clamp(0, 1) * s, unit[:, axis] * r
                    a, b = u.long().clamp(max=s - 1), t.long().clamp(max=r - 1)
                    p, q = u - a, (t - b)[:, None]
                    table = plane[i, axis]
                    low = (1 - q) * table[a, b] + q * table[a, b + 1]
                    high = (1 - q) * table[a + 1, b] + q * table[a + 1, b + 1]
                    parts.append((1 - p) * low + p * high)
        return torch.cat(parts, dim=1)


class StateNetwork(torch.nn.Module):
    """f_V: a small network of the frequency-encoded state (equation 7), once per state and not per point.

    Args:
        variables: n, at least 1.
        width, hidden_layers: the paper has 128 and 4; the output is ``width`` values.
        octaves: L; cos(2^j v_i) and sin(2^j v_i) for j from 0 to L. The paper has 8.
    """

    def __init__(
        self, variables: int, width: int, hidden_layers: int, octaves: int,
        generator: torch.Generator | None = None,
    ):  # fmt: skip
        super().__init__()
        if not isinstance(octaves, int) or octaves < 0:
            raise PrtError(f"state network octaves={octaves!r} must be an integer of at least 0")
        self.outputs, self.octaves = width, octaves
        self.mlp = Mlp(2 * (octaves + 1) * variables, width, hidden_layers, width, generator=generator)

    def forward(self, v: Float[Tensor, "n"]) -> Float[Tensor, "S"]:
        angle = v[:, None] * 2.0 ** torch.arange(self.octaves + 1, device=v.device)
        return torch.relu(self.mlp(torch.cat([angle.cos(), angle.sin()], dim=1).reshape(1, -1)))[0]


class PlainState(torch.nn.Module):
    """The state itself, appended to what is known of a point: the way of networks conditioned on it."""

    def __init__(self, variables: int):
        super().__init__()
        self.outputs = variables

    def forward(self, v: Float[Tensor, "n"]) -> Float[Tensor, "S"]:
        return 2 * v - 1

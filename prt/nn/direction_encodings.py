"""How the network of Raghavan 2023 sees the reflected direction, the normal and the roughness (tables 4, 5).

Every encoding is a module with ``outputs``, the numbers it gives the network for a pixel, and ``forward``. A
learnt one may also have a ``factor``: numbers that the spatial features S_m are multiplied by (the paper's
DCFE, "a total factorization of the transport tensor").
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from prt.errors import PrtError
from prt.light.cubemap import direction_to_face
from prt.light.sh import sh_basis
from prt.nn.cells import cells
from prt.nn.encodings import log_roughness, one_blob

KINDS = ("sh", "none", "one_blob", "one_blob_all", "cubemap", "cubemap_factor")


class DirectionEncoding(nn.Module):
    """Fixed encodings: of the kind ``sh``, ``none``, ``one_blob`` or ``one_blob_all``.

    ``sh``: the real spherical harmonics of wr to a degree, the paper's choice. ``none``: wr as it is, and
    roughness too. ``one_blob``: of wr alone; ``one_blob_all``: of wr, normal and roughness (Mueller 2019).

    Args:
        degree: largest band of ``sh``.
        bins: of ``one_blob``, for each number.
    """

    def __init__(self, kind: str, degree: int, bins: int):
        super().__init__()
        self.kind, self.degree, self.bins = kind, degree, bins
        directions = {"sh": (degree + 1) ** 2, "none": 3, "one_blob": 3 * bins, "one_blob_all": 3 * bins}
        self.outputs = directions[kind] + (4 * bins if kind == "one_blob_all" else 4)

    def forward(
        self, wr: Float[Tensor, "N 3"], normal: Float[Tensor, "N 3"], roughness: Float[Tensor, "N 1"]
    ) -> Float[Tensor, "N F"]:
        if self.kind == "sh":
            return torch.cat([sh_basis(wr, self.degree), normal, log_roughness(roughness)], dim=1)
        if self.kind == "none":
            return torch.cat([wr, normal, roughness], dim=1)
        blobs = one_blob(0.5 * (wr + 1), self.bins)
        if self.kind == "one_blob":
            return torch.cat([blobs, normal, log_roughness(roughness)], dim=1)
        rest = [one_blob(0.5 * (normal + 1), self.bins), one_blob(roughness, self.bins)]
        return torch.cat([blobs, *rest], dim=1)

    def factor(self, wr: Float[Tensor, "N 3"]) -> None:
        return None


class CubemapEncoding(nn.Module):
    """Learnt features over the faces of a cubemap, read at wr: the paper's DCE, or with ``terms`` its DCFE.

    Each face has grids of its own at several resolutions, read bilinearly; nothing joins faces at their
    edges, as in the paper. Grids of this size need no hashing: 6 faces of 64 x 64 cells are 25,000 rows.

    Args:
        levels, features, base_resolution, scale: of the grids; cells a side of level l are
            ``base_resolution * scale**l``. The paper tells "high" and "low frequency" apart, with no numbers.
        terms: None: features are an input of the network. M: they become M factors of S_m, and the network
            gets no reflected direction besides.
    """

    def __init__(
        self, levels: int, features: int, base_resolution: int, scale: float, terms: int | None = None
    ):
        super().__init__()
        for name, value in (("levels", levels), ("features", features), ("base_resolution", base_resolution)):
            if not isinstance(value, int) or value < 1:
                raise PrtError(f"method.directions.{name}={value!r} must be an integer of at least 1")
        if not 1 <= scale <= 8:
            raise PrtError(f"method.directions.scale={scale!r} must be from 1 to 8")
        self.resolutions = [int(base_resolution * scale**level + 1e-9) for level in range(levels)]
        self.grids = nn.ParameterList(
            torch.empty((6 * (r + 1) ** 2, features)).uniform_(-1e-4, 1e-4) for r in self.resolutions
        )
        self.widen = nn.Linear(levels * features, terms) if terms else None
        if self.widen is not None:
            nn.init.ones_(self.widen.bias)  # at first every direction is the same
        self.outputs = 4 + (0 if terms else levels * features)

    def forward(
        self, wr: Float[Tensor, "N 3"], normal: Float[Tensor, "N 3"], roughness: Float[Tensor, "N 1"]
    ) -> Float[Tensor, "N F"]:
        learnt = [] if self.widen is not None else [self.looked_up(wr)]
        return torch.cat([*learnt, normal, log_roughness(roughness)], dim=1)

    def factor(self, wr: Float[Tensor, "N 3"]) -> Float[Tensor, "N M"] | None:
        return None if self.widen is None else self.widen(self.looked_up(wr))

    def looked_up(self, wr: Float[Tensor, "N 3"]) -> Float[Tensor, "N LF"]:
        """Features of the directions, coarse to fine."""
        face, u, v = direction_to_face(wr)
        parts = []
        for grid, r in zip(self.grids, self.resolutions, strict=True):
            (column, x), (row, y) = cells(0.5 * (u + 1), r), cells(0.5 * (v + 1), r)
            first = (face * (r + 1) + row) * (r + 1) + column
            top = torch.lerp(grid[first], grid[first + 1], x[:, None])
            bottom = torch.lerp(grid[first + r + 1], grid[first + r + 2], x[:, None])
            parts.append(torch.lerp(top, bottom, y[:, None]))
        return torch.cat(parts, dim=1)


def direction_encoding(settings: dict[str, Any], terms: int) -> DirectionEncoding | CubemapEncoding:
    """The encoding of ``conf/method/wavelet_neural.yaml``'s ``directions``.

    Raises:
        PrtError: for an unknown kind or a setting out of range.
    """
    kind = settings["kind"]
    if kind not in KINDS:
        raise PrtError(f"method.directions.kind={kind!r} is not one of {', '.join(KINDS)}")
    if kind.startswith("cubemap"):
        sizes = {name: settings[name] for name in ("levels", "features", "base_resolution", "scale")}
        return CubemapEncoding(**sizes, terms=terms if kind == "cubemap_factor" else None)
    for name in ("degree", "bins"):
        if not isinstance(settings[name], int) or settings[name] < (name == "bins"):
            raise PrtError(f"method.directions.{name}={settings[name]!r} must be a whole number")
    return DirectionEncoding(kind, settings["degree"], settings["bins"])

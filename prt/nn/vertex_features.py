"""Feature vectors at the vertices of a mesh: what Raghavan 2023 compares its hash grid with (section 6.4)."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.nn.hashgrid import INITIAL, Corners, weighted_rows

#: from a G-buffer to the vertices of the triangles its points lie on, and their barycentric weights
Find = Callable[[Any], tuple[Int[Tensor, "N 3"], Float[Tensor, "N 3"]]]


class VertexFeatures(torch.nn.Module):
    """Features interpolated over triangles, then softplus; in place of :class:`prt.nn.hashgrid.HashGrid`.

    The nonlinearity is there "to increase the representative capacity of the model"; it comes after the
    interpolation, for before it it would only restrict what a vertex can hold.

    Args:
        vertices: rows of the table.
        features: M.
        find: says where points lie on the mesh.

    Raises:
        PrtError: for a mesh without vertices.
    """

    #: three corners a point are little to keep anywhere, and rays must be traced to find them
    keeps_places = True

    def __init__(self, vertices: int, features: int, find: Find, generator: torch.Generator | None = None):
        super().__init__()
        if vertices < 1:
            raise PrtError("features on vertices need a mesh that has some; check the scene")
        table = torch.empty((vertices, features)).uniform_(-INITIAL, INITIAL, generator=generator)
        self.table, self.find = torch.nn.Parameter(table), find

    @property
    def out_features(self) -> int:
        return self.table.shape[1]

    def nbytes(self) -> int:
        """Bytes of the table as it is stored."""
        return self.table.numel() * self.table.element_size()

    def forward(self, gbuffer) -> Float[Tensor, "N M"]:
        """Features of the points of a G-buffer."""
        return self.lookup(self.locate(gbuffer))

    def locate(self, gbuffer) -> Corners:
        """The three vertices around each point and their weights."""
        rows, weights = self.find(gbuffer)
        return Corners(rows[:, None], weights[:, None]).to(self.table.device)

    def lookup(self, corners: Corners) -> Float[Tensor, "N M"]:
        """Features from places found before (any rows of them); differentiable in the table."""
        return torch.nn.functional.softplus(weighted_rows(self.table, corners))

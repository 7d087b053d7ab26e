"""Visibility on a grid in space, interpolated where the surface is: irradiance volume (Greger et al. 1998).

What a grid of transfer can do without knowing the surface: a node stores the visibility of the whole sphere
in harmonics; at a point it is interpolated between eight nodes and multiplied by the cosine about the normal
(equation 2 with the cosine in place of the light). Nodes inside of solids, which see nothing, take the values
of the nearest one that sees something; nodes on the other side of a thin wall count all the same: it leaks,
as section 2 of Dhawal 2022 says.
"""

import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.sh import sh_basis
from prt.light.sh_products import band_of, triple_products
from prt.methods.base import FitLog
from prt.methods.sh_relight import ShRelight
from prt.scene.gbuffer import GBuffer
from prt.trace.transfer import bake_visibility


class IrradianceVolume(ShRelight):
    """The method; settings as in ``conf/method/irradiance_volume.yaml``.

    Args:
        nodes: along the longest side of the scene's box; the other sides have as many as give cubes.
        directions: rays a node.
    """

    def __init__(self, nodes: int, directions: int):
        if not isinstance(nodes, int) or not 2 <= nodes <= 1024:
            raise PrtError(
                f"method.nodes={nodes!r} must be an integer from 2 to 1024 (grid nodes along a side)"
            )
        self.nodes, self.directions = nodes, directions
        self._grid: Float[Tensor, "1 K Z Y X"] | None = None
        self._low = self._high = torch.zeros(3)

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Cast the rays of all nodes."""
        self.prepare(task, device)
        low, high = (torch.tensor(corner) for corner in task.surface.bounds)
        step = float((high - low).amax()) / (self.nodes - 1)
        many = [max(2, math.ceil(float(side) / step - 1e-6) + 1) for side in high - low]
        kept = log.resume()
        log.start(1, "irradiance_volume")
        if kept is None:
            axes = [torch.linspace(float(a), float(b), n) for a, b, n in zip(low, high, many, strict=True)]
            z, y, x = torch.meshgrid(*reversed(axes), indexing="ij")
            position = torch.stack([x, y, z], -1).reshape(-1, 3)
            values = bake_visibility(task.surface, position, task.order, self.directions, seed, "grid nodes")
            log.step(1, nodes=float(len(values)))
            grid = outside(values.T.reshape(-1, many[2], many[1], many[0]))[None].contiguous()
            log.save(1, {"grid": grid})
        else:
            grid = kept[1]["grid"]
        self._take(grid, low, high)

    def _take(self, grid: Tensor, low: Tensor, high: Tensor) -> None:
        self._grid = grid.to(self.device)
        self._low, self._high = low.to(self.device), high.to(self.device)

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """Interpolated visibility times the cosine about the normal, over pi, cut to the same bands.

        Raises:
            PrtError: before ``fit`` or ``load``.
        """
        if self._grid is None:
            raise PrtError("irradiance_volume has no transfer yet; fit it or load a checkpoint first")
        place = 2 * (gbuffer.position - self._low) / (self._high - self._low).clamp_min(1e-12) - 1
        places = place.view(1, 1, 1, -1, 3)
        found = torch.nn.functional.grid_sample(self._grid, places, align_corners=True, padding_mode="border")
        return times_cosine(found.view(found.shape[1], -1).T, gbuffer.normal)

    def nbytes(self) -> int:
        """The grid, float32."""
        return 0 if self._grid is None else 4 * self._grid.numel()

    def save(self, path: Path) -> None:
        if self._grid is None:
            raise PrtError("irradiance_volume has no transfer to save; fit it first")
        self.save_tensors(path, {"grid": self._grid, "low": self._low, "high": self._high})

    def load(self, path: Path, task: Any, device: str) -> None:
        state = self.load_tensors(path, task, device)
        self._take(state["grid"], state["low"], state["high"])


def outside(grid: Float[Tensor, "K Z Y X"]) -> Float[Tensor, "K Z Y X"]:
    """The grid, nodes that see less than a hundredth of the sphere filled from the nearest other one."""
    from scipy.ndimage import distance_transform_edt

    blind = grid[0] < 0.01 * math.sqrt(4 * math.pi)
    if not bool(blind.any()) or bool(blind.all()):
        return grid
    where: Any = distance_transform_edt(blind.numpy(), return_distances=False, return_indices=True)
    z, y, x = (torch.from_numpy(part).long() for part in where)
    return grid[:, z, y, x]


def times_cosine(visibility: Float[Tensor, "N K"], normal: Float[Tensor, "N 3"]) -> Float[Tensor, "N K"]:
    """Coefficients of ``V max(0, n.d) / pi`` from those of V.

    The bands of the clamped cosine are those of Ramamoorthi and Hanrahan 2001, equation 8, over pi.
    """
    K = visibility.shape[1]
    order = math.isqrt(K)
    cosine = cosine_bands(order).to(visibility)[band_of(order).to(visibility.device)] * sh_basis(
        normal, order - 1
    )
    (i, j, k), tau = (part.to(visibility.device) for part in triple_products(order))
    terms = visibility[:, i] * cosine[:, j] * tau.to(visibility)
    return torch.zeros_like(visibility).index_add_(1, k, terms)


def cosine_bands(order: int) -> Float[Tensor, "order"]:
    """Factors of convolution with ``max(0, cos) / pi``: 1, 2/3, 1/4, 0, -1/24, ..."""
    out = []
    for l in range(order):
        if l == 1:
            out.append(2 / 3)
        elif l % 2:
            out.append(0.0)
        else:
            half = math.factorial(l) / (2**l * math.factorial(l // 2) ** 2)
            out.append(2 * (-1) ** (l // 2 - 1) / ((l + 2) * (l - 1)) * half)
    return torch.tensor(out)

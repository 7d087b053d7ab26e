"""Learnt transfer: a small network in place of stored transfer (Dhawal, KT and Narayanan 2022).

``sigma: (p, n) -> T`` (equation 4) is :class:`prt.nn.transfer_network.TransferNetwork`, trained on transfer
cast at points spread evenly over the surface (section 4.2: L1 loss, batches of 8192). A large scene may be
cut into cells with a network each (section 4.4). The size may be left to the method (``neurons: auto``).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.partition import Partition, partition, whole
from prt.methods.sh_relight import ShRelight
from prt.methods.training import fit_network
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer

RENDERERS = ("torch", "glsl")


class LearntSh(ShRelight):
    """The method; settings as in ``conf/method/learnt_sh.yaml``.

    Args:
        neurons, layers: k and l of each network.
        position_frequencies, normal_frequencies: octaves of the encodings.
        training: steps, batch, rate, average, loss (``l1`` or ``l2``), scale_outputs: multiply the tanh by
            the largest value that each coefficient has in training, and a little more.
        cells: along x, y and z, of a scene that is cut; null for none.
        networks: how many are left when neighbouring cells are merged; null for one a cell that holds surface.
        margin: delta of section 4.4, as a share of the longest side of the scene's box: how far beyond its
            cells a network's training points reach.
        renderer: ``torch``, or ``glsl``: network and shading in a fragment shader, for images only.
    """

    def __init__(
        self,
        neurons: int,
        layers: int,
        position_frequencies: int,
        normal_frequencies: int,
        training: dict[str, Any],
        cells: Sequence[int] | None = None,
        networks: int | None = None,
        margin: float = 0.02,
        renderer: str = "torch",
    ):
        for name, value, least in (
            ("neurons", neurons, 1), ("layers", layers, 1), ("position_frequencies", position_frequencies, 0),
            ("normal_frequencies", normal_frequencies, 0), ("training.steps", training["steps"], 1),
            ("training.batch", training["batch"], 1),
        ):  # fmt: skip
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise PrtError(f"method.{name}={value!r} must be an integer of at least {least}")
        if training["loss"] not in ("l1", "l2"):
            raise PrtError(f"method.training.loss={training['loss']!r} is not l1 or l2")
        if renderer not in RENDERERS:
            raise PrtError(f"method.renderer={renderer!r} is not one of {', '.join(RENDERERS)}")
        if not margin >= 0:
            raise PrtError(
                f"method.margin={margin} must be 0 or more (share of the longest side of the scene)"
            )
        if networks is not None and cells is None:
            raise PrtError(f"method.networks={networks} merges cells, and method.cells is null; set both")
        self.neurons, self.layers = neurons, layers
        self.frequencies = (position_frequencies, normal_frequencies)
        self.training = training
        self.cells = None if cells is None else tuple(int(v) for v in cells)
        self.networks, self.margin, self.renderer = networks, margin, renderer
        self.nets = torch.nn.ModuleList()
        self.partition: Partition | None = None
        self._shader: Any = None

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Train the network, or those of all cells side by side; resumes through ``log``."""
        self.prepare(task, device)
        data, generator = task.training(), torch.Generator().manual_seed(seed)
        position, normal = data.points.position, data.points.normal
        self.partition = self.divide(data.bounds, position, data.transfer)
        longest = max(b - a for a, b in zip(*data.bounds, strict=True))
        parts = []
        for group in range(self.partition.groups):
            rows = self.partition.near(position, group, self.margin * longest).nonzero()[:, 0]
            parts.append(_Part(*(v[rows].to(device) for v in (position, normal, data.transfer))))
        self.nets = torch.nn.ModuleList(
            self.network(part.bounds, data.transfer.shape[1], generator) for part in parts
        ).to(device)
        if self.training["scale_outputs"]:
            for net, part in zip(self.networks_of(), parts, strict=True):
                net.scale.copy_(1.25 * part.transfer.abs().amax(0).clamp_min(1e-3))
        batch = max(self.training["batch"] // len(parts), 1)
        optimiser = torch.optim.Adam(
            self.nets.parameters(), lr=self.training["rate"], betas=(0.9, 0.99), fused=True
        )

        def step() -> Tensor:
            losses = []
            for net, part in zip(self.networks_of(), parts, strict=True):
                rows = torch.randint(len(part.position), (batch,), generator=generator).to(device)
                wrong = net(part.position[rows], part.normal[rows]) - part.transfer[rows]
                losses.append(wrong.abs().mean() if self.training["loss"] == "l1" else wrong.square().mean())
            return torch.stack(losses).mean()

        fit_network(log, "learnt_sh", self.nets, self.training, generator, step, optimiser)

    def divide(
        self, bounds: tuple[tuple[float, ...], tuple[float, ...]], position: Tensor, transfer: Tensor
    ) -> Partition:
        """The cells of the scene and which of them share a network."""
        if self.cells is None:
            return whole(bounds)
        x, y, z = self.cells
        apart = Partition(*(torch.tensor(corner) for corner in bounds), (x, y, z), torch.arange(x * y * z))
        used = len(apart.cell_of(position).unique())
        many = used if self.networks is None else self.networks
        return partition(bounds, (x, y, z), many, position, transfer)

    def network(
        self, bounds: tuple[list[float], list[float]], outputs: int, generator: torch.Generator | None = None
    ) -> TransferNetwork:
        """An untrained one of this method's size."""
        return TransferNetwork(bounds, self.neurons, self.layers, outputs, *self.frequencies, generator)

    def networks_of(self) -> list[TransferNetwork]:
        """One for each group of cells."""
        return list(self.nets)  # pyright: ignore[reportReturnType]

    # ---- rendering

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """The network's, at the points that hit the surface and no others (section 4.3.2: packed).

        Raises:
            PrtError: before ``fit`` or ``load``.
        """
        if self.partition is None:
            raise PrtError("learnt_sh has no network yet; fit it or load a checkpoint first")
        nets = self.networks_of()
        if len(nets) == 1:
            return nets[0](gbuffer.position, gbuffer.normal)
        group = self.partition.to(self.device).group_of(gbuffer.position)
        out = gbuffer.position.new_zeros((len(gbuffer), self.order**2))
        for number, net in enumerate(nets):
            rows = (group == number).nonzero()[:, 0]
            if len(rows):
                out[rows] = net(gbuffer.position[rows], gbuffer.normal[rows])
        return out

    # ---- storage

    def nbytes(self) -> int:
        """Weights, biases and boxes of all networks, float32, and the number of each cell's."""
        if self.partition is None:
            return 0
        cells = 0 if len(self.nets) == 1 else len(self.partition.group)
        return sum(net.nbytes() for net in self.networks_of()) + cells

    def save(self, path: Path) -> None:
        if self.partition is None:
            raise PrtError("learnt_sh has no network to save; fit it first")
        grid = self.partition
        tensors = {f"nets.{name}": value for name, value in self.nets.state_dict().items()}
        tensors |= {
            "low": grid.low,
            "high": grid.high,
            "group": grid.group,
            "cells": torch.tensor(grid.cells),
        }
        self.save_tensors(path, tensors)

    def load(self, path: Path, task: Any, device: str) -> None:
        """Raises PrtError where the file was written with other sizes."""
        state = self.load_tensors(path, task, device)
        x, y, z = (int(v) for v in state.pop("cells"))
        grid = Partition(state.pop("low").cpu(), state.pop("high").cpu(), (x, y, z), state.pop("group").cpu())
        box = ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
        self.nets = torch.nn.ModuleList(self.network(box, task.order**2) for _ in range(grid.groups)).to(
            device
        )
        try:
            self.nets.load_state_dict({name.removeprefix("nets."): value for name, value in state.items()})
        except RuntimeError as error:
            raise PrtError(
                f"{path} was written with other layer sizes than method.neurons={self.neurons}, "
                f"layers={self.layers}; use the run's own config.yaml"
            ) from error
        self.partition = grid


class _Part:
    """The training points of one network."""

    def __init__(self, position: Tensor, normal: Tensor, transfer: Tensor):
        self.position, self.normal, self.transfer = position, normal, transfer
        if len(position) == 0:
            raise PrtError("a cell of method.cells holds no training points; use fewer cells")

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        return self.position.amin(0).tolist(), self.position.amax(0).tolist()

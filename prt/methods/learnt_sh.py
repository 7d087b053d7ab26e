"""Learnt transfer: a small network in place of stored transfer (Dhawal, KT and Narayanan 2022).

``sigma: (p, n) -> T`` (equation 4) is :class:`prt.nn.transfer_network.TransferNetwork`, trained on transfer
cast at points spread evenly over the surface (section 4.2: L1 loss, batches of 8192). A large scene may be
cut into cells with a network each (section 4.4). The size may be left to the method (``neurons: auto``).
"""

import copy
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog, Silent
from prt.methods.partition import Partition, partition, whole
from prt.methods.sh_relight import ShRelight
from prt.methods.training import fit_network
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer
from prt.trace.sh_shading import ShCode
from prt.trace.surface import SurfacePoints

if TYPE_CHECKING:
    from prt.methods.transfer_shader import TransferShader

RENDERERS = ("torch", "glsl")


class LearntSh(ShRelight):
    """The method; settings as in ``conf/method/learnt_sh.yaml``.

    Args:
        neurons, layers: k and l of each network. ``neurons: auto`` takes the first of ``ladder`` whose
            transfer of points held out is within ``target`` of the cast one.
        ladder: sizes ``[k, l]`` to be tried, from small to large.
        target: root mean square error over the root mean square of the transfer.
        position_frequencies, normal_frequencies: octaves of the encodings.
        training: steps, batch, rate, average, loss (``l1`` or ``l2``), scale_outputs: multiply the tanh by
            the largest value that each coefficient has in training, and a little more.
        cells: along x, y and z, of a scene that is cut; null for none.
        networks: how many are left when neighbouring cells are merged; null for one per cell with surface.
        margin: delta of section 4.4, as a share of the longest side of the scene's box: how far beyond its
            cells a network's training points reach.
        renderer: ``torch``, or ``glsl``: network and shading in a fragment shader, for images only.
    """

    def __init__(
        self,
        neurons: int | str,
        layers: int,
        position_frequencies: int,
        normal_frequencies: int,
        training: dict[str, Any],
        ladder: Sequence[Sequence[int]] = (),
        target: float = 0.05,
        cells: Sequence[int] | None = None,
        networks: int | None = None,
        margin: float = 0.02,
        renderer: str = "torch",
    ):
        self.auto = neurons == "auto"
        if self.auto and not ladder:
            raise PrtError(
                "method.neurons=auto tries the sizes of method.ladder, which is empty; list [k, l]"
            )
        if not target > 0:
            raise PrtError(f"method.target={target} must be above 0 (relative error of held-out transfer)")
        sizes = [(f"ladder[{i}]", value, 1) for i, pair in enumerate(ladder) for value in pair]
        for name, value, least in (
            ("neurons", 1 if self.auto else neurons, 1), ("layers", layers, 1), *sizes,
            ("position_frequencies", position_frequencies, 0),
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
        self.neurons, self.layers = 0 if isinstance(neurons, str) else neurons, layers
        self.ladder, self.target = [tuple(pair) for pair in ladder], target
        self.frequencies = (position_frequencies, normal_frequencies)
        self.training = training
        self.cells = None if cells is None else tuple(int(v) for v in cells)
        self.networks, self.margin, self.renderer = networks, margin, renderer
        self.nets = torch.nn.ModuleList()
        self.partition: Partition | None = None
        self._shader: Any = None

    # ---- fitting

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Train the network, or those of all cells side by side; resumes through ``log``.

        Raises:
            PrtError: if no size of the ladder meets the target.
        """
        self.prepare(task, device)
        if self.auto:
            self._choose(task, log, seed, device)
            return
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

    def _choose(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Train the sizes of the ladder one after the other until one meets the target."""
        kept = log.resume()
        log.start(len(self.ladder), "learnt_sh")
        done, state = kept if kept is not None else (0, {})
        for number, (neurons, layers) in enumerate(self.ladder):
            if number < done - 1:
                continue
            self.neurons, self.layers = neurons, layers
            if number == done - 1:
                self._take_tensors(state["tensors"], task, device)
                error = float(state["error"])
            else:
                size = {"neurons": neurons, "layers": layers, "cells": self.cells, "networks": self.networks}
                one = LearntSh(**size, position_frequencies=self.frequencies[0],
                               normal_frequencies=self.frequencies[1], training=self.training,
                               margin=self.margin)  # fmt: skip
                one.fit(task, Silent(), seed, device)
                self.nets, self.partition = one.nets, one.partition
                error = held_out_error(task, self)
                log.step(number + 1, held_out_error=error, neurons=float(neurons), layers=float(layers))
                log.save(number + 1, {"tensors": self._tensors(), "error": error})
            if error <= self.target:
                return
        raise PrtError(
            f"no size of method.ladder={[list(pair) for pair in self.ladder]} meets method.target="
            f"{self.target}: the largest has a held-out error of {error:.3g}; raise the target or add sizes"
        )

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
        group = self.group_of(gbuffer.position)
        out = gbuffer.position.new_zeros((len(gbuffer), self.order**2))
        for number, net in enumerate(nets):
            rows = (group == number).nonzero()[:, 0]
            if len(rows):
                out[rows] = net(gbuffer.position[rows], gbuffer.normal[rows])
        return out

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: ShCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Direct radiance, in torch or by the fragment shader; it may ring below zero.

        Raises:
            PrtError: with ``renderer: glsl``, for points that belong to no image, networks that do not fit
                in a shader, or where there is no OpenGL.
        """
        if self.renderer == "torch":
            return super().shade(gbuffer, code, v)
        if len(gbuffer) == 0:
            return torch.zeros((0, 3))
        shader, near = self.shader(), gbuffer.to("cpu")
        shader.set_gbuffer(near, self.group_of(near.position))
        image = shader.render(ShCode(code.coefficients.cpu(), code.matrix.cpu()))
        return image.reshape(-1, 3)[near.hit]

    def group_of(self, position: Float[Tensor, "N 3"]) -> Int[Tensor, "N"]:
        """Which network serves each place.

        Raises:
            PrtError: before ``fit`` or ``load``.
        """
        if self.partition is None:
            raise PrtError("learnt_sh has no network yet; fit it or load a checkpoint first")
        return self.partition.to(str(position.device)).group_of(position)

    def shader(self) -> "TransferShader":
        """The networks as a fragment shader, made once."""
        from prt.methods.transfer_shader import TransferShader

        if self._shader is None:
            nets = [copy.deepcopy(net).cpu() for net in self.networks_of()]
            self._shader = TransferShader(nets, self.order)
        return self._shader

    def timed_parts(self, lighting: Tensor, gbuffer: GBuffer) -> dict[str, Callable[[], Any]]:
        """As for all methods; and a whole frame of either material."""
        code, black = self.light(lighting), torch.zeros_like(gbuffer.diffuse)
        colour = gbuffer.diffuse + gbuffer.specular
        even = dataclasses.replace(gbuffer, diffuse=colour, specular=black)
        sharp = dataclasses.replace(gbuffer, diffuse=black, specular=colour)
        frames = {
            "diffuse": lambda: self.shade(even, code), "glossy": lambda: self.shade(sharp, code),
        }  # fmt: skip
        return {**super().timed_parts(lighting, gbuffer), **frames}

    # ---- storage

    def nbytes(self) -> int:
        """Weights, biases and boxes of all networks, float32, and the number of each cell's."""
        if self.partition is None:
            return 0
        cells = 0 if len(self.nets) == 1 else len(self.partition.group)
        return sum(net.nbytes() for net in self.networks_of()) + cells

    def _tensors(self) -> dict[str, Tensor]:
        if self.partition is None:
            raise PrtError("learnt_sh has no network to save; fit it first")
        grid = self.partition
        tensors = {f"nets.{name}": value for name, value in self.nets.state_dict().items()}
        size = torch.tensor([self.neurons, self.layers])
        return tensors | {
            "low": grid.low, "high": grid.high, "group": grid.group, "cells": torch.tensor(grid.cells),
            "size": size,
        }  # fmt: skip

    def _take_tensors(self, state: dict[str, Tensor], task: Any, device: str) -> None:
        state = dict(state)
        x, y, z = (int(v) for v in state.pop("cells"))
        grid = Partition(state.pop("low").cpu(), state.pop("high").cpu(), (x, y, z), state.pop("group").cpu())
        neurons, layers = (int(v) for v in state.pop("size"))
        if self.auto:
            self.neurons, self.layers = neurons, layers
        box = ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
        nets = [self.network(box, task.order**2) for _ in range(grid.groups)]
        self.nets = torch.nn.ModuleList(nets).to(device)
        self.nets.load_state_dict({name.removeprefix("nets."): value for name, value in state.items()})
        self.partition = grid

    def save(self, path: Path) -> None:
        self.save_tensors(path, self._tensors())

    def load(self, path: Path, task: Any, device: str) -> None:
        """Raises PrtError where the file was written with other sizes."""
        try:
            self._take_tensors(self.load_tensors(path, task, device), task, device)
        except RuntimeError as error:
            raise PrtError(
                f"{path} was written with other layer sizes than method.neurons={self.neurons}, "
                f"layers={self.layers}; use the run's own config.yaml"
            ) from error


def held_out_error(task: Any, method: ShRelight) -> float:
    """Root mean square error of the transfer of points held out, over their root mean square."""
    data = task.held_out()
    with torch.no_grad():
        found = method.transfer(points_gbuffer(data.points).to(method.device)).cpu()
    return float((found - data.transfer).norm() / data.transfer.norm())


def points_gbuffer(points: SurfacePoints) -> GBuffer:
    """A G-buffer of single points that are looked at along their normals, of reflectance 1."""
    one = torch.ones_like(points.position)
    return GBuffer(
        points.position, points.normal, points.normal, points.normal, one, 0 * one, one[:, :1], one[:, :2],
        torch.ones(len(one), dtype=torch.bool),
    )  # fmt: skip


class _Part:
    """The training points of one network."""

    def __init__(self, position: Tensor, normal: Tensor, transfer: Tensor):
        self.position, self.normal, self.transfer = position, normal, transfer
        if len(position) == 0:
            raise PrtError("a cell of method.cells holds no training points; use fewer cells")

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        return self.position.amin(0).tolist(), self.position.amax(0).tolist()

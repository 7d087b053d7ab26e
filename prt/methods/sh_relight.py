"""What all methods with SH transfer share: they store transfer differently, and light and shade alike."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Component, check_lighting
from prt.scene.gbuffer import GBuffer
from prt.trace import sh_shading
from prt.trace.sh_shading import ShCode


class ShRelight:
    """Base of the methods of task ``relight_direct``; a subclass says what the transfer of a point is.

    ``order`` (bands) and ``windowing`` of the lighting are the task's.
    """

    component = Component.DIRECT
    tasks = frozenset({"relight_direct"})
    order: int = 0
    windowing: float = 0.0
    device: str = "cpu"

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """Transfer vectors of the points of a G-buffer."""
        raise NotImplementedError

    def prepare(self, task: Any, device: str) -> None:
        """Take over what the task decides; called first by ``fit`` and ``load``."""
        self.order, self.windowing, self.device = task.order, task.windowing, device

    # ---- rendering

    @torch.no_grad()
    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> ShCode:
        """Coefficients of the environment, and the light matrix.

        Raises:
            PrtError: before ``fit`` or ``load``, or for a lighting that no light can be.
        """
        check_lighting(lighting)
        if not self.order:
            raise PrtError(f"{type(self).__name__} has no transfer yet; fit it or load a checkpoint first")
        return sh_shading.encode(lighting.to(self.device), self.order, self.windowing)

    @torch.no_grad()
    def shade(self, gbuffer: GBuffer, code: ShCode, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Direct radiance; it may ring below zero."""
        gbuffer = gbuffer.to(self.device)
        return sh_shading.shade(self.transfer(gbuffer), gbuffer, code)

    def timed_parts(self, lighting: Tensor, gbuffer: GBuffer) -> dict[str, Callable[[], Any]]:
        """The transfer of all points, and the product with the light."""
        code, near = self.light(lighting), gbuffer.to(self.device)
        with torch.no_grad():
            transfer = self.transfer(near)
        return {
            "transfer": torch.no_grad()(lambda: self.transfer(near)),
            "product": torch.no_grad()(lambda: sh_shading.shade(transfer, near, code)),
        }

    # ---- storage

    def save_tensors(self, path: Path, tensors: dict[str, Tensor]) -> None:
        """A safetensors file of these, and of the lighting's bands."""
        settings = {"order": torch.tensor(self.order), "windowing": torch.tensor(self.windowing)}
        save_file({k: v.detach().cpu().contiguous() for k, v in (tensors | settings).items()}, path)

    def load_tensors(self, path: Path, task: Any, device: str) -> dict[str, Tensor]:
        """The tensors of a file, on the device.

        Raises:
            PrtError: if they were made for another number of bands than the task has.
        """
        self.prepare(task, device)
        state = load_file(path)
        if int(state.pop("order")) != task.order:
            raise PrtError(
                f"{path} was made for another number of bands than task.order={task.order}; use the run's "
                "own config.yaml"
            )
        state.pop("windowing")
        return {name: value.to(device) for name, value in state.items()}

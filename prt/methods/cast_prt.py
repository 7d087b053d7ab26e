"""Transfer cast anew for every pixel: no storage and no error of one, the limit of all stored forms."""

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import FitLog
from prt.methods.sh_relight import ShRelight
from prt.scene.gbuffer import GBuffer
from prt.trace.transfer import bake

#: added to the run's seed: no reference is cast with the directions of a method under test
FIRST_SEED = 2_000_000


class CastPrt(ShRelight):
    """The method; settings as in ``conf/method/cast_prt.yaml``.

    Args:
        directions: rays a pixel.
    """

    def __init__(self, directions: int):
        self.directions = directions
        self._surface: Any = None
        self._seed = FIRST_SEED

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Nothing is precomputed."""
        self.prepare(task, device)
        log.resume()
        log.start(1, "cast_prt")
        self._surface, self._seed = task.surface, FIRST_SEED + seed
        log.step(1, directions=float(self.directions))
        log.save(1, {})

    def transfer(self, gbuffer: GBuffer) -> Float[Tensor, "N K"]:
        """Cast from every point.

        Raises:
            PrtError: before ``fit`` or ``load``.
        """
        if self._surface is None:
            raise PrtError("cast_prt has no scene yet; fit it or load a checkpoint first")
        position, normal = gbuffer.position.cpu(), gbuffer.normal.cpu()
        values = bake(self._surface, position, normal, self.order, self.directions, self._seed)
        return values.to(gbuffer.position.device)

    def nbytes(self) -> int:
        """Nothing is stored beside the scene itself."""
        return 0

    def save(self, path: Path) -> None:
        self.save_tensors(path, {"seed": torch.tensor(self._seed)})

    def load(self, path: Path, task: Any, device: str) -> None:
        self._seed = int(self.load_tensors(path, task, device)["seed"])
        self._surface = task.surface

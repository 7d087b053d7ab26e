"""The method contract (docs/architecture.md): what the runner asks of a method, and nothing more."""

import enum
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light.sanitise import sanitise
from prt.scene.gbuffer import GBuffer


class Component(enum.Enum):
    """What part of the light :meth:`Method.shade` returns."""

    DIRECT = "direct"
    INDIRECT = "indirect"
    FULL = "full"


class FitLog(Protocol):
    """What a method may tell the runner while it fits; called from ``fit`` only."""

    def start(self, steps: int, label: str) -> None:
        """Begin a progress bar of ``steps`` steps."""
        ...

    def step(self, step: int, **values: float) -> None:
        """Report step number ``step`` (from 1) with named scalars; NaN or infinity stops the run."""
        ...

    def checkpoint_due(self, step: int) -> bool:
        """Whether a checkpoint should be written after this step (time based, and always at the last)."""
        ...

    def save(self, step: int, state: dict[str, Any]) -> None:
        """Keep a resumable state: a nested dict of tensors, numbers and strings, written atomically."""
        ...

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        """The last kept (step, state), or None for a fresh run."""
        ...


class Silent:
    """A fit log that keeps nothing: for fits within a fit, and of benchmarks."""

    def start(self, steps: int, label: str) -> None: ...

    def step(self, step: int, **values: float) -> None: ...

    def checkpoint_due(self, step: int) -> bool:
        return False

    def save(self, step: int, state: dict[str, Any]) -> None: ...

    def resume(self) -> None:
        return None


@runtime_checkable
class Method(Protocol):
    """A way to render a scene under a lighting after precomputation.

    Hydra instantiates it from ``conf/method/<name>.yaml`` (``_target_`` and its settings). A class may name
    in ``rendering`` the settings that a fitted model does not depend on: runs that differ in these alone
    share one fit.
    """

    component: Component
    tasks: frozenset[str]

    def fit(self, task: Any, log: FitLog, seed: int, device: str) -> None:
        """Precompute and train; asks the task only for the data it needs. Resumes through ``log``."""
        ...

    def light(self, lighting: Float[Tensor, "6 R R 3"]) -> Any:
        """Once per lighting: project, select, encode. Returns the code that :meth:`shade` takes."""
        ...

    def shade(self, gbuffer: GBuffer, code: Any, v: Tensor | None = None) -> Float[Tensor, "N 3"]:
        """Once per frame: linear radiance of the N points of the G-buffer."""
        ...

    def nbytes(self) -> int:
        """Bytes that must be stored to render."""
        ...

    def save(self, path: Path) -> None:
        """Write what rendering needs to a safetensors file."""
        ...

    def load(self, path: Path, task: Any, device: str) -> None:
        """Read it back; executes no code from the file."""
        ...


def check_lighting(lighting: Float[Tensor, "6 R R 3"], resolution: int | None = None) -> None:
    """Refuse a lighting that no light can be, or of another resolution than a model was fitted to.

    Raises:
        PrtError: in one line with what to do.
    """
    if resolution is not None and lighting.shape[1] != resolution:
        raise PrtError(
            f"the lighting has {lighting.shape[1]} texels a side, the model {resolution}; "
            f"set task.resolution={resolution}"
        )
    sanitise(lighting, "given")

"""Animation as data: what each variable of a scene moves, from where to where (Su 2024, section 4.1).

:mod:`prt.scene.animation_file` reads it from our own format or the paper's.
"""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from prt.errors import PrtError

Matrix = Float[np.ndarray, "4 4"]


@dataclasses.dataclass(frozen=True)
class Motion:
    """One thing that one variable does; ``start`` and ``end`` are tuples of numbers."""

    kind: str
    start: tuple[float, ...]
    end: tuple[float, ...]
    shapes: tuple[str, ...] = ()
    parameter: str = ""
    axis: tuple[float, ...] = (0.0, 1.0, 0.0)
    centre: tuple[float, ...] = (0.0, 0.0, 0.0)

    def at(self, v: float) -> np.ndarray:
        """Between start and end, exact at both; beyond them where v is."""
        return (1.0 - v) * np.array(self.start) + v * np.array(self.end)

    def matrix(self, v: float) -> Matrix:
        """Of a motion of shapes or of the environment."""
        value, out = self.at(v), np.eye(4)
        if self.kind == "translate":
            out[:3, 3] = value
            return out
        out[:3, :3] = (
            rotation(self.axis, float(value[0])) if "rotate" in self.kind else np.diag(value * np.ones(3))
        )
        centre = np.array(self.centre)
        out[:3, 3] = centre - out[:3, :3] @ centre
        return out


@dataclasses.dataclass(frozen=True)
class Variable:
    """A value from 0 to 1 and what it does."""

    name: str
    motions: tuple[Motion, ...]


@dataclasses.dataclass(frozen=True)
class Animation:
    """All variables of a scene, in the order of the scene vector."""

    variables: tuple[Variable, ...] = ()
    #: variables that stand still, at which value
    rest: tuple[tuple[Variable, float], ...] = ()

    @property
    def dimension(self) -> int:
        """n."""
        return len(self.variables)

    @property
    def names(self) -> list[str]:
        return [variable.name for variable in self.variables]

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON data that determines what every state looks like."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    def subset(self, count: int | None, rest: float = 0.0) -> "Animation":
        """The first ``count`` variables; the others stay at ``rest``. None for all.

        Raises:
            PrtError: for more variables than there are.
        """
        if count is None:
            return self
        if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= self.dimension:
            raise PrtError(f"scene.variables={count!r} must be an integer from 0 to {self.dimension}")
        still = tuple((variable, rest) for variable in self.variables[count:])
        return Animation(self.variables[:count], still + self.rest)

    def check(self, v: Sequence[float]) -> list[float]:
        """A state as plain numbers; beyond [0, 1] motions go on as they were going.

        Raises:
            PrtError: for another number of values than there are variables, or one that is not finite.
        """
        state = [float(value) for value in v]
        if len(state) != self.dimension:
            names = f" ({', '.join(self.names)})" if self.variables else ""
            raise PrtError(f"a state of {len(state)} values for a scene of {self.dimension} variables{names}")
        if not np.isfinite(state).all():
            raise PrtError(f"state {state}: all values must be finite, usually from 0 to 1")
        return state

    def _placed(self, v: Sequence[float]) -> list[tuple[Motion, float]]:
        moving = list(zip(self.variables, self.check(v), strict=True)) + list(self.rest)
        return [(motion, value) for variable, value in moving for motion in variable.motions]

    def transforms(self, v: Sequence[float]) -> dict[str, Matrix]:
        """For every shape that moves, from its place in the file to its place in the state."""
        out: dict[str, Matrix] = {}
        for motion, value in self._placed(v):
            for shape in motion.shapes:
                out[shape] = motion.matrix(value) @ out.get(shape, np.eye(4))
        return out

    def environment(self, v: Sequence[float]) -> Matrix | None:
        """The turn of the environment; None where nothing turns it."""
        turns = [motion.matrix(value) for motion, value in self._placed(v) if "environment" in motion.kind]
        return None if not turns else np.linalg.multi_dot([*reversed(turns), np.eye(4)])

    @property
    def places_environment(self) -> bool:
        """Whether the turn of the environment replaces that of the file."""
        every = [*self.variables, *(variable for variable, _ in self.rest)]
        return any(m.kind == "rotate_environment_to" for variable in every for m in variable.motions)

    def values(self, v: Sequence[float]) -> dict[str, tuple[float, ...]]:
        """Values of parameters; of two variables for one parameter the later one counts."""
        return {m.parameter: tuple(m.at(x).tolist()) for m, x in self._placed(v) if m.kind == "value"}

    def scales_unevenly(self, shape: str) -> bool:
        """Whether a motion has other factors along one axis than along another for this shape."""
        every = [*self.variables, *(variable for variable, _ in self.rest)]
        scales = [
            m for variable in every for m in variable.motions if m.kind == "scale" and shape in m.shapes
        ]
        return any(len(set(factors)) > 1 for m in scales for factors in (m.start, m.end))

    def shapes(self) -> list[str]:
        """All that are named."""
        every = [*self.variables, *(variable for variable, _ in self.rest)]
        return list(dict.fromkeys(s for variable in every for m in variable.motions for s in m.shapes))


def rotation(axis: Sequence[float], degrees: float) -> Float[np.ndarray, "3 3"]:
    """Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # exact at 0 and at quarter turns, where sine and cosine of radians are not
    turn = degrees % 360.0
    exact = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0), 270.0: (-1.0, 0.0)}
    sine, cosine = exact.get(turn, (np.sin(np.radians(turn)), np.cos(np.radians(turn))))
    return np.eye(3) + sine * k + (1 - cosine) * (k @ k)

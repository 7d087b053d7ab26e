"""Expressions that write themselves down as GLSL: each operation once, in the order in which it is met."""

from typing import Any

import numpy as np

from prt.errors import PrtError


class GlslProgram:
    """A list of assignments ``float tN = ...``; an expression that is met again keeps its first name."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def assigned(self, expression: str) -> "Glsl":
        """The temporary that holds this expression, made where there is none yet."""
        return Glsl(self, self._names.setdefault(expression, f"t{len(self._names)}"))

    def lines(self) -> list[str]:
        """One statement for each temporary."""
        return [f"float {name} = {expression};" for expression, name in self._names.items()]


class Glsl:
    """A scalar of a GLSL program: it has a name there, and operators that extend the program.

    The other operand is of the same program, or a number, which becomes a literal.
    """

    __slots__ = ("name", "program")

    def __init__(self, program: GlslProgram, name: str):
        self.program, self.name = program, name

    def __add__(self, other: Any) -> "Glsl":
        return self._of("{} + {}", self, other)

    def __radd__(self, other: Any) -> "Glsl":
        return self._of("{} + {}", other, self)

    def __sub__(self, other: Any) -> "Glsl":
        return self._of("{} - {}", self, other)

    def __rsub__(self, other: Any) -> "Glsl":
        return self._of("{} - {}", other, self)

    def __mul__(self, other: Any) -> "Glsl":
        return self._of("{} * {}", self, other)

    def __rmul__(self, other: Any) -> "Glsl":
        return self._of("{} * {}", other, self)

    def __truediv__(self, other: Any) -> "Glsl":
        return self._of("{} / {}", self, other)

    def __rtruediv__(self, other: Any) -> "Glsl":
        return self._of("{} / {}", other, self)

    def __neg__(self) -> "Glsl":
        return self._of("-{}", self)

    def _of(self, form: str, *operands: Any) -> "Glsl":
        return self.program.assigned(form.format(*(literal(operand) for operand in operands)))


def call(function: str, *operands: Any) -> Glsl:
    """A GLSL function of scalars, at least one of which is a :class:`Glsl`."""
    program = next(operand.program for operand in operands if isinstance(operand, Glsl))
    return program.assigned(f"{function}({', '.join(literal(operand) for operand in operands)})")


def literal(value: Any) -> str:
    """The name of an expression, or a number with the nine digits that tell any two float32 apart.

    Raises:
        PrtError: for a number that float32 cannot hold.
    """
    if isinstance(value, Glsl):
        return value.name
    with np.errstate(over="ignore"):
        number = np.float32(value)
    if not np.isfinite(number):
        raise PrtError(
            f"distance field constant {value!r} is no finite float32; scale the shape to world units"
        )
    text = f"{number:.9g}"
    text = text if set(text) & {".", "e"} else f"{text}.0"
    # "a - -1.0" is legal, "--1.0" is not
    return f"({text})" if number < 0 else text

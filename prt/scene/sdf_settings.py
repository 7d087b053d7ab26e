"""Settings of distance fields, checked where they are given."""

import math
from collections.abc import Sequence
from typing import Any

from prt.errors import PrtError


def finite(name: str, value: Any) -> float:
    """A finite number.

    Raises:
        PrtError: for anything else; so the others.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool):
        raise PrtError(f"distance field {name}={value!r} must be a finite number; give one in world units")
    return number


def positive(name: str, value: Any) -> float:
    """A finite number above 0."""
    number = finite(name, value)
    if number <= 0.0:
        raise PrtError(f"distance field {name}={value!r} must be above 0; give a larger one")
    return number


def point(name: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Sequence) or len(value) != 3:
        raise PrtError(f"distance field {name}={value!r} must be 3 numbers; give (x, y, z)")
    x, y, z = (finite(name, part) for part in value)
    return x, y, z


def rounding(name: str, value: Any, most: float) -> float:
    """The radius of rounded edges, from 0 to half the smallest side."""
    number = finite(name, value)
    if not 0.0 <= number <= most:
        raise PrtError(f"distance field {name}={value!r} must lie between 0 and {most:g}; lower it")
    return number


def chosen(name: str, value: Any, choices: Sequence[str]) -> str:
    """One of some words."""
    if value not in choices:
        raise PrtError(f"distance field {name}={value!r} is not one of {', '.join(choices)}; choose one")
    return value

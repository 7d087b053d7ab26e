"""Selections of rows in a table's YAML: ``where: {lambda: 0.01, denoised: [True, False], rays: null}``."""

from collections.abc import Mapping
from typing import Any

from prt.errors import PrtError

Where = dict[str, list[str]]


def listed(value: Any) -> list:
    """What a YAML may give as a list or as its only element."""
    return value if isinstance(value, list) else [value]


def read_where(given: Any) -> Where:
    """Setting to the values that are wanted, as text.

    Raises:
        PrtError: for anything but pairs.
    """
    if not isinstance(given or {}, Mapping):
        raise PrtError(f"where={given!r} must be pairs, as {{lambda: 0.01}}")
    return {str(key): [str(v) for v in listed(value)] for key, value in (given or {}).items()}


def meets(own: Mapping[str, str], where: Where) -> bool:
    """Whether a row with these settings has one of the wanted values in each that is named."""
    return all(any(_same(own.get(name), value) for value in values) for name, values in where.items())


def _same(own: str | None, wanted: str) -> bool:
    """Equal as text, or as numbers: ``1e-2`` and ``0.01``; null means those without the setting."""
    if own is None or own == wanted:
        return own is not None or wanted == str(None)
    try:
        return float(own) == float(wanted)
    except ValueError:
        return False

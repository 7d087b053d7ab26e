"""``results.csv`` for the page: columns of numbers, words by their place in a list, and how to write them."""

import math
from pathlib import Path
from typing import Any

import pandas as pd

from prt.bench.layout import figure_format, metric_name
from prt.bench.results import KEYS, direction_of, is_cost, read_results
from prt.errors import PrtError

NUMBERS = ("value", "lo", "hi", "published")
COUNTS = ("n", "seeds")


def read(path: Path, name: str) -> pd.DataFrame:
    """A report's tidy table.

    Raises:
        PrtError: if it cannot be read.
    """
    try:
        return read_results(path)
    except (OSError, KeyError, ValueError) as error:
        why = " ".join(str(error).split())
        raise PrtError(f"cannot read {path} ({why}); write it again with `prt table {name}`") from error


def columns(table: pd.DataFrame) -> dict[str, Any]:
    """All rows: ``words`` of each key column, ``at``: which of them stands in each row; then the figures."""
    words: dict[str, list[str]] = {}
    at: dict[str, list[int]] = {}
    for name in KEYS:
        places, found = pd.factorize(table[name])
        words[name], at[name] = [str(word) for word in found], [int(place) for place in places]
    figures = {name: [number(value) for value in table[name]] for name in NUMBERS}
    counts = {name: [None if value != value else int(value) for value in table[name]] for name in COUNTS}
    return {"words": words, "at": at, **figures, **counts}


def number(value: Any) -> float | str | None:
    """Six significant digits; None for NaN, and the infinite, which JSON does not have, as a sign."""
    value = float(value)
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return None if math.isnan(value) else float(f"{value:.6g}")


def metrics(names: list[str]) -> dict[str, dict[str, str]]:
    """Label, unit, way and form of every metric; one that nobody defines any more has its name alone."""
    return {name: _metric(name) for name in names}


def _metric(name: str) -> dict[str, str]:
    try:
        (label, unit), better = metric_name(name), direction_of(name)
    except PrtError:
        return {"label": name, "unit": "", "better": "", "form": "digits"}
    if is_cost(name):
        return {"label": name, "unit": "", "better": better, "form": name.partition("/")[0]}
    digits = figure_format(name)(1 / 3)  # the form is known by what it makes of a number
    form = {"0.33": "2", "0.3333": "4"}.get(digits, "digits")
    return {"label": label, "unit": unit, "better": better, "form": form}

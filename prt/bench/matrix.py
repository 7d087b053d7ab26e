"""A matrix of failures: every method by every way to fail, read from reports that are there already.

A table's YAML with ``matrix`` runs nothing. Each cell names one figure of one report, what it is compared
with, two thresholds and why they stand where they do::

    title: Where methods fail
    matrix:
      rows: {svd_transfer: Data-driven transfer}         # methods
      columns: {light: Unseen kind of light}             # ways to fail
      cells:
        - row: svd_transfer
          column: light
          report: belcour2022/stability
          at: {scene: lion, variant: lights=closer, metric: error/relative}      # one row of its results.csv
          against: {variant: lights=same}                # that row but for this; left out: the figure itself
          by: ratio                                      # ratio or difference of the two
          good: 1.25                                     # up to here it holds
          bad: 2.0                                       # from here it has failed
          says: error under closer lights, over that under lights as baked
          because: twice the error is plain to see beside the reference
        - {row: svd_transfer, column: state, not: its keyframes are baked, there is no state beyond them}

``good`` above ``bad`` means that lower figures are worse. A report or a row that is not there leaves the cell
empty with the reason; it is never taken for good.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from prt.bench.compose import near
from prt.bench.results import COLUMNS, KEYS, read_results
from prt.errors import PrtError

Grade = Literal["holds", "degrades", "fails", "missing", "none"]
#: keys of a cell that is measured, and of one that has no such failure
CELL = ("row", "column", "report", "at", "against", "by", "good", "bad", "says", "because")
NOT = ("row", "column", "not")


@dataclasses.dataclass(frozen=True)
class MatrixCell:
    """One way one method may fail, and how far it does.

    Attributes:
        value: the figure, a ratio or a difference where it is compared; NaN where there is none.
        grade: ``holds`` up to ``good``, ``fails`` from ``bad`` on, ``degrades`` between; ``missing`` without
            a figure, ``none`` where the method cannot fail in this way.
        note: what the figure says; for a missing one, why.
    """

    row: str
    column: str
    report: str
    metric: str
    value: float
    good: float
    bad: float
    grade: Grade
    note: str
    because: str
    where: str = ""

    @property
    def way_to_bad(self) -> float:
        """How far the figure has come from ``good`` (0) to ``bad`` (1) and beyond; 0 where there is none."""
        way = (self.value - self.good) / (self.bad - self.good) if self.bad != self.good else 0.0
        return way if math.isfinite(way) else 0.0


@dataclasses.dataclass(frozen=True)
class Matrix:
    """All cells, with the names of rows and columns in their order, and the folder of the reports."""

    rows: dict[str, str]
    columns: dict[str, str]
    cells: list[MatrixCell]
    reports: Path

    def at(self, row: str, column: str) -> list[MatrixCell]:
        """The cells of a place, worst first."""
        order = ("fails", "degrades", "missing", "holds", "none")
        found = [cell for cell in self.cells if (cell.row, cell.column) == (row, column)]
        return sorted(found, key=lambda cell: (order.index(cell.grade), -cell.way_to_bad))


def read_matrix(path: Path, given: Any, reports: Path) -> Matrix:
    """The ``matrix`` of a YAML with its figures.

    Raises:
        PrtError: for an unknown or missing key, an unknown row or column, thresholds that are equal, or a
            selection that more than one row of a report meets.
    """

    def wrong(what: str) -> PrtError:
        return PrtError(f"{path}: matrix: {what}")

    _check(given, ("rows", "columns", "cells"), ("rows", "columns", "cells"), wrong)
    names = {part: {str(k): str(v) for k, v in given[part].items()} for part in ("rows", "columns")}
    cells = []
    for entry in given["cells"]:
        _check(entry, NOT if "not" in entry else CELL, ("row", "column"), wrong)
        for part, known in (("row", names["rows"]), ("column", names["columns"])):
            if entry[part] not in known:
                hint = near(str(entry[part]), list(known))
                raise wrong(f"unknown {part} {entry[part]!r}{hint}; there are {', '.join(known)}")
        place = (str(entry["row"]), str(entry["column"]))
        if "not" in entry:
            nothing = (math.nan, math.nan, math.nan)
            cells.append(MatrixCell(*place, "", "", *nothing, "none", str(entry["not"]), ""))
            continue
        missing = [key for key in CELL if key not in entry and key not in ("against", "by")]
        if missing:
            raise wrong(f"cell {place[0]}/{place[1]} has no {missing[0]}")
        cells.append(_measured(entry, place, reports, wrong))
    return Matrix(names["rows"], names["columns"], cells, reports)


def _check(given: Any, allowed: tuple[str, ...], needed: tuple[str, ...], wrong: Any) -> None:
    if not isinstance(given, dict):
        raise wrong(f"expected pairs, found {given!r}")
    for key in given:
        if key not in allowed:
            raise wrong(f"unknown key {key!r}{near(str(key), allowed)}; allowed: {', '.join(allowed)}")
    for key in needed:
        if not given.get(key):
            raise wrong(f"{key} is missing in {given!r}"[:200])


def _measured(entry: dict[str, Any], place: tuple[str, str], reports: Path, wrong: Any) -> MatrixCell:
    name, at = str(entry["report"]), dict(entry["at"])
    good, bad = float(entry["good"]), float(entry["bad"])
    if good == bad:
        raise wrong(f"cell {place[0]}/{place[1]}: good and bad are both {good:g}")
    against, by = entry.get("against"), str(entry.get("by", "ratio"))
    if by not in ("ratio", "difference"):
        raise wrong(f"cell {place[0]}/{place[1]}: by={by!r} is not one of ratio, difference")
    told = (name, str(at.get("metric", "")))
    texts = (
        str(entry["says"]),
        str(entry["because"]),
        ", ".join(str(v) for k, v in at.items() if k != "metric"),
    )

    def cell(value: float, grade: Grade, note: str) -> MatrixCell:
        return MatrixCell(*place, *told, value, good, bad, grade, note, *texts[1:])

    table = reports / name / "results.csv"
    if not table.is_file():
        return cell(math.nan, "missing", f"no report {name}: `prt table {name}` makes it")
    results = read_results(table)
    value = _figure(results, at, place, wrong)
    if against is not None:
        base = _figure(results, at | dict(against), place, wrong)
        value = value / base if by == "ratio" and base else value - base if by == "difference" else math.nan
    if not math.isfinite(value):
        return cell(math.nan, "missing", f"{name} has no such figure: {texts[2]}")
    sign = 1 if bad > good else -1
    grade: Grade = (
        "holds" if sign * value <= sign * good else "fails" if sign * value >= sign * bad else "degrades"
    )
    return cell(value, grade, texts[0])


def _figure(results: pd.DataFrame, at: dict[str, Any], place: tuple[str, str], wrong: Any) -> float:
    """The one figure that a selection means; NaN where no row meets it.

    Keys that are left out are free, but the variant: left out, it is empty, unless no such row is there.
    """
    for key in at:
        if key not in KEYS:
            raise wrong(
                f"cell {place[0]}/{place[1]}: at has an unknown key {key!r}; allowed: {', '.join(KEYS)}"
            )
    rows = results[results["value"].notna()]
    for key, wanted in at.items():
        rows = rows[rows[key] == str(wanted)]
    if "variant" not in at and len(rows) > 1:
        rows = rows[rows["variant"] == ""]
    if len(rows) > 1:
        raise wrong(
            f"cell {place[0]}/{place[1]}: {len(rows)} rows of {at} are meant; name "
            f"{', '.join(key for key in KEYS if key not in at and len(set(rows[key])) > 1) or 'more'}"
        )
    return float(rows["value"].iloc[0]) if len(rows) else math.nan


def as_results(matrix: Matrix) -> pd.DataFrame:
    """The matrix as rows of ``results.csv``: the figure of each cell, its failure as the variant."""
    rows = []
    for cell in matrix.cells:
        if math.isfinite(cell.value):
            rows.append({
                "scene": "all", "method": cell.row, "variant": f"failure={cell.column},report={cell.report}",
                "budget": "", "device": "", "split": "", "component": "", "metric": cell.metric,
                "value": cell.value, "n": 1, "seeds": 1,
            })  # fmt: skip
    return pd.DataFrame(rows, columns=COLUMNS)

"""Line charts over a setting of the methods, as figures of papers have them: error over the size of a basis.

A table's YAML lists them; each becomes ``<file>.svg`` and ``<file>.png`` in the report folder::

    curves:
      - file: error
        x: basis                          # the part of the variant `basis=16`
        y: [rmse/indirect, rmse/bound/indirect]       # plain, dashed, dotted; also costs, as time/shade
        split: same
        log: [x, y]
        group: scene                      # what a colour stands for: scene, method or a part of the variant
        panels: none                      # none: all lines in one; scene: one panel a scene
        where: {lambda: 0.01}             # only these: a value, a list, null; also scene, method, denoised
        title: Figure 14
        labels: {x: basis vectors, rmse/bound/indirect: projected}    # x, y, or a line style

Here the list is read and its figures are found in ``results.csv``; ``curve_charts`` draws them.
"""

import dataclasses
import math
import re
from typing import Any

import pandas as pd

from prt.bench.chart import Axis
from prt.bench.layout import Layout
from prt.bench.results import DENOISED, measured_once, variant_tokens
from prt.bench.where import Where, listed, meets, read_where
from prt.errors import PrtError

KEYS = ("file", "x", "y", "split", "log", "group", "panels", "where", "title", "labels")
#: of the first metric, the second, the third
LINE_STYLES = ["-", "--", ":"]
#: names that the report's own files have
TAKEN = ("chart", "figure")


@dataclasses.dataclass(frozen=True)
class Curve:
    """One line chart, checked."""

    file: str
    x: str  #: name of a part of the variants
    y: tuple[Axis, ...]
    split: str  #: empty for the table's first
    log: tuple[str, ...]
    group: str
    panels: bool  #: one a scene
    where: Where
    title: str
    labels: dict[str, str]

    def name(self, axis: Axis) -> str:
        """One of ``y`` in a legend."""
        return self.labels.get(axis_key(axis), axis.label)


def axis_key(axis: Axis) -> str:
    """An axis as the YAML writes it."""
    return f"{axis.metric}/{axis.component}" if axis.component else axis.metric


@dataclasses.dataclass
class Line:
    """The figures of one metric over x, of one scene, method and rest of the variant."""

    place: dict[str, str]  #: scene, method, and the parts of the variant other than x
    style: int  #: which of ``Curve.y``
    measured: list[tuple[float, float, float, float]]  #: x, value, lo, hi, by x; NaN without an interval
    published: list[tuple[float, float]]


def parse_curves(given: Any) -> list[Curve]:
    """The ``curves`` of a table's YAML.

    Raises:
        PrtError: for an unknown key or value, a missing one, or a file named twice.
    """
    if not isinstance(given, list) or not all(isinstance(entry, dict) for entry in given):
        raise PrtError("curves must be a list of {file: ..., x: ..., y: ...}")
    found = [_parse(entry) for entry in given]
    for i, curve in enumerate(found):
        if curve.file in [other.file for other in found[:i]]:
            raise PrtError(f"curves: two are written to file {curve.file!r}; name one of them otherwise")
    return found


def _parse(entry: dict[str, Any]) -> Curve:
    file = str(entry.get("file", ""))

    def wrong(what: str) -> PrtError:
        return PrtError(f"curves, file {file!r}: {what}")

    for key in entry:
        if key not in KEYS:
            raise wrong(f"unknown key {key!r}; allowed: {', '.join(KEYS)}")
    if not re.fullmatch(r"[\w-]+", file) or file in TAKEN:
        raise wrong("file must be a plain name without folder and ending, and not chart or figure")
    if not entry.get("x") or not entry.get("y"):
        raise wrong("x (as basis) and y (as rmse/indirect) must be given")
    try:
        y = tuple(Axis.parse(str(text)) for text in listed(entry["y"]))
    except PrtError as error:
        raise wrong(f"y: {str(error).removeprefix('chart: ')}") from error
    if len(y) > len(LINE_STYLES):
        raise wrong(f"y has {len(y)} metrics; at most {len(LINE_STYLES)} can be told apart")
    log = tuple(str(name) for name in listed(entry.get("log") or []))
    if not set(log) <= {"x", "y"}:
        raise wrong(f"log={list(log)} may hold x and y")
    group = str(entry.get("group") or "method")
    panels = str(entry.get("panels") or ("none" if group == "scene" else "scene"))
    if panels not in ("none", "scene"):
        raise wrong(f"panels={panels!r} is not one of none, scene")
    for key in ("where", "labels"):
        if not isinstance(entry.get(key) or {}, dict):
            raise wrong(f"{key} must be pairs, as {{lambda: 0.01}}")
    where = read_where(entry.get("where"))
    labels = {str(k): str(v) for k, v in (entry.get("labels") or {}).items()}
    return Curve(
        file, str(entry["x"]), y, str(entry.get("split") or ""), log, group, panels == "scene", where,
        str(entry.get("title") or ""), labels,
    )  # fmt: skip


def lines(results: pd.DataFrame, layout: Layout, curve: Curve, split: str) -> list[Line]:
    """The lines of a curve, in the order of the layout's scenes and methods.

    Args:
        split: the one that is meant where the curve names none; empty for a benchmark.

    Raises:
        PrtError: if ``x`` has values that are no numbers.
    """
    found: dict[tuple, Line] = {}
    for style, axis in enumerate(curve.y):
        rows = results[(results["metric"] == axis.metric) & (results["component"] == axis.component)]
        places = ["", curve.split or split] if measured_once(axis.metric) else [curve.split or split]
        known = set(rows["split"])
        place = next((p for p in places if p in known), "")
        for row in rows[rows["split"] == place].to_dict("records"):
            tokens = variant_tokens(row["variant"])
            if curve.x not in tokens or not _shown(row, tokens, layout, curve):
                continue
            x = _number(tokens.pop(curve.x), curve)
            of = {"scene": row["scene"], "method": row["method"], **tokens}
            line = found.setdefault((style, *of.items()), Line(of, style, [], []))
            value, lo, hi = (float(row[name]) * axis.scale for name in ("value", "lo", "hi"))
            if math.isfinite(value):
                line.measured.append((x, value, lo, hi))
            if row["published"] == row["published"] and row["published"] is not None:
                line.published.append((x, float(row["published"]) * axis.scale))
    methods = [method for method, _ in layout.methods]
    kept = [line for line in found.values() if line.measured or line.published]
    for line in kept:
        line.measured.sort()
        line.published.sort()
    return sorted(
        kept,
        key=lambda o: (layout.scenes.index(o.place["scene"]), methods.index(o.place["method"]), o.style),
    )


def _shown(row: dict, tokens: dict[str, str], layout: Layout, curve: Curve) -> bool:
    plain = ",".join(t for t in row["variant"].split(",") if t != DENOISED)
    if row["scene"] not in layout.scenes or (row["method"], plain) not in layout.methods:
        return False
    own = {"scene": row["scene"], "method": row["method"], **tokens, DENOISED: str(DENOISED in tokens)}
    return meets(own, {DENOISED: ["False"], **curve.where})


def _number(text: str, curve: Curve) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise PrtError(
            f"curves, file {curve.file!r}: x: {curve.x}={text} is no number; leave it out with `where`"
        ) from error

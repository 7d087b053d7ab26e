"""Line charts drawn and written (:mod:`prt.bench.curves` says which): a colour a group, a dash a metric.

Bands are the 95 % intervals of ``results.csv``, stars the published numbers. The same figures give the same
bytes, and charts that the YAML no longer lists are removed.
"""

import itertools
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from prt.bench.chart import COLOURS, MARKERS, STYLE, label_log, legend_width, write
from prt.bench.curves import LINE_STYLES, Curve, Line, axis_key, lines
from prt.bench.hover import HoverFigure, says
from prt.bench.layout import Layout, split_name
from prt.bench.results import measured_once

#: stands in every SVG written here, so that one no longer listed is known as ours and removed
MARK = "prt curves"
#: of a title that surely fit into an inch
TITLE_CHARACTERS = 14
#: more different x than this get the usual ticks
TICKS = 10


def draw(results: pd.DataFrame, layout: Layout, curve: Curve, split: str = "") -> HoverFigure | None:
    """One line chart, or None where no figures have this x and y; ``split`` as for :func:`lines`."""
    import matplotlib

    found = lines(results, layout, curve, split)
    if not found:
        return None
    scenes = list(dict.fromkeys(line.place["scene"] for line in found)) if curve.panels else [""]
    columns = min(len(scenes), 3)
    rows = math.ceil(len(scenes) / columns)
    looks = Looks(found, layout, curve)
    with matplotlib.rc_context(STYLE):
        beside, across = looks.legend(), 2.9 * columns if curve.panels else 3.5
        size = (across + legend_width(beside), 2.5 * rows + 0.4 if curve.panels else 3.2)
        figure = HoverFigure(figsize=size, layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for axis, scene in zip(axes, scenes, strict=False):
            here = [o for o in found if not scene or o.place["scene"] == scene]
            _panel(axis, here, looks, curve)
            for line in here:
                where = f", {layout.label(scene)}" if scene else ""
                _name_points(figure, axis, line, looks.name(line) + where, curve)
            if scene:
                axis.set_title(
                    layout.label(scene), loc="left", fontsize=9, fontweight="bold", color="#222222"
                )
        for axis in axes[len(scenes) :]:
            axis.set_visible(False)
        for i in range(len(scenes)):
            if i + columns >= len(scenes):
                axes[i].tick_params(labelbottom=True)
                axes[i].set_xlabel(curve.labels.get("x", curve.x.replace("_", " ")), fontsize=8.5)
        name = curve.labels.get("y", curve.y[0].label)
        judged = curve.split or split
        seen = judged and not all(measured_once(axis.metric) for axis in curve.y)
        for i in range(0, len(scenes), columns):
            axes[i].set_ylabel(f"{name}, {split_name(judged)}" if seen else name, fontsize=8.5)
        figure.legend(handles=beside, loc="outside right upper", frameon=False, fontsize=8)
        if curve.title:
            # over the panels alone: the legend begins at the same height
            title = "\n".join(textwrap.wrap(curve.title, int(TITLE_CHARACTERS * across)))
            figure.suptitle(title, fontsize=9, color="#222222", x=0.01, ha="left")
    return figure


class Looks:
    """Colour, marker and name of every line: the colour says the group, the marker what else differs."""

    def __init__(self, found: list[Line], layout: Layout, curve: Curve):
        self.found, self.layout, self.curve = found, layout, curve
        names = dict.fromkeys(name for line in found for name in line.place)
        differing = [n for n in names if len({line.place.get(n) for line in found}) > 1]
        self.rest = [n for n in differing if n != curve.group and not (n == "scene" and curve.panels)]
        self.groups = list(dict.fromkeys(line.place.get(curve.group, "") for line in found))
        self.rests = list(dict.fromkeys(map(self._rest, found)))

    def _rest(self, line: Line) -> tuple[str, ...]:
        return tuple(line.place.get(name, "") for name in self.rest)

    def of(self, line: Line) -> tuple[str, str]:
        """Colour and marker."""
        group = self.groups.index(line.place.get(self.curve.group, ""))
        rest = self.rests.index(self._rest(line))
        # more groups than colours: the same colour comes again with another marker
        turn = group + group // len(COLOURS) if len(self.rests) == 1 else rest + group // len(COLOURS)
        return COLOURS[group % len(COLOURS)], MARKERS[turn % len(MARKERS)]

    def name(self, line: Line) -> str:
        parts = [self._word(name, line) for name in (self.curve.group, *self.rest)]
        return ", ".join(filter(None, parts)) or self.layout.label(line.place["method"])

    def _word(self, name: str, line: Line) -> str:
        value = line.place.get(name, "")
        if name in ("scene", "method"):
            return self.layout.label(value)
        return f"{name}={value}" if value else name if name in line.place else ""

    def legend(self) -> list[Line2D]:
        handles = {}
        for line in self.found:
            colour, marker = self.of(line)
            handles.setdefault(self.name(line), Line2D([], [], color=colour, marker=marker, ms=4.5, lw=1.4))
        for name, handle in handles.items():
            handle.set_label(name)
        grey = {"color": "#777777"}
        styles = [
            Line2D([], [], **grey, lw=1.4, ls=LINE_STYLES[i], label=self.curve.name(axis))
            for i, axis in enumerate(self.curve.y)
        ]
        published = any(line.published for line in self.found)
        star = Line2D([], [], **grey, marker="*", ls="", ms=9, mfc="white", label="published")
        return [*handles.values(), *(styles if len(styles) > 1 else []), *([star] if published else [])]


def readable(values: list[float]) -> bool:
    """Whether labels at all of these positive values stand apart on a logarithmic axis."""
    if not values or values[0] <= 0:
        return False
    span = math.log(values[-1] / values[0])
    gaps = [math.log(b / a) for a, b in itertools.pairwise(values)]
    return len(values) <= TICKS and all(gap >= span / TICKS for gap in gaps)


def _panel(axis: Axes, found: list[Line], looks: Looks, curve: Curve) -> None:
    from matplotlib.ticker import FixedLocator, NullLocator

    if "x" in curve.log:
        axis.set_xscale("log")
    if "y" in curve.log:
        axis.set_yscale("log", nonpositive="clip")
    for line in found:
        colour, marker = looks.of(line)
        x, value, lo, hi = (
            (list(column) for column in zip(*line.measured, strict=True)) if line.measured else [[]] * 4
        )
        axis.plot(x, value, color=colour, ls=LINE_STYLES[line.style], lw=1.4, marker=marker, ms=4.5, mew=1.1,
                  mfc=colour if line.style == 0 else "white", zorder=3)  # fmt: skip
        # many bands over each other would be one grey
        axis.fill_between(x, lo, hi, color=colour, alpha=min(0.15, 0.3 / len(found)), lw=0, zorder=1)
        axis.plot([x for x, _ in line.published], [y for _, y in line.published], color=colour, ls="",
                  marker="*", ms=9, mfc=colour if line.style == 0 else "white", zorder=4)  # fmt: skip
    if "y" in curve.log:
        label_log(axis.yaxis)
    if "x" in curve.log:
        label_log(axis.xaxis)
        values = sorted({p[0] for line in looks.found for p in [*line.measured, *line.published]})
        if readable(values):
            axis.xaxis.set_major_locator(FixedLocator(values))
            axis.xaxis.set_minor_locator(NullLocator())
    axis.grid(True, which="major", color="#e6e6e6", lw=0.6)
    axis.set_axisbelow(True)


def _name_points(figure: HoverFigure, axis: Axes, line: Line, name: str, curve: Curve) -> None:
    """Let every point of a line say what it is."""
    across = curve.labels.get("x", curve.x.replace("_", " "))
    what = curve.name(curve.y[line.style])
    for x, value, lo, hi in line.measured:
        figure.point(axis, x, value, says(name, [(what, value, lo, hi), (across, x, math.nan, math.nan)]))
    for x, value in line.published:
        plain = [(what, value, math.nan, math.nan), (across, x, math.nan, math.nan)]
        figure.point(axis, x, value, says(f"{name}, published", plain))


def write_all(
    curves: Sequence[Curve], results: pd.DataFrame, layout: Layout, folder: Path, split: str = ""
) -> list[str]:
    """Write every curve that has figures, remove earlier ones; returns notes of those that have none."""
    remove_old(folder)
    notes = []
    for curve in curves:
        figure = draw(results, layout, curve, split)
        if figure is None:
            wanted = " or ".join(map(axis_key, curve.y))
            notes.append(f"no curves {curve.file}: no results have {curve.x}=... and {wanted}")
        else:
            write(figure, folder, curve.file, MARK)
    return notes


def remove_old(folder: Path) -> None:
    """Remove what :func:`write_all` left in the folder, whatever it was called, and nothing else."""
    for path in folder.glob("*.svg"):
        if MARK in path.read_text(errors="replace")[:2000]:
            path.unlink()
            path.with_suffix(".png").unlink(missing_ok=True)


def markdown(curves: Sequence[Curve], folder: Path) -> list[str]:
    """The curves that were written, for report.md."""
    written = [curve for curve in curves if (folder / f"{curve.file}.svg").exists()]
    return [f"![{curve.title or curve.file}]({curve.file}.svg)" for curve in written]

"""The speed-accuracy chart: one panel a scene, one colour and marker a method, the Pareto front drawn.

Variants of one method share its look, joined by a thin line in the order of x: the ladder of its capacity.
Which way is better comes from the metric's own definition, never from here.
"""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.lines import Line2D

from prt.bench.hover import HoverFigure, says
from prt.bench.layout import Layout, metric_name, split_name
from prt.bench.results import DENOISED, direction_of, is_cost, join_variant, measured_once, variant_tokens
from prt.bench.where import meets, read_where
from prt.errors import PrtError
from prt.metrics.diagnostics import diagnostic_of
from prt.metrics.registry import METRICS
from prt.savefig import save_png

#: Okabe and Ito's colours, told apart under all common colour-vision deficiencies
COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
MARKERS = ["o", "s", "^", "D", "v", "P", "X"]
#: identical SVG from identical data
STYLE = {
    "font.family": "DejaVu Sans", "font.size": 8.5, "axes.spines.top": False, "axes.spines.right": False,
    "axes.linewidth": 0.7, "axes.edgecolor": "#555555", "xtick.color": "#555555", "ytick.color": "#555555",
    "axes.labelcolor": "#222222", "svg.hashsalt": "prt",
}  # fmt: skip
AXIS_NAMES = {
    "time/frame": "time per frame", "time/shade": "time to shade a frame",
    "time/light": "time per new lighting",
    "time/fit": "fitting time", "time/bake": "baking time", "bytes/model": "model size",
}  # fmt: skip


@dataclass(frozen=True)
class Axis:
    """A metric, and its component where it has one: ``psnr/indirect``, ``time/frame``."""

    metric: str
    component: str

    @classmethod
    def parse(cls, text: str) -> "Axis":
        """Read an axis.

        Raises:
            PrtError: for a metric nobody defines, or one without its component.
        """
        if is_cost(text):
            return cls(text, "")
        metric, _, component = text.rpartition("/")
        known = metric.partition("/")[0] in METRICS or diagnostic_of(metric) is not None
        if not known or component not in ("full", "direct", "indirect"):
            raise PrtError(
                f"chart: {text!r} is not an axis; write time/frame, psnr/indirect or psnr/fit/indirect"
            )
        return cls(metric, component)

    @property
    def label(self) -> str:
        """For people, with the unit."""
        name, unit = metric_name(self.metric)
        if is_cost(self.metric):
            name = AXIS_NAMES.get(self.metric, f"time to {self.metric.partition('/')[2].replace('_', ' ')}")
            unit = self._cost_unit
        name += f", {self.component}" if self.component else ""
        return f"{name} ({unit})" if unit else name

    @property
    def scale(self) -> float:
        """From the figures of results.csv to those of the axis."""
        return {"MB": 1e-6, "s": 1.0, "ms": 1e3}[self._cost_unit] if is_cost(self.metric) else 1.0

    @property
    def _cost_unit(self) -> str:
        if self.metric.startswith("bytes/"):
            return "MB"
        return "s" if self.metric in ("time/fit", "time/bake") else "ms"


@dataclass(frozen=True)
class Point:
    """One method on one scene: position, error bars, and whether its images were denoised."""

    scene: str
    method: str
    variant: str
    denoised: bool
    x: float
    y: float
    x_hi: float
    y_lo: float
    y_hi: float


def points(results: pd.DataFrame, layout: Layout, x: Axis, y: Axis, split: str) -> list[Point]:
    """Every (scene, method, denoising) that has both figures."""
    keys = ["scene", "method", "variant", "split", "component", "metric"]
    table = results[results["value"].notna()].drop_duplicates(keys).set_index(keys)
    found = []
    for scene in layout.scenes:
        for method, variant in layout.methods:
            for token in layout.tokens(method):
                full = join_variant(variant, token)
                ends = []
                for axis in (x, y):
                    place = "" if measured_once(axis.metric) else split
                    # a cost that denoising does not touch is listed once, without it
                    for name in (full, variant):
                        key = (scene, method, name, place, axis.component, axis.metric)
                        if key in table.index:
                            ends.append(table.loc[key])
                            break
                        if axis.component:
                            break
                if len(ends) == 2:
                    a, b = ends
                    figures = [float(v) for v in (a["value"], b["value"], a["hi"], b["lo"], b["hi"])]
                    if math.isfinite(figures[0]) and figures[0] > 0 and math.isfinite(figures[1]):
                        found.append(Point(scene, method, variant, bool(token), *figures))
    return found


def ladders(found: list[Point]) -> dict[tuple[str, str, bool], list[Point]]:
    """The points of every method with several variants, by (scene, method, denoised), in the order of x."""
    groups: dict[tuple[str, str, bool], list[Point]] = {}
    for point in found:
        groups.setdefault((point.scene, point.method, point.denoised), []).append(point)
    return {key: sorted(rungs, key=lambda p: p.x) for key, rungs in groups.items() if len(rungs) > 1}


def varying(variants: list[str]) -> list[str]:
    """Names of the tokens in which variants differ."""
    tokens = [variant_tokens(variant) for variant in variants]
    names = dict.fromkeys(name for own in tokens for name in own)
    return [name for name in names if len({own.get(name) for own in tokens}) > 1]


def rung_name(variant: str, changing: list[str]) -> str:
    """A variant by what changes from one to the next: ``16`` of ``basis=16``."""
    own = variant_tokens(variant)
    return ", ".join(own.get(name, "–") for name in changing)


def pareto(found: list[Point], x_better: str, y_better: str) -> list[Point]:
    """The points that no other beats on both axes, from the best x on."""
    sx, sy = (1 if way == "higher" else -1 for way in (x_better, y_better))
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (-sx * p.x, -sy * p.y)):
        if not front or sy * point.y > sy * front[-1].y:
            front.append(point)
    return front


def draw(results: pd.DataFrame, layout: Layout, settings: dict, note: str = "") -> HoverFigure | None:
    """The chart, or None where no method has both figures.

    Args:
        settings: ``x`` (``time/frame``), ``y`` (``psnr/indirect``), ``split`` (``far``),
            ``target`` (a value of y, drawn as a line), ``where`` (which variants, :mod:`prt.bench.where`).
        note: one line under the chart: device and threads.
    """
    import matplotlib

    x, y = Axis.parse(settings.get("x", "time/frame")), Axis.parse(settings.get("y", "psnr/indirect"))
    split = settings.get("split", layout.splits[0])
    where = read_where(settings.get("where"))
    found = [
        p
        for p in points(results, layout, x, y, split)
        if meets({"scene": p.scene, "method": p.method, **variant_tokens(p.variant)}, where)
    ]
    scenes = [scene for scene in layout.scenes if any(p.scene == scene for p in found)]
    if not scenes:
        return None
    columns = min(len(scenes), 3)
    rows = math.ceil(len(scenes) / columns)
    methods = list(dict.fromkeys(method for method, _ in layout.methods))
    looks = {m: (COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]) for i, m in enumerate(methods)}
    with matplotlib.rc_context(STYLE):
        handles = _legend(found, looks, layout)
        size = (2.9 * columns + legend_width(handles), 2.5 * rows + 0.75)
        figure = HoverFigure(figsize=size, layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for axis, scene in zip(axes, scenes, strict=False):
            here = [p for p in found if p.scene == scene]
            _panel(axis, here, looks, x, y)
            if settings.get("target") is not None:
                level = float(settings["target"]) * y.scale
                axis.axhline(level, color="#333333", lw=0.9, ls=(0, (1, 2)), zorder=1)
                axis.annotate("target", (0.99, level), xycoords=("axes fraction", "data"), ha="right",
                              va="bottom", fontsize=6.5, color="#333333")  # fmt: skip
            for p in here:
                figure.point(axis, p.x * x.scale, p.y * y.scale, _title(p, layout, x, y))
            axis.set_title(layout.label(scene), loc="left", fontsize=9, fontweight="bold", color="#222222")
        for axis in axes[len(scenes) :]:
            axis.set_visible(False)
        for i in range(len(scenes)):
            if i + columns >= len(scenes):
                axes[i].tick_params(labelbottom=True)
                axes[i].set_xlabel(x.label, fontsize=8.5)
        for i in range(0, len(scenes), columns):
            axes[i].set_ylabel(f"{y.label}, {split_name(split)}", fontsize=8.5)
        figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize=8)
        if note:
            width, height = figure.get_size_inches()
            lines = textwrap.wrap(note, int(width * 20))
            below = (0.05 + 0.12 * len(lines)) / height
            figure.text(
                0.05 / width, 0.05 / height, "\n".join(lines), va="bottom", fontsize=6.5, color="#777777"
            )
            figure.get_layout_engine().set(rect=(0, below, 1, 1 - below))
    return figure


def _title(p: Point, layout: Layout, x: Axis, y: Axis) -> str:
    """What a point says of itself."""
    name = layout.method_label(p.method, p.variant, DENOISED if p.denoised else "")
    across = [v * x.scale for v in (p.x, math.nan, p.x_hi if is_cost(x.metric) else math.nan)]
    return says(
        f"{name}, {layout.label(p.scene)}",
        [(y.label, *(v * y.scale for v in (p.y, p.y_lo, p.y_hi))), (x.label, *across)],
    )


def _panel(axis: Axes, found: list[Point], looks: dict, x: Axis, y: Axis) -> None:
    by, up, better = x.scale, y.scale, (direction_of(x.metric), direction_of(y.metric))
    front = pareto(found, *better)
    where = "post" if better[0] == "lower" else "pre"
    axis.step([p.x * by for p in front], [p.y * up for p in front], where=where, color="#999999", lw=1,
              ls=(0, (4, 2)), zorder=1)  # fmt: skip
    for (_, method, _), rungs in ladders(found).items():
        axis.plot(
            [p.x * by for p in rungs], [p.y * up for p in rungs], color=looks[method][0], lw=0.8, alpha=0.7,
            zorder=2,
        )  # fmt: skip
        changing = varying([p.variant for p in rungs])
        plain = {p.variant for p in found if p.method == method and not p.denoised}
        for p in rungs:
            if p.denoised and p.variant in plain:
                continue  # stands over or under the one that has the label
            axis.annotate(rung_name(p.variant, changing), (p.x * by, p.y * up), xytext=(4, 4),
                          textcoords="offset points", fontsize=6.5, color="#555555")  # fmt: skip
    for p in found:
        colour, marker = looks[p.method]
        reach = [[0], [max(p.x_hi - p.x, 0) * by]] if p.x_hi == p.x_hi else None
        # a cost has no lower end
        low = p.y_lo if p.y_lo == p.y_lo else p.y
        spread = [[(p.y - low) * up], [max(p.y_hi - p.y, 0) * up]] if p.y_hi == p.y_hi else None
        axis.errorbar(
            p.x * by, p.y * up, xerr=reach, yerr=spread, fmt=marker, ms=6, mew=1.3, color=colour,
            elinewidth=0.9, mfc=colour if p.denoised else "white", mec=colour, capsize=0, zorder=3,
        )  # fmt: skip
    axis.set_xscale("log")
    axis.margins(x=0.15, y=0.2)
    label_log(axis.xaxis)
    axis.grid(True, which="major", color="#e6e6e6", lw=0.6)
    axis.set_axisbelow(True)
    _better_arrow(axis, *better)


def legend_width(handles: Sequence[Line2D]) -> float:
    """Inches that a legend beside the panels surely fits into (8 point type)."""
    longest = max((len(str(handle.get_label())) for handle in handles), default=0)
    return max(2.1, 0.6 + 0.066 * longest)


def label_log(axis: XAxis | YAxis) -> None:
    """Plain numbers along a logarithmic axis, as many as can be read beside each other."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = sorted(axis.get_view_interval())
    decades = math.log10(high / low) if low > 0 else 9.0
    subs = (
        (1.0,) if decades > 2.2 else (1.0, 2.0, 5.0) if decades > 0.8 else (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    )
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_formatter(NullFormatter())


def _better_arrow(axis: Axes, x_better: str, y_better: str) -> None:
    """An arrow in the corner where a method wants to be."""
    right, up = x_better == "higher", y_better == "higher"
    tip = (0.975 if right else 0.025, 0.975 if up else 0.025)
    tail = (tip[0] + (-0.085 if right else 0.085), tip[1] + (-0.11 if up else 0.11))
    arrow = {"arrowstyle": "-|>", "color": "#777777", "lw": 1, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", tip, tail, xycoords="axes fraction", textcoords="axes fraction", arrowprops=arrow)
    axis.text(tail[0] + (-0.01 if right else 0.01), tail[1], "better", transform=axis.transAxes, fontsize=7,
              color="#777777", style="italic", ha="right" if right else "left", va="center")  # fmt: skip


def _legend(found: list[Point], looks: dict, layout: Layout) -> list[Line2D]:
    handles = []
    for method, (colour, marker) in looks.items():
        variants = list(dict.fromkeys(p.variant for p in found if p.method == method))
        if variants:
            label = layout.method_label(method, ", ".join(varying(variants)) or variants[0])
            handles.append(Line2D([], [], color=colour, marker=marker, ls="", ms=6, mew=1.3, label=label))
    grey = {"color": "#777777", "marker": "o", "ls": "", "ms": 6, "mew": 1.3}
    if any(p.denoised for p in found):
        handles.append(Line2D([], [], **grey, label="denoised after it"))
        handles.append(Line2D([], [], **grey, mfc="white", label="as the method renders"))
    handles.append(Line2D([], [], color="#999999", lw=1, ls=(0, (4, 2)), label="Pareto front"))
    return handles


def write(figure: HoverFigure, folder: Path, name: str = "chart", creator: str | None = None) -> None:
    """``<name>.svg`` and ``<name>.png``; the same bytes for the same figures.

    Args:
        creator: what the SVG says it was made by; matplotlib's own words where nothing is given.
    """
    import matplotlib

    with matplotlib.rc_context(STYLE):
        figure.save_svg(
            folder / f"{name}.svg", metadata={"Date": None, **({"Creator": creator} if creator else {})}
        )
        save_png(figure, folder / f"{name}.png", dpi=170)

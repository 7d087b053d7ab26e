"""The speed-accuracy chart: one panel a scene, one colour and marker a method, the Pareto front drawn.

Which way is better comes from the metric's own definition, never from here.
"""

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from prt.bench.layout import Layout
from prt.bench.results import direction_of, join_variant
from prt.errors import PrtError
from prt.metrics.registry import METRICS

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
    "time/fit": "fitting time", "bytes/model": "model size",
}  # fmt: skip


@dataclass(frozen=True)
class Axis:
    """A metric, and its component where it has one: ``psnr/indirect``, ``time/frame``."""

    metric: str
    component: str

    @classmethod
    def parse(cls, text: str) -> "Axis":
        if text.startswith(("time/", "bytes/")):
            return cls(text, "")
        metric, _, component = text.rpartition("/")
        if metric not in METRICS or component not in ("full", "direct", "indirect"):
            raise PrtError(f"chart: {text!r} is not an axis; write time/frame or psnr/indirect")
        return cls(metric, component)

    @property
    def label(self) -> str:
        if not self.component:
            return AXIS_NAMES.get(self.metric, self.metric)
        known = METRICS[self.metric]
        return f"{known.label}, {self.component}" + (f" ({known.unit})" if known.unit else "")


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
                    place = "" if not axis.component else split
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


def pareto(found: list[Point], x_better: str, y_better: str) -> list[Point]:
    """The points that no other beats on both axes, from the best x on."""
    sx, sy = (1 if way == "higher" else -1 for way in (x_better, y_better))
    front: list[Point] = []
    for point in sorted(found, key=lambda p: (-sx * p.x, -sy * p.y)):
        if not front or sy * point.y > sy * front[-1].y:
            front.append(point)
    return front


def draw(results: pd.DataFrame, layout: Layout, settings: dict, note: str = "") -> Figure | None:
    """The chart, or None where no method has both figures.

    Args:
        settings: ``x`` (``time/frame``), ``y`` (``psnr/indirect``), ``split`` (``far``).
        note: one line under the chart: device and threads.
    """
    import matplotlib

    x, y = Axis.parse(settings.get("x", "time/frame")), Axis.parse(settings.get("y", "psnr/indirect"))
    split = settings.get("split", layout.splits[0])
    found = points(results, layout, x, y, split)
    scenes = [scene for scene in layout.scenes if any(p.scene == scene for p in found)]
    if not scenes:
        return None
    columns = min(len(scenes), 3)
    rows = math.ceil(len(scenes) / columns)
    looks = {m: (COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]) for i, m in enumerate(layout.methods)}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.9 * columns + 2.1, 2.5 * rows + 0.75), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for axis, scene in zip(axes, scenes, strict=False):
            _panel(axis, [p for p in found if p.scene == scene], looks, x, y)
            axis.set_title(layout.label(scene), loc="left", fontsize=9, fontweight="bold", color="#222222")
        for axis in axes[len(scenes) :]:
            axis.set_visible(False)
        for i in range(len(scenes)):
            if i + columns >= len(scenes):
                axes[i].tick_params(labelbottom=True)
                axes[i].set_xlabel(f"{x.label} ({_scale_name(x)})", fontsize=8.5)
        for i in range(0, len(scenes), columns):
            axes[i].set_ylabel(f"{y.label}, {split} views", fontsize=8.5)
        figure.legend(
            handles=_legend(found, looks, layout), loc="outside right upper", frameon=False, fontsize=8
        )
        if note:
            width, height = figure.get_size_inches()
            lines = textwrap.wrap(note, int(width * 20))
            below = (0.05 + 0.12 * len(lines)) / height
            figure.text(
                0.05 / width, 0.05 / height, "\n".join(lines), va="bottom", fontsize=6.5, color="#777777"
            )
            figure.get_layout_engine().set(rect=(0, below, 1, 1 - below))
    return figure


def _scale_name(axis: Axis) -> str:
    return "MB" if axis.metric.startswith("bytes/") else "s" if axis.metric == "time/fit" else "ms"


def _scale(axis: Axis) -> float:
    return {"MB": 1e-6, "s": 1.0, "ms": 1e3}[_scale_name(axis)] if not axis.component else 1.0


def _panel(axis: Axes, found: list[Point], looks: dict, x: Axis, y: Axis) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    by, better = _scale(x), (direction_of(x.metric), direction_of(y.metric))
    front = pareto(found, *better)
    where = "post" if better[0] == "lower" else "pre"
    axis.step(
        [p.x * by for p in front],
        [p.y for p in front],
        where=where,
        color="#999999",
        lw=1,
        ls=(0, (4, 2)),
        zorder=1,
    )
    for p in found:
        colour, marker = looks[p.method, p.variant]
        reach = [[0], [max(p.x_hi - p.x, 0) * by]] if p.x_hi == p.x_hi else None
        spread = [[p.y - p.y_lo], [p.y_hi - p.y]] if p.y_hi == p.y_hi else None
        axis.errorbar(
            p.x * by, p.y, xerr=reach, yerr=spread, fmt=marker, ms=6, mew=1.3, color=colour, elinewidth=0.9,
            mfc=colour if p.denoised else "white", mec=colour, capsize=0, zorder=3,
        )  # fmt: skip
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.margins(x=0.15, y=0.2)
    axis.grid(True, which="major", color="#e6e6e6", lw=0.6)
    axis.set_axisbelow(True)
    _better_arrow(axis, *better)


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
    for (method, variant), (colour, marker) in looks.items():
        if any((p.method, p.variant) == (method, variant) for p in found):
            label = layout.method_label(method, variant)
            handles.append(Line2D([], [], color=colour, marker=marker, ls="", ms=6, mew=1.3, label=label))
    grey = {"color": "#777777", "marker": "o", "ls": "", "ms": 6, "mew": 1.3}
    if any(p.denoised for p in found):
        handles.append(Line2D([], [], **grey, label="denoised after it"))
        handles.append(Line2D([], [], **grey, mfc="white", label="as the method renders"))
    handles.append(Line2D([], [], color="#999999", lw=1, ls=(0, (4, 2)), label="Pareto front"))
    return handles


def write(figure: Figure, folder: Path) -> None:
    """``chart.svg`` and ``chart.png``; the same bytes for the same figures."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        figure.savefig(folder / "chart.svg", metadata={"Date": None})
        figure.savefig(folder / "chart.png", dpi=170, metadata={"Software": None})

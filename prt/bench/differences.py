"""What every change of a setting brings: differences to a table's first row, image by image, with intervals.

A table's YAML asks for it::

    differences: {y: psnr/indirect, split: far}

It stands in the place of the speed-accuracy chart, which says little of twenty settings of equal cost.
"""

import textwrap
from typing import Any

import pandas as pd

from prt.bench.chart import COLOURS, STYLE, Axis
from prt.bench.hover import HoverFigure
from prt.bench.layout import Layout, split_name
from prt.bench.results import by_seed, direction_of, image_interval, less
from prt.errors import PrtError
from prt.metrics.intervals import Interval, Verdict, better

#: of a change that makes it better, worse, or neither for sure: its name, colour and marker
LOOKS: dict[Verdict, tuple[str, str, str]] = {
    "holds": ("better", COLOURS[0], "o"), "fails": ("worse", COLOURS[1], "s"),
    "undecided": ("undecided", "#888888", "D"),
}  # fmt: skip


def check(settings: dict[str, Any]) -> None:
    """Raises PrtError without an axis."""
    if "y" not in settings:
        raise PrtError("differences: y is missing; write {y: psnr/indirect, split: far}")
    Axis.parse(str(settings["y"]))


def measured(
    images: pd.DataFrame, plan: Layout, settings: dict[str, Any]
) -> dict[str, list[tuple[str, Interval]]]:
    """By scene, every further row of the table less the first one: its name and the mean difference.

    Rows that were not measured on the images of the first are left out.
    """
    y, split = Axis.parse(str(settings["y"])), str(settings.get("split") or plan.splits[0])
    found: dict[str, list[tuple[str, Interval]]] = {}
    for scene in plan.scenes:
        mine = images[
            (images["scene"] == scene) & (images["split"] == split)
            & (images["metric"] == y.metric) & (images["component"] == y.component)
        ]  # fmt: skip
        rows = {
            key: by_seed(mine[(mine["method"] == key[0]) & (mine["variant"] == key[1])])
            for key in plan.methods
        }
        (first, base), *others = rows.items()
        found[scene] = [
            (
                plan.variant_label(method, variant) or plan.label(method)
                if method == first[0]
                else plan.method_label(method, variant),
                image_interval(less(values, base)),
            )
            for (method, variant), values in others
            if len(values) and values.index.equals(base.index)
        ]
    return {scene: rows for scene, rows in found.items() if rows}


def draw(images: pd.DataFrame, plan: Layout, settings: dict[str, Any]) -> HoverFigure | None:
    """A line a row, a panel a scene; None without anything to compare."""
    import matplotlib

    found = measured(images, plan, settings)
    if not found:
        return None
    y, split = Axis.parse(str(settings["y"])), str(settings.get("split") or plan.splits[0])
    most = max(len(rows) for rows in found.values())
    with matplotlib.rc_context(STYLE):
        figure = HoverFigure(figsize=(3.4 + 3.4 * len(found), 1.1 + 0.34 * most), layout="constrained")
        panels = figure.subplots(1, len(found), squeeze=False)[0]
        for axis, (scene, rows) in zip(panels, found.items(), strict=True):
            axis.axvline(0, color="#555555", lw=0.8)
            for down, (name, interval) in enumerate(rows):
                _, colour, marker = LOOKS[better(interval, direction_of(y.metric))]
                axis.plot([interval.lo, interval.hi], [down, down], color=colour, lw=1.4)
                axis.plot([interval.mean], [down], marker, color=colour, ms=5)
                figure.point(
                    axis, interval.mean, down,
                    f"{name}: {interval.mean:+.3g} [{interval.lo:+.3g}, {interval.hi:+.3g}]",
                )  # fmt: skip
            names = [textwrap.shorten(name.replace(",", ", "), 64, placeholder=" ...") for name, _ in rows]
            axis.set_yticks(range(len(rows)), names, fontsize=7)
            axis.set_ylim(len(rows) - 0.5, -0.5)
            axis.grid(axis="x", color="#e5e5e5", lw=0.6)
            axis.set_axisbelow(True)
            axis.set_title(plan.label(scene), loc="left", fontweight="bold", fontsize=9)
            axis.set_xlabel(f"{y.label}, {split_name(split)}, less that of the first row")
        handles = [
            matplotlib.lines.Line2D([], [], color=colour, marker=marker, ms=5, label=name)
            for name, colour, marker in LOOKS.values()
        ]
        figure.legend(handles=handles, loc="outside lower right", ncols=3, frameon=False, fontsize=7.5)
    return figure

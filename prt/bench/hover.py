"""Charts whose points say what they are: in the SVG a transparent circle with a title lies over each.

Browsers show the title where the pointer rests, and ``prt report`` makes labels of them. Nothing of the
chart's look changes, and the PNG knows nothing of it.
"""

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from prt.cache import write_atomically
from prt.savefig import svg_of

#: points of an SVG to the inch
DPI = 72
#: how near the pointer must come (points)
REACH = 6


class HoverFigure(Figure):
    """A figure that knows what its points are called."""

    def __init__(self, *args: Any, **settings: Any):
        super().__init__(*args, **settings)
        self.titles: list[tuple[Axes, float, float, str]] = []

    def point(self, axis: Axes, x: float, y: float, title: str) -> None:
        """Name the point at (x, y), in the units of the axes."""
        self.titles.append((axis, x, y, title))

    def save_svg(self, path: Path, metadata: dict[str, Any]) -> None:
        """Write the SVG; the same bytes for the same figure."""
        # only now are the axes where they were drawn
        drawn, end, rest = svg_of(self, metadata).rpartition("</svg>")
        write_atomically(path, f"{drawn}{self._circles()}{end}{rest}".encode(), "report=")

    def _circles(self) -> str:
        """What lies over the points, the last one drawn uppermost."""
        lines = []
        for number, (axis, x, y, title) in enumerate(self.titles, start=1):
            right, up = axis.transData.transform((x, y)) * DPI / self.dpi
            if not (math.isfinite(right) and math.isfinite(up)):  # no place on a logarithmic axis
                continue
            down = self.get_size_inches()[1] * DPI - up
            lines.append(
                f'  <circle class="point" id="point_{number}" cx="{right:.2f}" cy="{down:.2f}" r="{REACH}" '
                f'style="fill: none; pointer-events: all"><title>{escape(title)}</title></circle>\n'
            )
        return f' <g id="points">\n{"".join(lines)} </g>\n' if lines else ""


def says(name: str, figures: Sequence[tuple[str, float, float, float]]) -> str:
    """A title: the name, then a line for every (label, value, lo, hi); NaN for an end that is not known."""
    return "\n".join([name, *(f"{label}: {_figure(*numbers)}" for label, *numbers in figures)])


def _figure(value: float, lo: float = math.nan, hi: float = math.nan) -> str:
    if math.isfinite(lo) and math.isfinite(hi):
        return f"{value:.4g} [{lo:.4g}, {hi:.4g}]"
    return f"{value:.4g}, 95th percentile {hi:.4g}" if math.isfinite(hi) else f"{value:.4g}"

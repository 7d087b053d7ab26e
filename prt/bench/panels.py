"""Where in ``figure.png`` each picture and each error map lies: ``figure.json``, written beside it.

With it a page can show any two of them on top of each other without a second copy of a single pixel::

    {"file": "figure.png", "width": 1366, "height": 2943, "error_end": 0.15,
     "rows": [{"label": "Kitchen", "scene": "kitchen", "view": "far00", ..., "psnr": {"NPRT": 21.81}}],
     "panels": [{"row": 0, "column": "Reference", "kind": "picture",
                 "x": 47, "y": 40, "width": 256, "height": 256},
                {"row": 0, "column": "NPRT", "kind": "error", ...}]}

Boxes are in pixels from the top left corner and hold the picture alone, no pixel of its surroundings.
"""

import json
import math
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from prt.cache import write_atomically

#: the column of the pictures that all others are compared with
REFERENCE = "Reference"
#: rounding of positions that are whole pixels
TIE = 1e-3


class PanelFigure(Figure):
    """A figure that remembers which of its axes show what."""

    def __init__(self, *args: Any, **settings: Any):
        super().__init__(*args, **settings)
        self.rows: list[dict[str, Any]] = []
        self.panels: list[tuple[int, str, str, Axes]] = []

    def row(self, **facts: Any) -> None:
        """Begin a row; what of the facts is no number is left out."""
        self.rows.append(_known(facts))

    def panel(self, column: str, kind: str, axis: Axes) -> None:
        """Say that ``axis`` shows the ``picture`` or the ``error`` of a column, in the row begun last."""
        self.panels.append((len(self.rows) - 1, column, kind, axis))

    def write_boxes(self, picture: Path, dpi: float, **facts: Any) -> None:
        """Write the boxes beside ``picture``, a PNG of this figure that was saved just now at ``dpi``."""
        width, height = png_size(picture.read_bytes()[:24])
        inches = self.get_size_inches()
        panels = [
            {"row": row, "column": column, "kind": kind, **_box(axis, inches * dpi, height, dpi)}
            for row, column, kind, axis in self.panels
        ]
        content = {"file": picture.name, "width": width, "height": height, **facts}
        text = json.dumps(content | {"rows": self.rows, "panels": panels}, indent=1, allow_nan=False)
        write_atomically(picture.with_suffix(".json"), (text + "\n").encode())


def _known(facts: dict[str, Any]) -> dict[str, Any]:
    inner = {key: _known(value) if isinstance(value, dict) else value for key, value in facts.items()}
    return {k: v for k, v in inner.items() if not (isinstance(v, float) and not math.isfinite(v))}


def _box(axis: Axes, size: Any, height: int, dpi: float) -> dict[str, int]:
    """The whole pixels of an axis within its frame, if it has one: its place is rounded inwards."""
    frame = max(
        (s.get_linewidth() for s in axis.spines.values() if s.get_visible() and axis.axison), default=0.0
    )
    inner = frame / 2 * dpi / 72 - TIE
    place = axis.get_position()
    x0, x1 = math.ceil(place.x0 * size[0] + inner), math.floor(place.x1 * size[0] - inner)
    y0, y1 = math.ceil(height - place.y1 * size[1] + inner), math.floor(height - place.y0 * size[1] - inner)
    return {"x": x0, "y": y0, "width": x1 - x0, "height": y1 - y0}


def png_size(head: bytes) -> tuple[int, int]:
    """Width and height from the first 24 bytes of a PNG.

    Raises:
        ValueError: if they begin no PNG.
    """
    if head[:8] != b"\x89PNG\r\n\x1a\n" or len(head) < 24:
        raise ValueError("no PNG")
    return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")

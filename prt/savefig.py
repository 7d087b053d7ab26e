"""Pictures of matplotlib as files: whole or not at all, and the same bytes for the same figure."""

import io
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from prt.cache import write_atomically


def svg_of(figure: Figure, metadata: dict[str, Any]) -> str:
    """The SVG as text."""
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata=metadata)
    return content.getvalue()


def save_png(figure: Figure, path: Path, dpi: float) -> None:
    """Write the PNG.

    Raises:
        PrtError: if the folder cannot be written.
    """
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi, metadata={"Software": None})
    write_atomically(path, content.getvalue(), "report=")

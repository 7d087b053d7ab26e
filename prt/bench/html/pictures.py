"""A report's images for the page: each PNG once, and where in the figure its panels lie."""

import base64
import json
from pathlib import Path
from typing import Any

from prt.bench.panels import png_size

NO_BOXES = "Pictures cannot be laid over each other: this report has no figure.json; `{command}` writes it."
WRONG_BOXES = "Pictures cannot be laid over each other: {why}; `{command}` writes figure.json anew."


def png(path: Path) -> dict[str, Any] | None:
    """A PNG in base64 with its size, or None where there is none, or something else by its name."""
    try:
        content = path.read_bytes()
        width, height = png_size(content)
    except (OSError, ValueError):
        return None
    return {"png": base64.b64encode(content).decode(), "width": width, "height": height}


def figure(folder: Path, command: str) -> dict[str, Any] | None:
    """``figure.png`` with the rows and panels of ``figure.json``, or a note why these are not there."""
    found = png(folder / "figure.png")
    if found is None:
        return None
    path = folder / "figure.json"
    if not path.exists():
        return {**found, "rows": [], "note": NO_BOXES.format(command=command)}
    try:
        boxes = json.loads(path.read_text(encoding="utf-8"))
        rows = _rows(boxes, found["width"], found["height"])
        end = float(boxes.get("error_end") or 0)
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        why = str(error) if isinstance(error, ValueError) else "figure.json is not as it should be"
        return {**found, "rows": [], "note": WRONG_BOXES.format(why=" ".join(why.split()), command=command)}
    return {**found, "rows": rows, "error_end": end, "note": ""}


def _rows(boxes: dict[str, Any], width: int, height: int) -> list[dict[str, Any]]:
    """Every row with its columns: the boxes of picture and error map, and what the figure says of them."""
    if (boxes["width"], boxes["height"]) != (width, height):
        raise ValueError("figure.json is of another figure.png")
    rows = []
    for fact in boxes["rows"]:
        facts = {k: fact[k] for k in ("label", "split", "view", "lighting", "component") if k in fact}
        rows.append({"facts": {k: str(v) for k, v in facts.items()}, "columns": {}, "psnr": {}})
        if "exposure" in fact:
            rows[-1]["facts"]["exposure"] = f"× {float(fact['exposure']):.3g}"
        rows[-1]["psnr"] = {str(k): float(v) for k, v in (fact.get("psnr") or {}).items()}
    for panel in boxes["panels"]:
        x, y, w, h = (int(panel[key]) for key in ("x", "y", "width", "height"))
        if not (0 <= x < x + w <= width and 0 <= y < y + h <= height):
            raise ValueError("figure.json has a panel outside figure.png")
        if panel["kind"] in ("picture", "error"):
            column = rows[int(panel["row"])]["columns"].setdefault(str(panel["column"]), {})
            column[panel["kind"]] = [x, y, w, h]
    for row in rows:  # as a list, whose order JSON keeps
        columns = {name: boxes for name, boxes in row.pop("columns").items() if "picture" in boxes}
        psnr = row.pop("psnr")
        row["columns"] = [
            {"label": name, "psnr": psnr.get(name), "error": None, **boxes} for name, boxes in columns.items()
        ]
    return [row for row in rows if row["columns"]]

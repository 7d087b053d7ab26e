"""The report of a failure matrix: a picture, a table with links, every threshold and its reason."""

import math
import os
import textwrap
from pathlib import Path

from prt.bench import chart
from prt.bench.chart import STYLE
from prt.bench.hover import HoverFigure
from prt.bench.matrix import Grade, Matrix, MatrixCell, as_results, read_matrix
from prt.bench.results import write_results
from prt.bench.spec import check_keys, read_yaml
from prt.cache import write_atomically
from prt.errors import PrtError

SIGNS: dict[Grade, str] = {
    "holds": "✔ holds", "degrades": "~ degrades", "fails": "✘ fails", "missing": "? not measured",
    "none": "– does not apply",
}  # fmt: skip
#: told apart under all common colour-vision deficiencies, and by the sign in every cell
COLOURS: dict[Grade, str] = {
    "holds": "#9fd3c0", "degrades": "#f6dd8c", "fails": "#e89a7c", "missing": "#e4e4e4", "none": "#ffffff",
}  # fmt: skip
MARKS: dict[Grade, str] = {"holds": "✔", "degrades": "~", "fails": "✘", "missing": "?", "none": "–"}


def main(name: str, path: Path, overrides: list[str], reports: Path = Path("reports")) -> int:
    """``prt table`` of a YAML with ``matrix``: read the reports, write the matrix.

    Raises:
        PrtError: for a mistake in the YAML, or an override other than ``report=``.
    """
    content = read_yaml(path)
    check_keys(path, "", content, ("title", "about", "matrix"))
    folder = reports / name
    for text in overrides:
        key, _, value = text.partition("=")
        if key != "report":
            raise PrtError(f"{text}: a matrix runs nothing and takes only report=<folder>")
        folder = Path(value)
    matrix = read_matrix(path, content["matrix"], reports)
    write(matrix, folder, str(content.get("title") or name), str(content.get("about") or ""), name)
    for row in matrix.rows:
        grades = [cell.grade for column in matrix.columns for cell in matrix.at(row, column)[:1]]
        counts = ", ".join(f"{grades.count(g)} {SIGNS[g][2:]}" for g in SIGNS if g in grades and g != "none")
        print(f"{matrix.rows[row]}: {counts}")
    print(f"report: {folder / 'report.md'}")
    return 0


def write(matrix: Matrix, folder: Path, title: str, about: str, name: str) -> None:
    """results.csv, matrix.svg, matrix.png, table.md and report.md."""
    write_results(as_results(matrix), folder / "results.csv")
    chart.write(draw(matrix), folder, "matrix")
    table = sheet(matrix, folder)
    write_atomically(folder / "table.md", f"# {title}\n\n{table}\n".encode())
    parts = [
        f"# {title}", about.strip(),
        f"Regenerate with `prt table {name}`; it reads the reports that its cells link to.",
        "![Where methods fail](matrix.svg)", table, "## Figures, thresholds and their reasons",
        reasons(matrix, folder), "## What is missing", missing(matrix),
    ]  # fmt: skip
    write_atomically(folder / "report.md", ("\n\n".join(part for part in parts if part) + "\n").encode())


def sheet(matrix: Matrix, folder: Path) -> str:
    """Methods by ways to fail: the worst cell of each place, linked to its report."""
    lines = [
        "| method | " + " | ".join(matrix.columns.values()) + " |",
        "|---" * (len(matrix.columns) + 1) + "|",
    ]
    for row, label in matrix.rows.items():
        shown = [shown_cell(matrix, row, column, folder) for column in matrix.columns]
        lines.append(f"| {label} | " + " | ".join(shown) + " |")
    return "\n".join(lines)


def shown_cell(matrix: Matrix, row: str, column: str, folder: Path) -> str:
    cells = matrix.at(row, column)
    if not cells:
        return "?"
    worst = cells[0]
    text = f"{MARKS[worst.grade]} {figure_text(worst)}".strip()
    return f"[{text}]({link(matrix, worst, folder)})" if worst.report and worst.grade != "missing" else text


def link(matrix: Matrix, cell: MatrixCell, folder: Path) -> str:
    """From the matrix's folder, wherever it lies, to the report of a cell."""
    return Path(os.path.relpath(matrix.reports / cell.report / "report.md", folder)).as_posix()


def figure_text(cell: MatrixCell) -> str:
    return f"{cell.value:.3g}" if math.isfinite(cell.value) else ""


def reasons(matrix: Matrix, folder: Path) -> str:
    lines = ["| method | failure | figure | holds up to | fails from | what it is | why there | report |",
             "|---|---|---:|---:|---:|---|---|---|"]  # fmt: skip
    for row, label in matrix.rows.items():
        for column, failure in matrix.columns.items():
            for cell in matrix.at(row, column):
                if cell.grade in ("none", "missing"):
                    continue
                figures = f"{MARKS[cell.grade]} {cell.value:.3g} | {cell.good:g} | {cell.bad:g}"
                what, source = f"{cell.note} ({cell.where})", f"[{cell.report}]({link(matrix, cell, folder)})"
                lines.append(f"| {label} | {failure} | {figures} | {what} | {cell.because} | {source} |")
    return "\n".join(lines)


def missing(matrix: Matrix) -> str:
    lines = [
        f"- {matrix.rows[cell.row]}, {matrix.columns[cell.column]}: {cell.note}"
        for cell in matrix.cells
        if cell.grade == "missing"
    ]
    for row, label in matrix.rows.items():
        gaps = [name for column, name in matrix.columns.items() if not matrix.at(row, column)]
        lines += [f"- {label}: not measured: {', '.join(gaps)}"] if gaps else []
    none = [
        f"- {matrix.rows[cell.row]}, {matrix.columns[cell.column]}: does not apply: {cell.note}"
        for cell in matrix.cells
        if cell.grade == "none"
    ]
    return "\n".join([*lines, *none]) or "Nothing."


def draw(matrix: Matrix) -> HoverFigure:
    """The matrix as coloured cells, each with its sign and figure; the SVG's cells say what they are."""
    import matplotlib
    from matplotlib.patches import Rectangle

    rows, columns = list(matrix.rows), list(matrix.columns)
    with matplotlib.rc_context(STYLE):
        figure = HoverFigure(figsize=(2.3 + 0.95 * len(columns), 1.3 + 0.5 * len(rows)), layout="constrained")
        axis = figure.subplots()
        for down, row in enumerate(rows):
            for right, column in enumerate(columns):
                cells = matrix.at(row, column)
                grade: Grade = cells[0].grade if cells else "missing"
                box = Rectangle((right + 0.03, down + 0.04), 0.94, 0.92, facecolor=COLOURS[grade], lw=0)
                axis.add_patch(box)
                text = f"{MARKS[grade]} {figure_text(cells[0])}" if cells else MARKS[grade]
                axis.text(right + 0.5, down + 0.5, text.strip(), ha="center", va="center", fontsize=8)
                figure.point(axis, right + 0.5, down + 0.5, said(matrix, row, column))
        axis.set_xlim(0, len(columns))
        axis.set_ylim(len(rows), 0)
        names = [textwrap.fill(name, 13) for name in matrix.columns.values()]
        axis.set_xticks([k + 0.5 for k in range(len(columns))], names, fontsize=7.5)
        axis.set_yticks([k + 0.5 for k in range(len(rows))], list(matrix.rows.values()), fontsize=8.5)
        axis.xaxis.tick_top()
        axis.tick_params(length=0)
        for side in axis.spines.values():
            side.set_visible(False)
        handles = [
            Rectangle((0, 0), 1, 1, facecolor=COLOURS[g], label=SIGNS[g])
            for g in ("holds", "degrades", "fails", "missing")
        ]
        figure.legend(handles=handles, loc="outside lower right", ncols=4, frameon=False, fontsize=7.5)
    return figure


def said(matrix: Matrix, row: str, column: str) -> str:
    """What a cell of the picture says of itself."""
    lines = [f"{matrix.rows[row]}: {matrix.columns[column]}"]
    for cell in matrix.at(row, column):
        known = math.isfinite(cell.value)
        limits = f" (holds up to {cell.good:g}, fails from {cell.bad:g})" if known else ""
        lines.append(f"{MARKS[cell.grade]} {figure_text(cell)} {cell.note}{limits}".replace("  ", " "))
    return "\n".join(lines if len(lines) > 1 else [*lines, "not measured"])

"""The picture behind the table: reference, each method, and where each is wrong.

Every row is one test image (a scene under a lighting), shown as the metrics saw it: exposed after its
reference, clipped and sRGB encoded, with the error map below each method and its PSNR under that.
"""

import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from prt.bench.exr import read_exr
from prt.bench.layout import MISSING, Layout, split_name
from prt.bench.panels import REFERENCE, PanelFigure
from prt.bench.results import DENOISED, Cell, join_variant
from prt.errors import PrtError
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.savefig import save_png

Image = Float[np.ndarray, "H W 3"]
#: (cell, split, view, lighting) -> reference images by component, linear
References = Callable[[Cell, str, str, str], dict[str, Image]]
#: inches a picture takes on the page
SIDE = 1.75
DPI = 150
#: the end of the error maps' scale, in displayed values (0 to 1)
ERROR_END = 0.15
CAPTION = (
    "Error maps: mean over channels of |method - reference| in displayed (sRGB) values. "
    "Exposure: 95th percentile of the reference to 0.8 linear."
)
#: characters of the caption that surely fit into an inch
CAPTION_DENSITY = 19
#: characters of a column's title that surely fit over a picture
TITLE_WIDTH = 24
#: of a title; the rest stands in the table
TITLE_LINES = 5
CROP_COLOURS = ["#E69F00", "#56B4E9"]


@dataclass(frozen=True)
class Row:
    """One test image and what every column shows of it."""

    scene: str
    split: str
    view: str
    lighting: str
    component: str
    exposure: float
    reference: Image  #: sRGB in [0, 1]
    pictures: dict[str, Image]  #: column label -> sRGB in [0, 1]
    psnr: dict[str, float]
    crops: list[list[float]]  #: x, y, width, height as fractions of the picture
    label: str = ""  #: shown in place of the scene's
    varied: str = "light"  #: what ``lighting`` names; where scenes move it is a state


def gather(
    cells: list[Cell], images: pd.DataFrame, layout: Layout, settings: dict, references: References
) -> tuple[list[Row], list[str]]:
    """The rows of the figure, and notes of what could not be shown and why.

    Args:
        settings: ``rows``, a list of {scene, split, view, lighting, component, label, crops}, of which only
            ``scene`` must be given (by default every scene); view and lighting are names or places in the
            list of tests; ``label`` stands in place of the scene's. ``component`` (the table's), ``split``
            (the first column's) and ``denoised`` (true where there are denoised images) hold for all rows;
            ``columns`` lists the methods that are shown, as :meth:`Layout.chosen` reads them.

    Raises:
        PrtError: for a method in ``columns`` that the table does not have.
    """
    rows, notes = [], []
    methods = shown_methods(layout, settings)
    wanted = settings.get("rows") or [{"scene": scene} for scene in layout.scenes]
    for entry in wanted:
        usual = "indirect" if "indirect" in layout.components else layout.components[0]
        entry = {"component": usual, "split": layout.splits[0], **settings, **entry}
        scene, split = entry["scene"], entry["split"]
        tests = images[(images["scene"] == scene) & (images["split"] == split)]
        if scene not in layout.scenes or not len(tests):
            notes.append(
                f"no picture of {layout.label(scene)}: no finished run has {split_name(split)} of it"
            )
            continue
        try:
            view = _choose(tests["view"], entry.get("view", 0), f"figure: {scene}: view")
            lit = tests[tests["view"] == view]["lighting"]
            lighting = _choose(lit, entry.get("lighting", 0), f"figure: {scene}: lighting")
            rows.append(_row(cells, images, layout, methods, entry, view, lighting, references))
        except PrtError as error:
            notes.append(f"no picture of {layout.label(scene)}: {error}")
    return rows, notes


def _choose(names: pd.Series, wanted: str | int, what: str) -> str:
    known = list(dict.fromkeys(names))
    if isinstance(wanted, int) and -len(known) <= wanted < len(known):
        return known[wanted]
    if str(wanted) not in known:
        raise PrtError(f"{what} {wanted!r} is not among {', '.join(known)}; choose one, or a place from 0")
    return str(wanted)


def _row(
    cells, images, layout: Layout, methods: list[tuple[str, str]], entry: dict, view: str, lighting: str,
    references: References,
) -> Row:  # fmt: skip
    scene, split, component = entry["scene"], entry["split"], entry["component"]
    pictures, psnr, reference, truth, exposure, varied = {}, {}, None, np.empty(0), 1.0, "light"
    here = images[
        (images["scene"] == scene) & (images["split"] == split) & (images["view"] == view)
        & (images["lighting"] == lighting) & (images["component"] == component) & (images["metric"] == "psnr")
    ]  # fmt: skip
    for method, variant in methods:
        cell = next(
            (c for c in cells if (c.scene, c.method, c.variant) == (scene, method, variant) and c.done), None
        )
        if cell is None:
            continue
        varied = "state" if cell.run.path.parts[-4:-3] == ("animate",) else "light"
        denoised = entry.get("denoised", True) and DENOISED in layout.tokens(method)
        path = cell.run.image_file(split, view, lighting, component, denoised)
        if denoised and not path.exists():
            denoised, path = False, cell.run.image_file(split, view, lighting, component, False)
        linear = np.nan_to_num(read_exr(path).numpy(), nan=0.0, posinf=0.0, neginf=0.0)
        images_of = references(cell, split, view, lighting)
        if component not in images_of:
            known = ", ".join(images_of)
            raise PrtError(f"figure: {view} has no component {component!r}; choose from {known}")
        own_truth = np.asarray(images_of[component])
        label = layout.method_label(method, variant)
        if reference is None:
            truth, exposure = own_truth, exposure_of(own_truth)
            reference = to_srgb(truth, exposure)
        elif own_truth.shape != truth.shape or not np.allclose(own_truth, truth, rtol=1e-3, atol=1e-4):
            raise PrtError(
                f"{label} has another reference than the columns before it; give its scene a configuration "
                "and a row of its own"
            )
        pictures[label] = to_srgb(linear, exposure)
        own = here[
            (here["method"] == method)
            & (here["seed"] == cell.seed)
            & (here["variant"] == join_variant(variant, DENOISED if denoised else ""))
        ]
        psnr[label] = float(own["value"].iloc[0]) if len(own) else float("nan")
    if reference is None:
        raise PrtError("no finished run has images of it")
    return Row(
        scene, split, view, lighting, component, exposure, reference, pictures, psnr,
        entry.get("crops") or [], str(entry.get("label") or layout.label(scene)), varied,
    )  # fmt: skip


def shown_methods(layout: Layout, settings: dict) -> list[tuple[str, str]]:
    """The (method, variant) of the figure's columns, in their order."""
    columns = settings.get("columns")
    return layout.chosen(columns, "figure.columns") if columns else layout.methods


def draw(rows: list[Row], layout: Layout, settings: dict | None = None) -> PanelFigure | None:
    """The figure, or None without rows; ``settings`` as for :func:`gather`."""
    import matplotlib

    if not rows:
        return None
    labels = [layout.method_label(m, v) for m, v in shown_methods(layout, settings or {})]
    labels = [label for label in labels if any(label in row.pictures for row in rows)]
    common = rows[0].component if len({row.component for row in rows}) == 1 else ""
    heights = []  # of the bands: pictures, error maps with PSNR, then the enlarged crops
    for row in rows:
        aspect = row.reference.shape[0] / row.reference.shape[1]
        heights.append([aspect, aspect + 0.13, *[0.5 * aspect] * bool(row.crops), 0.05])
    flat = [h for band in heights for h in band]
    width = (1 + len(labels)) * SIDE + 0.36
    caption = textwrap.wrap(CAPTION, int((width - 0.36) * CAPTION_DENSITY))
    bottom = 0.14 + 0.11 * len(caption)
    head = 0.14 + 0.13 * max(_titled(label).count("\n") + 1 for label in labels)
    height = sum(flat) * SIDE + head + 0.03 + bottom
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 8.5}):
        figure = PanelFigure(figsize=(width, height))
        grid = figure.add_gridspec(
            len(flat), 1 + len(labels), height_ratios=flat, wspace=0.025, hspace=0.03,
            left=0.3 / width, right=1 - 0.06 / width, top=1 - head / height, bottom=bottom / height,
        )  # fmt: skip
        at = 0
        for number, (row, bands) in enumerate(zip(rows, heights, strict=True)):
            _draw_row(figure, grid, at, row, labels, common, first=number == 0)
            at += len(bands)
        figure.text(
            0.3 / width, 0.06 / height, "\n".join(caption), fontsize=6.5, color="#666666",
        )  # fmt: skip
    return figure


def _draw_row(
    figure: PanelFigure, grid, at: int, row: Row, labels: list[str], common: str, first: bool
) -> None:
    """One row; ``common`` is the component that all rows show, empty where each says its own."""
    figure.row(label=row.label, scene=row.scene, split=row.split, view=row.view, lighting=row.lighting,
               component=row.component, exposure=float(row.exposure), psnr=row.psnr)  # fmt: skip
    top = figure.add_subplot(grid[at, 0])
    _show(top, row.reference)
    figure.panel(REFERENCE, "picture", top)
    top.set_ylabel(row.label, fontweight="bold", fontsize=9, labelpad=4)
    if first:
        top.set_title(f"{REFERENCE} ({common})" if common else REFERENCE, fontsize=9, pad=4)
    below = figure.add_subplot(grid[at + 1, 0])
    below.axis("off")
    _facts(below, row, bool(common))
    columns = [top]
    for i, label in enumerate(labels, start=1):
        picture, errors = figure.add_subplot(grid[at, i]), figure.add_subplot(grid[at + 1, i])
        if first:
            picture.set_title(_titled(label), fontsize=9, pad=4)
        columns.append(picture)
        if label not in row.pictures:
            _show(picture, np.ones_like(row.reference))
            picture.text(0.5, 0.5, "no finished run", ha="center", va="center", transform=picture.transAxes,
                         color="#999")  # fmt: skip
            errors.axis("off")
            continue
        _show(picture, row.pictures[label])
        figure.panel(label, "picture", picture)
        figure.panel(label, "error", errors)
        error = np.abs(row.pictures[label] - row.reference).mean(axis=-1)
        errors.imshow(error, cmap="magma", vmin=0, vmax=ERROR_END, interpolation="nearest")
        errors.set_anchor("N")
        errors.set(xticks=[], yticks=[])
        best = max(v for v in row.psnr.values() if v == v) if any(v == v for v in row.psnr.values()) else None
        weight = "bold" if row.psnr[label] == best else "normal"
        known = row.psnr[label] == row.psnr[label]  # a run may not have been asked for its PSNR
        errors.set_xlabel(
            f"{row.psnr[label]:.2f} dB" if known else MISSING, fontsize=8.5, labelpad=2, fontweight=weight
        )
    _enlarge(figure, grid, at + 2, row, columns, labels)


def _titled(label: str) -> str:
    """A column's title in lines no wider than its pictures; variants break at their commas."""
    lines = textwrap.wrap(
        re.sub(r",\s*", ", ", label),
        TITLE_WIDTH,
        break_on_hyphens=False,
        max_lines=TITLE_LINES,
        placeholder=" ...",
    )
    return "\n".join(lines) or label


def _show(axis: Axes, picture: Image) -> None:
    axis.imshow(picture, vmin=0, vmax=1, interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    for spine in axis.spines.values():
        spine.set_visible(False)


def _facts(axis: Axes, row: Row, of_all: bool) -> None:
    """Under the reference: which image this is, its exposure, and the error maps' colour bar.

    ``of_all``: the component stands above the column, being that of all rows.
    """
    facts = [
        f"view: {row.view} ({row.split})",
        f"{row.varied}: {row.lighting}",
        f"exposure: × {row.exposure:.3g}",
    ]
    facts += [] if of_all else [f"component: {row.component}"]
    for i, line in enumerate(facts):
        text = line if len(line) <= 30 else line[:29] + "…"
        axis.text(
            0.02, 0.93 - 0.11 * i, text, fontsize=7, color="#444444", transform=axis.transAxes, va="top"
        )
    bar = axis.inset_axes([0.02, 0.24, 0.9, 0.07])
    bar.imshow(np.linspace(0, 1, 256)[None], cmap="magma", aspect="auto", extent=(0, ERROR_END, 0, 1))
    bar.set_yticks([])
    bar.set_xticks([0, ERROR_END], ["0", f"≥ {ERROR_END:g}"])
    bar.tick_params(labelsize=6.5, length=2, pad=1.5, color="#888888")
    bar.set_title("error", fontsize=7, pad=2, color="#444444")


def _enlarge(figure: Figure, grid, at: int, row: Row, columns: list[Axes], labels: list[str]) -> None:
    """Crops framed in the pictures and enlarged below them."""
    pictures = [row.reference, *(row.pictures.get(label) for label in labels)]
    for column, (axis, picture) in enumerate(zip(columns, pictures, strict=True)):
        if picture is None or not row.crops:
            continue
        spaces = grid[at, column].subgridspec(1, 2, wspace=0.04)
        for number, (crop, colour) in enumerate(zip(row.crops, CROP_COLOURS, strict=False)):
            (h, w), (x, y, cw, ch) = picture.shape[:2], crop
            x0, y0, x1, y1 = round(x * w), round(y * h), round((x + cw) * w), round((y + ch) * h)
            axis.add_patch(Rectangle((x0 - 0.5, y0 - 0.5), x1 - x0, y1 - y0, fill=False, ec=colour, lw=1.1))
            inset = figure.add_subplot(spaces[0, number])
            _show(inset, picture[y0:y1, x0:x1])
            for spine in inset.spines.values():
                spine.set(visible=True, edgecolor=colour, linewidth=1.4)


def write(figure: PanelFigure, folder: Path) -> None:
    """``figure.png`` at display size, and ``figure.json``: where in it each panel lies."""
    save_png(figure, folder / "figure.png", DPI)
    figure.write_boxes(folder / "figure.png", DPI, error_end=ERROR_END)

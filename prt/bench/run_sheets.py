"""Sheets beside the quality table: what the methods cost, where their error comes from, other diagnostics."""

from typing import cast

import pandas as pd

from prt.bench.layout import MISSING, Entry, Layout, Sheet, figure_format, metric_label
from prt.bench.results import DENOISED, NOISE_FLOOR, is_cost, join_variant
from prt.metrics.diagnostics import DIAGNOSTICS
from prt.metrics.registry import METRICS

#: how the titles of these sheets begin; report.md repeats them
COST_TITLE, ERROR_TITLE, DIAGNOSTICS_TITLE = "Time and size", "Error split", "Diagnostics"
COSTS = [
    ("time/bake", "bake (s)", 1.0),
    ("time/fit", "fit (s)", 1.0), ("time/light", "light (ms)", 1e3), ("time/gbuffer", "G-buffer (ms)", 1e3),
    ("time/shade", "shade (ms)", 1e3), ("time/denoise", "denoise (ms)", 1e3),
    ("time/frame", "frame (ms)", 1e3),
    ("bytes/model", "model (MB)", 1e-6),
]  # fmt: skip
#: the part of a frame's costs that is no part of the frame
MOVE = "move twice"
#: seconds of baking below which nothing was baked: only the clock was read
BAKED = 1e-3


def cost_columns(results: pd.DataFrame, layout: Layout) -> list[tuple[str, str, float]]:
    """(metric, head, factor) of the cost sheet; a method's own parts of its time stand after shading."""
    of_table = results["scene"].isin(layout.scenes) & results["method"].isin([m for m, _ in layout.methods])
    figures = results[of_table & results["value"].notna()]
    seen = dict.fromkeys(figures["metric"])
    baked = max(figures.loc[figures["metric"] == "time/bake", "value"], default=0.0) >= BAKED
    columns = [column for column in COSTS if column[0] != "time/bake" or baked]
    known = [metric for metric, _, _ in COSTS]
    parts = [m for m in seen if is_cost(m) and m.startswith("time/") and m not in known]
    place = [metric for metric, _, _ in columns].index("time/shade") + 1
    columns[place:place] = [(m, f"{_part_name(m)} (ms)", 1e3) for m in parts]
    sizes = [m for m in seen if m.startswith("bytes/") and m not in known]
    return columns + [(m, f"{_part_name(m)} (MB)", 1e-6) for m in sizes]


def cost_sheet(results: pd.DataFrame, layout: Layout) -> Sheet:
    """Times and sizes: rows scene x method, columns the scopes (medians)."""
    columns = cost_columns(results, layout)
    sheet = Sheet(COST_TITLE, ["scene", "method", "device"], [("", [label for _, label, _ in columns])], [])
    sheet.notes.append(
        "Times are medians of at least 30 repetitions. frame = G-buffer + shade, without denoising; light is "
        "spent once per lighting, fit once per scene. Compare only figures of one command on one machine."
    )
    known = [metric for metric, _, _ in COSTS]
    parts = [
        head.removesuffix(" (ms)") for metric, head, _ in columns if metric not in known and "(ms)" in head
    ]
    if any(metric == "time/bake" for metric, _, _ in columns):
        sheet.notes.append(
            "bake is spent once per scene on the data that a method is fitted to; data found in the cache "
            "cost only their reading."
        )
    if MOVE in parts:
        parts.remove(MOVE)
        sheet.notes.append(
            f"{MOVE}: two changes of the scene's state, which come before a frame and are no part of it: the "
            "first frame of a new state takes half of that longer."
        )
    if parts:
        sheet.notes.append(f"{', '.join(parts)}: parts of light and shade, each timed by itself.")
    for scene in layout.scenes:
        for method, variant in layout.methods:
            rows = results[
                (results["scene"] == scene) & (results["method"] == method) & (results["split"] == "")
            ]
            denoising = (rows["metric"] == "time/denoise") & (
                rows["variant"] == join_variant(variant, DENOISED)
            )
            own = rows[((rows["variant"] == variant) | denoising) & rows["value"].notna()]
            if not len(own):
                continue
            value = own.drop_duplicates("metric").set_index("metric")["value"]
            cells = [
                Entry([cost(value[m], m, factor) if m in value else MISSING]) for m, _, factor in columns
            ]
            lead = [layout.label(scene), layout.method_label(method, variant), own["device"].iloc[0]]
            sheet.rows.append((lead, cells))
    return sheet


def published_costs(results: pd.DataFrame, layout: Layout) -> Sheet:
    """The paper's own times and sizes, where it gives any, in a sheet of their own."""
    own = results[results["published"].notna()]
    sheet = cost_sheet(own.assign(value=own["published"], device="the paper's"), layout)
    sheet.title, sheet.notes = "Published times and sizes (the paper's own GPU; not comparable)", []
    return sheet


def cost(value: float, metric: str, factor: float) -> str:
    """One figure of the cost sheet."""
    return "0" if metric == "time/bake" and value < BAKED else f"{value * factor:.3g}"


def error_sheets(results: pd.DataFrame, layout: Layout) -> list[Sheet]:
    """Where the error comes from: for every metric with parts (``psnr/fit``), these beside the whole.

    The last sheet holds the diagnostics that belong to no metric (``negative/share``).
    """
    seen = list(dict.fromkeys(results.loc[results["value"].notna(), "metric"]))
    sheets = []
    for metric, known in METRICS.items():
        parts = sorted(m for m in seen if m.startswith(f"{metric}/"))
        floor = [NOISE_FLOOR] if metric == "psnr" else []
        title = f"{ERROR_TITLE} ({', '.join(filter(None, [known.label, known.unit]))})"
        heads = ["all errors", *map(_part_name, parts), *["reference noise floor" for _ in floor]]
        if parts:
            sheets.append(_rows_by_image(results, layout, title, [metric, *parts, *floor], heads, parts))
    others = [m for m in seen if m.partition("/")[0] not in METRICS and "/" in m and not is_cost(m)]
    if others:
        heads = [metric_label(metric) for metric in others]
        sheets.append(_rows_by_image(results, layout, DIAGNOSTICS_TITLE, others, heads, others))
    return sheets


def _part_name(metric: str) -> str:
    known = DIAGNOSTICS.get(metric)
    return known.label if known else metric.partition("/")[2].replace("_", " ")


def _rows_by_image(
    results: pd.DataFrame, layout: Layout, title: str, names: list[str], heads: list[str], needed: list[str]
) -> Sheet:
    """Rows scene x split x method x component with at least one of the ``needed`` figures; no denoising."""
    sheet = Sheet(title, ["scene", "split", "method", "component"], [("", heads)], [])
    key = ["scene", "split", "method", "variant", "component"]
    plain = results[results["metric"].isin(names) & results["variant"].isin([v for _, v in layout.methods])]
    show = figure_format(names[0])
    for place, rows in plain.groupby(key, sort=False):
        scene, split, method, variant, component = cast(tuple[str, str, str, str, str], place)
        value = rows.drop_duplicates("metric").set_index("metric")["value"].astype(float).dropna()
        if scene in layout.scenes and any(m in value for m in needed):
            cells = [Entry([show(value[m]) if m in value else MISSING]) for m in names]
            lead = [layout.label(scene), split, layout.method_label(method, variant), component]
            sheet.rows.append((lead, cells))
    return sheet

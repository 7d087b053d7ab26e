"""The report folder of a table: results.csv first, then all that is made from it and from the run folders."""

import dataclasses
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pandas as pd
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Table

from prt.bench import advised, chart, curve_charts, differences, enough, figure, layout, pictures, run_sheets
from prt.bench.layout import Layout, Sheet
from prt.bench.results import (
    NOISE_FLOOR,
    Cell,
    in_views,
    read_images,
    read_published,
    read_results,
    summarise,
    write_results,
)
from prt.bench.verdicts import SCOPES, Evidence, judge
from prt.cache import write_atomically
from prt.metrics.diagnostics import diagnostic_of
from prt.metrics.registry import METRICS
from prt.metrics.tonemap import PERCENTILE, TARGET

if TYPE_CHECKING:
    from prt.bench.spec import Spec

SIGNS = {"holds": "✔ holds", "fails": "✘ fails", "undecided": "? undecided"}


def write_report(
    spec: "Spec",
    plan: Layout,
    cells: list[Cell],
    failed: dict[Cell, str] | None = None,
    references: figure.References | None = None,
    console: Console | None = None,
    judge_advice: Callable[[pd.DataFrame, Layout], list[advised.Judged]] | None = None,
) -> None:
    """Write every file of ``spec.report`` and print the table.

    Args:
        failed: reasons of runs that failed without leaving a folder; the folders tell the others.
        references: reference images for the figure; without them there is no figure.
        judge_advice: what the results say of the advice of ``prt needs``.

    Raises:
        PrtError: for damaged run folders, a wrong published file, or a folder that cannot be written.
    """
    folder = spec.report
    every_image = read_images(cells)
    images = in_views(every_image, plan.views)
    if "splits" not in spec.columns and len(images):
        plan = dataclasses.replace(plan, splits=layout.splits_of(images["split"]))
    published = read_published(spec.published) if spec.published else None
    write_results(summarise(cells, images, published), folder / "results.csv")
    results = read_results(folder / "results.csv")
    reasons = {}
    for cell in cells:
        if not cell.done:
            reasons[cell.scene, cell.method, cell.variant] = (failed or {}).get(cell) or cell.reason

    sheets = make_sheets(spec, plan, results, reasons)
    text = "\n".join([f"# {spec.title}\n", *map(layout.to_markdown, sheets)])
    write_atomically(folder / "table.md", text.encode())
    write_atomically(folder / "table.tex", "\n".join(map(layout.to_latex, sheets)).encode())

    by_method = {(scene, method): reason for (scene, method, _), reason in reasons.items()}
    verdicts = judge(spec.claims, Evidence(images, results, plan.scenes, by_method))
    text = verdicts.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(folder / "claims.csv", text.encode())

    judged = judge_advice(results, plan) if judge_advice else []
    if judged:
        text = advised.table(judged).to_csv(index=False, float_format="%.6g", lineterminator="\n")
        write_atomically(folder / "advice.csv", text.encode())
    notes = views_missing(plan, every_image)
    notes += draw_pictures(spec, plan, cells, every_image, results, references)
    write_atomically(
        folder / "report.md",
        describe(spec, plan, cells, results, verdicts, reasons, sheets, notes, judged).encode(),
    )

    # one table a split: all side by side would not fit a screen
    tables = [layout.to_rich(sheets[0], group) for group in range(len(plan.splits))]
    tables += [layout.to_rich(sheet) for sheet in sheets if sheet.title == run_sheets.COST_TITLE]
    show(folder, tables, verdicts, console or Console())


def views_missing(plan: Layout, images: pd.DataFrame) -> list[str]:
    """Notes of views the table asks for and no finished run has."""
    known = list(dict.fromkeys(images["view"]))
    return [
        f"columns.views: no finished run has a view {view!r}; there are {', '.join(known)}"
        for view in plan.views
        if known and not len(in_views(images, [view]))
    ]


def show(folder: Path, tables: list[Table], verdicts: pd.DataFrame, console: Console) -> None:
    """Print tables, verdicts and where the report lies."""
    # a pipe has no width; a table cut to 80 columns cannot be read
    wide = console if console.is_terminal else Console(file=console.file, width=200, quiet=console.quiet)
    for table in tables:
        wide.print(table)
    for row in verdicts[verdicts["scene"].isin(SCOPES.values())].itertuples() if len(verdicts) else ():
        console.print(
            f"{SIGNS[row.verdict]}: {row.claim} ({row.note})", markup=False, highlight=False, soft_wrap=True
        )
    console.print(f"report: {folder / 'report.md'}", soft_wrap=True, markup=False, highlight=False)


def make_sheets(spec: "Spec", plan: Layout, results: pd.DataFrame, reasons: dict) -> list[Sheet]:
    """All sheets of table.md: measured, intervals, costs, error split; apart from them the published one."""
    budgets = sorted({b for b in results.loc[results["n"].notna(), "budget"]})
    devices = sorted({d for d in results.loc[results["n"].notna(), "device"] if d})
    shown = f"budget {', '.join(budgets)}; {'; '.join(devices)}" if budgets else "no runs yet"
    where = f"Measured by this project ({shown})"
    sheets = [layout.quality_sheet(results, plan, "value", where, reasons)]
    sheets.append(layout.quality_sheet(results, plan, "half", "Half width of the 95 % interval of each mean"))
    sheets.append(run_sheets.cost_sheet(results, plan))
    sheets += run_sheets.error_sheets(results, plan)
    if spec.published:
        sheets.append(layout.quality_sheet(results, plan, "published", layout.PUBLISHED_TITLE))
        sheets.append(run_sheets.published_costs(results, plan))
    return [sheet for i, sheet in enumerate(sheets) if sheet.rows or i == 0]


def draw_pictures(spec, plan, cells, images, results, references) -> list[str]:
    """Write chart, curves and figure; returns notes of what is missing in them; removes old ones."""
    folder = spec.report
    theirs = {picture["file"] for picture in spec.pictures}  # those of the runs, which nothing here draws
    drawn_here = ("chart*.svg", "chart*.png", "differences.*", "figure.*")
    for path in [path for pattern in drawn_here for path in folder.glob(pattern)]:
        if path.name not in theirs:
            path.unlink()
    notes = []
    for name, settings in charts_of(spec).items():
        drawn = chart.draw(results, plan, settings, chart_note(cells))
        if drawn is not None:
            chart.write(drawn, folder, name)
        elif settings or "indirect" in plan.components:  # the default chart's
            notes.append(f"no {name}: no finished run has both of its figures")
    if spec.differences:
        drawn = differences.draw(images, plan, spec.differences)
        if drawn is not None:
            chart.write(drawn, folder, "differences")
        else:
            notes.append("no differences: no finished run can be compared with the first row's")
    notes += curve_charts.write_all(spec.curves, results, plan, folder, plan.splits[0])
    notes += pictures.missing(spec.pictures, folder)
    if references is not None and spec.figure is not None:
        rows, missing = figure.gather(cells, images, plan, spec.figure, references)
        notes += missing
        picture = figure.draw(rows, plan, spec.figure)
        if picture is not None:
            figure.write(picture, folder)
    return notes


def charts_of(spec: "Spec") -> dict[str, dict]:
    """Every speed-accuracy chart of a table by the name of its files."""
    first = {} if spec.differences and not spec.chart else {"chart": spec.chart}
    return first | {f"chart_{entry['file']}": entry for entry in spec.charts}


def chart_note(cells: list[Cell]) -> str:
    """Where the chart's times were taken."""
    devices = list(dict.fromkeys(cell.device for cell in cells if cell.done and cell.device))
    pixels = sorted({cell.run.timing().get("pixels") for cell in cells if cell.done} - {None})
    shown = f"; {', '.join(f'{p:,}' for p in pixels)} shaded pixels a frame" if 0 < len(pixels) <= 3 else ""
    return (
        f"Times on {'; '.join(devices)}{shown}. Bars: 95 % interval (quality), 95th percentile (time)."
        if devices
        else ""
    )


def describe(spec, plan: Layout, cells, results, verdicts, reasons, sheets, notes, judged) -> str:
    """report.md: what was run where, what came out, what is missing and why."""
    done = [cell for cell in cells if cell.done]
    parts = [f"# {spec.title}", spec.about.strip()] if spec.about else [f"# {spec.title}"]
    parts.append(f"Regenerate with `{spec.command}`. Every number comes from [results.csv](results.csv).")
    folder = spec.report
    if (folder / "figure.png").exists():
        parts.append("![Reference, methods and error maps](figure.png)")
    names = [name for name in charts_of(spec) if (folder / f"{name}.svg").exists()]
    parts += [f"![Speed against accuracy]({name}.svg)" for name in names]
    if (folder / "differences.svg").exists():
        parts.append("![What every change brings](differences.svg)")
    parts += curve_charts.markdown(spec.curves, folder) + pictures.markdown(spec.pictures, folder)
    parts += [
        layout.to_markdown(sheets[0]).strip(),
        "More tables: [table.md](table.md), [table.tex](table.tex).",
    ]
    smallest = enough.markdown(results, plan, spec.enough)
    parts += ["## What is enough", "\n".join(smallest)] if smallest else []
    parts += ["## What `prt needs` advises", advised.markdown(judged, plan, spec.enough)] if judged else []
    if len(verdicts):
        parts += ["## Claims", claims_text(verdicts)]
    parts += ["## How it was run", how(done, spec.settings) if done else "No run has finished yet."]
    again = (run_sheets.COST_TITLE, run_sheets.ERROR_TITLE, run_sheets.DIAGNOSTICS_TITLE)
    parts += [layout.to_markdown(sheet).strip() for sheet in sheets if sheet.title.startswith(again)]
    parts += ["## Noise floor of the references", floor_text(results, plan)]
    parts += ["## What is missing", missing_text(plan, results, reasons, notes)]
    parts += ["## How figures are defined", definitions(plan, results)]
    return "\n\n".join(part for part in parts if part) + "\n"


def claims_text(verdicts: pd.DataFrame) -> str:
    """Claims with their verdicts over all scenes, then the figures scene by scene."""
    overall = verdicts[verdicts["scene"].isin(SCOPES.values())]
    lines = [
        "A claim holds (fails) on a scene where the whole 95 % interval of the difference lies on its "
        "(the other) side; otherwise it is undecided. Differences are left minus right; `>` means better, "
        "whichever way the metric runs. Details: [claims.csv](claims.csv).",
        "", "| claim | verdict | scenes |", "|---|---|---|",
    ]  # fmt: skip
    lines += [f"| `{_cell(r.claim)}` | {SIGNS[r.verdict]} | {r.note} |" for r in overall.itertuples()]
    lines += [
        "",
        "| claim | scene | verdict | difference [95 % interval] | images | note |",
        "|---|---|---|---:|---:|---|",
    ]
    for r in verdicts[~verdicts["scene"].isin(SCOPES.values())].itertuples():
        known = r.difference == r.difference and r.difference is not None
        figures = f"{r.difference:.3g} [{r.lo:.3g}, {r.hi:.3g}]" if known and r.lo == r.lo else "–"
        if known and r.lo != r.lo:
            figures = f"{r.difference:.3g} [no interval]"
        count = f"{int(r.n)}" if r.n == r.n and r.n is not None else "–"
        lines.append(
            f"| `{_cell(r.claim)}` | {r.scene} | {SIGNS[r.verdict]} | {figures} | {count} | {_cell(r.note)} |"
        )
    return "\n".join(lines)


def _cell(text: str) -> str:
    return str(text).replace("|", "\\|")


def how(done: list[Cell], of_methods: dict[str, list[str]]) -> str:
    """Machine, code, the settings that the finished runs share, and those the table gives single methods."""
    seen = [cell.run.provenance() for cell in done]

    def every(key: str) -> str:
        return ", ".join(
            dict.fromkeys(str(p[key])[:12] if key == "commit" else str(p[key]) for p in seen if p.get(key))
        )

    lines = [
        f"- runs: {len(done)}, seeds {', '.join(map(str, sorted({c.seed for c in done})))}, "
        f"budget {', '.join(dict.fromkeys(c.budget for c in done))}",
        f"- device: {'; '.join(dict.fromkeys(c.device for c in done if c.device)) or 'not recorded'}",
        f"- system: {every('system') or 'not recorded'}, Python {every('python') or 'not recorded'}",
        f"- code: commit {every('commit') or 'not recorded'}"
        + (" with uncommitted changes" if any(p.get("dirty") for p in seen) else ""),
    ]
    packages = seen[0].get("packages") or {}
    if packages:
        lines.append(
            "- packages: " + ", ".join(f"{name} {version}" for name, version in packages.items() if version)
        )
    settings = [OmegaConf.to_container(cell.run.config(), resolve=True) for cell in done]
    for group in ("task", "lighting"):
        values = [s.get(group) or {} for s in settings]
        shared = {
            k: v for k, v in values[0].items() if all(o.get(k) == v for o in values) and not k.startswith("_")
        }
        text = ", ".join(f"{key} {value}" for key, value in shared.items() if not isinstance(value, dict))
        lines += [f"- {group}: {text}"] if text else []
    lines += [f"- {method}: {', '.join(overrides)}" for method, overrides in of_methods.items()]
    return "\n".join(lines)


def floor_text(results: pd.DataFrame, plan: Layout) -> str:
    """PSNR of the references against a second seed of themselves."""
    floors = results[(results["metric"] == NOISE_FLOOR) & results["value"].notna()]
    if not len(floors):
        return "Not measured by these runs."
    lines = [
        "PSNR between two seeds (dB). A reference judges only figures 10 dB or more below its own floor.",
        "",
    ]
    for place, rows in floors.groupby(["scene", "split", "component"], sort=False):
        scene, split, component = cast(tuple[str, str, str], place)
        lines.append(f"- {plan.label(scene)}, {split}, {component}: {rows['value'].iloc[0]:.1f}")
    return "\n".join(lines)


def missing_text(plan: Layout, results: pd.DataFrame, reasons: dict, notes: list[str]) -> str:
    """What has no figures, each with its reason."""
    lines = [
        f"- {plan.method_label(m, v)} on {plan.label(s)}: {reason}" for (s, m, v), reason in reasons.items()
    ]
    lines += [f"- {note}" for note in notes]
    measured = results[results["n"].notna() & results["value"].isna()]
    for metric in dict.fromkeys(measured["metric"]):
        count, why = (measured["metric"] == metric).sum(), ""
        if metric == "lpips":
            from prt.metrics.lpips import lpips_unavailable

            why = f" ({lpips_unavailable()})" if lpips_unavailable() else ""
        lines.append(
            f"- {metric}: {count} means are not available, for at least one image had no figure{why}"
        )
    only_paper = results[results["n"].isna() & results["published"].notna()]
    if len(only_paper):
        pairs = list(dict.fromkeys(zip(only_paper["scene"], only_paper["method"], strict=True)))
        names = ", ".join(f"{scene} {method}" for scene, method in pairs)
        lines.append(f"- {len(only_paper)} published figures have no measured one beside them: {names}")
    return "\n".join(lines) or "Nothing."


def definitions(plan: Layout, results: pd.DataFrame) -> str:
    """The metrics' own definitions, those of the diagnostics beside them, and what means are taken over."""
    lines = [f"- {METRICS[m].label}: {METRICS[m].definition}" for m in plan.metrics]
    displayed = [METRICS[m].label for m in plan.metrics if METRICS[m].domain == "srgb"]
    if displayed:
        lines.append(
            f"- {', '.join(displayed)}: of images as displayed: one exposure for both, the reference's "
            f"{PERCENTILE:g}th percentile to {TARGET:g}, clipped to [0, 1], sRGB; background included."
        )
    for diagnostic in dict.fromkeys(map(diagnostic_of, results["metric"])):
        if diagnostic is not None:
            lines.append(f"- {diagnostic.label or diagnostic.name}: {diagnostic.definition}")
    if plan.views:
        lines.append(f"- Only test items with these views count: {', '.join(plan.views)}.")
    lines.append(
        "- Means are over test images (views times lightings, unseen in fitting); intervals count images of "
        "one view, or under one lighting, as one draw, whichever is wider. "
        + (
            "Where there are several seeds, what the means of their runs differ by is a part of the interval."
            if len(set(results["seeds"].dropna()) - {1})
            else "Each run has one seed: what another fit would come to is no part of them."
        )
    )
    return textwrap.dedent("\n".join(lines))

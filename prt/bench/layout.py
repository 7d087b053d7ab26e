"""The tidy table laid out as in a paper: Markdown, LaTeX and the terminal from the same sheets.

Published numbers get a sheet of their own, so that no cell ever mixes them with measured ones.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import pandas as pd
from rich.table import Table

from prt.bench.results import DENOISED, NOISE_FLOOR, direction_of, join_variant
from prt.errors import PrtError
from prt.metrics.diagnostics import diagnostic_label, diagnostic_of
from prt.metrics.registry import METRICS

FAILED, MISSING, UNAVAILABLE = "failed", "–", "n/a"
#: what a split is called where its own name says too little
SPLIT_NAMES = {
    "near": "near views", "far": "far views", "diffuse": "diffuse", "glossy": "glossy",
    "inside": "random states", "corners": "corners", "outside": "states outside", "given": "given states",
    "points": "point lights", "spots": "spot lights", "path": "along a path",
}  # fmt: skip
PUBLISHED_TITLE = "Published (the paper's own scenes, renderer and GPU; not comparable in absolute terms)"


@dataclass(frozen=True)
class Layout:
    """What a quality table shows, in which order; from ``columns`` of the table's YAML."""

    scenes: list[str]
    methods: list[tuple[str, str]]  #: (method, variant without denoising)
    metrics: list[str] = field(default_factory=lambda: ["psnr", "ssim", "lpips"])
    components: list[str] = field(default_factory=lambda: ["full", "indirect"])
    splits: list[str] = field(default_factory=lambda: ["far", "near"])
    as_is: list[str] = field(default_factory=list)  #: methods shown only without denoising after them
    #: names of the views whose test items count, ``*`` for any text; empty for all
    views: list[str] = field(default_factory=list)
    #: of methods and scenes, and as ``method[variant]`` of what a row varies, where the name is not enough
    labels: dict[str, str] = field(default_factory=dict)

    def label(self, name: str) -> str:
        return self.labels.get(
            name, name.replace("_", " ").title() if name in self.scenes else name.replace("_", " ")
        )

    def tokens(self, method: str) -> list[str]:
        """Variant tokens under which a method is shown: as it renders, then denoised."""
        return [""] if method in self.as_is else ["", DENOISED]

    def variant_label(self, method: str, variant: str) -> str:
        """What a row varies, in words where ``labels`` has some."""
        return self.labels.get(f"{method}[{variant}]", variant)

    def method_label(self, method: str, variant: str, token: str = "") -> str:
        """A row's name; ``token`` is said after what it varies, as that it is denoised."""
        said = join_variant(self.variant_label(method, variant), token)
        return self.label(method) + (f" ({said})" if said else "")

    def chosen(self, names: Sequence[str], what: str) -> list[tuple[str, str]]:
        """The (method, variant) meant by ``names``: labels, ``method[variant]``, or methods in all variants.

        Raises:
            PrtError: for a name of none of them; ``what`` names the setting.
        """
        found = []
        for name in names:
            matching = [
                (method, variant)
                for method, variant in self.methods
                if name
                in (method, self.label(method), f"{method}[{variant}]", self.method_label(method, variant))
            ]
            if not matching:
                known = [f"{m}[{v}]" if v else m for m, v in self.methods]
                raise PrtError(f"{what}: no method {name!r} in this table; choose from {', '.join(known)}")
            found += matching
        return list(dict.fromkeys(found))


def split_name(split: str) -> str:
    """A split in words: ``far views``, ``same lights``."""
    return SPLIT_NAMES.get(split, f"{split} lights")


def splits_of(names: Iterable[str]) -> list[str]:
    """The order in which splits are shown where a table does not say: far before near, then as they come."""
    found = list(dict.fromkeys(names))
    return [name for name in ("far", "near") if name in found] + [
        name for name in found if name not in ("far", "near")
    ]


@dataclass
class Entry:
    """One cell: its parts stand side by side (``full / indirect``), the best ones marked."""

    parts: list[str]
    best: list[bool] = field(default_factory=list)

    def text(self, mark: Callable[[str], str], escape: Callable[[str], str] = str) -> str:
        best = self.best or [False] * len(self.parts)
        return " / ".join(mark(escape(p)) if b else escape(p) for p, b in zip(self.parts, best, strict=True))


@dataclass
class Sheet:
    """One table: leading text columns, then groups of figure columns."""

    title: str
    lead: list[str]
    groups: list[tuple[str, list[str]]]
    rows: list[tuple[list[str], list[Entry]]]
    notes: list[str] = field(default_factory=list)


def figure_format(metric: str) -> Callable[[float], str]:
    """How many digits a metric is shown with."""
    if metric.startswith("psnr") or metric == NOISE_FLOOR:
        return "{:.2f}".format
    # radiance has no scale of its own: a dim scene would be all zeros in fixed digits
    fixed = metric in METRICS and METRICS[metric].unit != "radiance"
    return "{:.4f}".format if fixed else "{:.3g}".format


def metric_name(metric: str) -> tuple[str, str]:
    """Name and unit for people; a part of a metric's error is the metric's name and the part's."""
    if metric in METRICS:
        return METRICS[metric].label, METRICS[metric].unit
    diagnostic = diagnostic_of(metric)
    if diagnostic:
        return diagnostic_label(metric), diagnostic.unit
    whole, _, part = metric.partition("/")
    known = METRICS.get(whole)
    return (f"{known.label}, {part.replace('_', ' ')} only", known.unit) if known else (metric, "")


def metric_label(metric: str) -> str:
    """As ``PSNR (dB) ↑``: the arrow points where better is."""
    name, unit = metric_name(metric)
    name += f" ({unit})" if unit else ""
    return f"{name} {'↑' if direction_of(metric) == 'higher' else '↓'}"


def quality_sheet(
    results: pd.DataFrame,
    layout: Layout,
    column: str = "value",
    title: str = "",
    reasons: dict[tuple[str, str, str], str] | None = None,
) -> Sheet:
    """Rows metric x method x denoising, columns scenes within splits, cells ``full / indirect``.

    Args:
        column: ``value``, ``published``, or ``half`` for half the width of the 95 % interval.
        reasons: (scene, method, variant) to why there are no figures; ``not run`` shows as a dash, all else
            as ``failed``.

    Raises:
        PrtError: for a metric nobody defines.
    """
    for metric in layout.metrics:
        if metric not in METRICS:
            raise PrtError(f"columns.metrics: unknown metric {metric!r}; choose from {', '.join(METRICS)}")
    if column == "value":
        results = results.loc[results["n"].notna()]  # rows that only the paper has are no measurements
    figures = results.assign(half=(results["hi"].astype(float) - results["lo"].astype(float)) / 2)
    keys = ["scene", "method", "variant", "split", "component", "metric"]
    lookup = figures.drop_duplicates(keys).set_index(keys)[column].astype(float).to_dict()
    reasons = reasons or {}
    groups = [
        (split_name(split), [layout.label(scene) for scene in layout.scenes]) for split in layout.splits
    ]
    sheet = Sheet(title, ["metric", "method", "denoised"], groups, [])
    for metric in layout.metrics:
        block = []
        for method, variant in layout.methods:
            for token in layout.tokens(method):
                places = [
                    [
                        (scene, method, join_variant(variant, token), split, part, metric)
                        for part in layout.components
                    ]
                    for split in layout.splits
                    for scene in layout.scenes
                ]
                values = [[lookup.get(place) for place in cell] for cell in places]
                gone = [reasons.get((cell[0][0], method, variant)) for cell in places]
                never = token and all(v is None for cell in values for v in cell)  # runs without denoising
                if never or (column != "value" and not _any_number(values)):
                    continue
                block.append((method, variant, token, values, gone))
        best = _best([row[3] for row in block], metric) if column != "half" else set()
        for i, (method, variant, token, values, gone) in enumerate(block):
            entries = [
                _entry(cell, metric, gone[j], [(i, j, k) in best for k in range(len(cell))], sheet, column)
                for j, cell in enumerate(values)
            ]
            lead = [
                metric_label(metric),
                layout.method_label(method, variant),
                "yes" if token else "–" if method in layout.as_is else "no",
            ]
            sheet.rows.append((lead, entries))
    if column == "value":
        seen = {(s, m, v): r for (s, m, v), r in reasons.items() if s in layout.scenes}
        sheet.notes += [
            f"{layout.method_label(m, v)} on {layout.label(s)}: {r}" for (s, m, v), r in seen.items()
        ]
    return sheet


def _any_number(values: list[list[float | None]]) -> bool:
    return any(v is not None and v == v for cell in values for v in cell)


def _best(rows: list[list[list[float | None]]], metric: str) -> set[tuple[int, int, int]]:
    """(row, column, part) of the best figures, as shown; nothing where there is only one."""
    show, found = figure_format(metric), set()
    pick = max if direction_of(metric) == "higher" else min
    for j in range(len(rows[0]) if rows else 0):
        for k in range(len(rows[0][j])):
            known = {
                i: float(show(row[j][k]))
                for i, row in enumerate(rows)
                if row[j][k] is not None and row[j][k] == row[j][k]
            }
            if len(known) > 1:
                found |= {(i, j, k) for i, value in known.items() if value == pick(known.values())}
    return found


def _entry(cell: list, metric: str, gone: str | None, best: list[bool], sheet: Sheet, column: str) -> Entry:
    if all(v is None for v in cell) or (column != "value" and not _any_number([cell])):
        return Entry([FAILED if gone and gone != "not run" and column == "value" else MISSING])
    show = figure_format(metric)
    if column == "value" and any(v is not None and v != v for v in cell):
        note = f"{UNAVAILABLE}: {METRICS[metric].label} could not be computed for at least one image"
        sheet.notes += [note] if note not in sheet.notes else []
    return Entry([MISSING if v is None else UNAVAILABLE if v != v else show(v) for v in cell], best)


def to_markdown(sheet: Sheet) -> str:
    """A GitHub table; a group's name is repeated in each of its column heads."""
    heads = [*sheet.lead, *(f"{h}, {g}" if g else h for g, hs in sheet.groups for h in hs)]
    lines = [f"## {sheet.title}", ""] if sheet.title else []
    lines += [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(sheet.lead) + "---:|" * (len(heads) - len(sheet.lead)),
    ]
    lines += [
        "| " + " | ".join([*lead, *(e.text("**{}**".format) for e in row)]) + " |" for lead, row in sheet.rows
    ]
    lines += ["", *(f"- {note}" for note in sheet.notes)] if sheet.notes else []
    return "\n".join(lines) + "\n"


def to_latex(sheet: Sheet) -> str:
    """A booktabs table; needs ``\\usepackage{booktabs}``."""
    count = sum(len(hs) for _, hs in sheet.groups)
    top = " & ".join(
        ["" for _ in sheet.lead] + [rf"\multicolumn{{{len(h)}}}{{c}}{{{latex(g)}}}" for g, h in sheet.groups]
    )
    heads = " & ".join([latex(h) for h in sheet.lead] + [latex(h) for _, hs in sheet.groups for h in hs])
    lines = [
        rf"% {latex(sheet.title)}",
        rf"\begin{{tabular}}{{{'l' * len(sheet.lead)}{'r' * count}}}",
        r"\toprule",
    ]
    lines += [top + r" \\"] if any(g for g, _ in sheet.groups) else []
    lines += [heads + r" \\", r"\midrule"]
    for i, (lead, row) in enumerate(sheet.rows):
        if i and lead[0] != sheet.rows[i - 1][0][0]:
            lines.append(r"\midrule")
        shown = "" if i and lead[0] == sheet.rows[i - 1][0][0] else latex(lead[0])
        cells = [shown, *map(latex, lead[1:]), *(e.text(r"\textbf{{{}}}".format, latex) for e in row)]
        lines.append(" & ".join(cells) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}", *(rf"% {latex(note)}" for note in sheet.notes)]
    return "\n".join(lines) + "\n"


def latex(text: str) -> str:
    """Text with LaTeX's special characters escaped."""
    table = {"\\": r"\textbackslash{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "–": "--"}
    return "".join(table.get(c, "\\" + c if c in "&%$#_{}" else c) for c in text)


def to_rich(sheet: Sheet, group: int = 0) -> Table:
    """One group of columns for the terminal."""
    first = sum(len(heads) for _, heads in sheet.groups[:group])
    name, heads = sheet.groups[group]
    title = f"{sheet.title}: {name}" if name else sheet.title
    table = Table(title=title, title_justify="left", caption="\n".join(sheet.notes), caption_justify="left")
    for head in sheet.lead:
        table.add_column(head)
    for head in heads:
        table.add_column(head, justify="right")
    for i, (lead, row) in enumerate(sheet.rows):
        last = i + 1 < len(sheet.rows) and sheet.rows[i + 1][0][0] != lead[0]
        cells = [e.text("[bold]{}[/bold]".format) for e in row[first : first + len(heads)]]
        table.add_row(*lead, *cells, end_section=last)
    return table

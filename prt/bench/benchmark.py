"""Tables that measure a piece of the machinery itself, not methods: ``prt table performance/record``.

The YAML names a function instead of methods; the rest of it means what it means in every table::

    benchmark: {_target_: package.module.function, size: 64}
    grid: {scene: [cornell_glossy]}
    common: [lighting=hdri]
    without_data: {common: [lighting=procedural]}      # where PRT_DATA is not set
    claims: ["record > 0.7 on ratio/paths/full, every scene"]

The function is called once per scene, as ``function(scene=..., lighting=..., **settings)``, and returns
rows with ``device, variant, component, metric, value, lo, hi, n``, and ``method`` where it is not the chosen
one. It gets what its parameters name: ``scene``, ``lighting``, ``task`` (built from both), ``method`` (the
settings of the chosen method, a dict), ``name`` (that method's), ``model`` (it fitted; the fit is kept and
resumed as that of a run), and ``folder`` (a Path), the report folder, where it may write PNG pictures that
the YAML names::

    pictures: [{file: basis.png, caption: The first eight vectors}]

It is measured anew by every call of the command: times compare only within one run on one machine.
"""

import functools
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pandas as pd
from hydra.utils import get_method
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from prt.bench import compose as composer
from prt.bench import curve_charts, layout, pictures, provenance
from prt.bench.build import build
from prt.bench.layout import Entry, Sheet
from prt.bench.report import claims_text, show
from prt.bench.results import (
    COLUMNS,
    IMAGE_COLUMNS,
    join_variant,
    merge_published,
    read_published,
    read_results,
    write_results,
)
from prt.bench.run import build_task, fitted
from prt.bench.table import check_writable, grid_overrides, say
from prt.bench.verdicts import Evidence, judge
from prt.cache import write_atomically
from prt.errors import PrtError

if TYPE_CHECKING:
    from prt.bench.spec import Spec


def main(spec: "Spec", dry_run: bool = False, console: Console | None = None) -> int:
    """Measure on every scene of the grid, write the report, print the table.

    Returns 1 where a scene failed, else 0.

    Raises:
        PrtError: for a mistake in the settings, or if no scene could be measured.
    """
    places = [(composer.compose(words), words, variant) for words, variant in grid_overrides(spec)]
    if dry_run:
        print(f"{spec.title}: {len(places)} measurements, report in {spec.report}")
        for cfg, words, _ in places:
            print(f"  {cfg.choice.scene}  {' '.join(words)}")
        return 0
    check_writable(spec.report)
    pictures.remove(spec.pictures, spec.report)
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for number, (cfg, _, variant) in enumerate(places):
        say(f"[{number + 1}/{len(places)}] measure on {cfg.choice.scene} {variant}".rstrip())
        try:
            rows += measure(spec, cfg, variant)
        except PrtError as error:
            if len(places) == 1:
                raise
            failed[cfg.choice.scene] = str(error)
            say(f"    failed: {error}")
    if not rows:
        raise PrtError("; ".join(f"{scene}: {reason}" for scene, reason in failed.items()))
    write_report(spec, places[0][0], pd.DataFrame(rows, columns=COLUMNS), failed, console or Console())
    return 1 if failed else 0


def measure(spec: "Spec", cfg: DictConfig, variant: str) -> list[dict[str, Any]]:
    """The benchmark's rows on one scene, completed to rows of ``results.csv``."""
    named = OmegaConf.create({"benchmark": spec.benchmark, "choice": {"benchmark": spec.name}})
    settings: Any = OmegaConf.to_container(cfg.method, resolve=True)
    task = functools.cache(lambda: build_task(cfg))
    makers: dict[str, Callable[[], Any]] = {
        "scene": lambda: build(cfg, "scene"),
        "lighting": lambda: build(cfg, "lighting"),
        "folder": lambda: spec.report,
        "task": task,
        "name": lambda: cfg.choice.method,
        "model": lambda: fitted(cfg, task()),
        "method": lambda: {key: value for key, value in settings.items() if key != "_target_"},
    }
    wanted = takes(str(spec.benchmark["_target_"]))
    if "method" in spec.benchmark:  # it brings settings of its own
        del makers["method"]
    objects = {name: make() for name, make in makers.items() if name in wanted}
    rows = build(named, "benchmark", **objects)
    place = {
        "scene": cfg.choice.scene,
        "method": cfg.choice.method,
        "budget": str(cfg.budget.name),
        "split": "",
        "seeds": 1,
    }
    return [{**place, **row, "variant": join_variant(row["variant"], variant)} for row in rows]


def takes(target: str) -> set[str]:
    """The parameters of the benchmark function; scene and lighting where it cannot be found."""
    try:
        return set(inspect.signature(get_method(target)).parameters)
    except Exception:  # whatever its module raises: building it says what is wrong, in one line
        return {"scene", "lighting"}


def write_report(
    spec: "Spec", cfg: DictConfig, rows: pd.DataFrame, failed: dict[str, str], console: Console
) -> None:
    """Write ``results.csv``, and from it curves, table.md, table.tex, claims.csv and report.md."""
    folder = spec.report
    published = read_published(spec.published) if spec.published else None
    write_results(merge_published(rows, published), folder / "results.csv")
    both = read_results(folder / "results.csv")
    results = both[both["n"].notna()]
    table = sheet(spec, results)
    markdown = layout.to_markdown(table)
    if spec.published:
        paper = sheet(spec, both[both["published"].notna()], "published", layout.PUBLISHED_TITLE)
        markdown += "\n" + layout.to_markdown(paper)
    write_atomically(folder / "table.md", f"# {spec.title}\n\n{markdown}".encode())
    write_atomically(folder / "table.tex", layout.to_latex(table).encode())
    scenes = list(dict.fromkeys([*results["scene"], *failed]))
    no_images = pd.DataFrame(columns=IMAGE_COLUMNS)
    verdicts = judge(spec.claims, Evidence(no_images, results, scenes, once=True))
    text = verdicts.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(folder / "claims.csv", text.encode())
    parts = [f"# {spec.title}", spec.about.strip()]
    parts.append(f"Regenerate with `{spec.command}`. Every number comes from [results.csv](results.csv).")
    methods = list(dict.fromkeys(zip(results["method"], results["variant"], strict=True)))
    plan = layout.Layout(scenes, methods, labels=spec.labels)
    notes = curve_charts.write_all(spec.curves, results, plan, folder)
    notes += pictures.missing(spec.pictures, folder)
    parts += curve_charts.markdown(spec.curves, folder) + pictures.markdown(spec.pictures, folder)
    parts += [markdown.strip(), "More forms: [table.md](table.md), [table.tex](table.tex)."]
    if len(verdicts):
        parts += ["## Claims", claims_text(verdicts)]
    parts += ["## How it was measured", how(spec, cfg, results)]
    lines = [f"- {scene}: {reason}" for scene, reason in failed.items()] + [f"- {note}" for note in notes]
    parts += ["## What is missing", "\n".join(lines) or "Nothing."]
    write_atomically(folder / "report.md", ("\n\n".join(filter(None, parts)) + "\n").encode())
    show(folder, [layout.to_rich(table)], verdicts, console)


def sheet(spec: "Spec", results: pd.DataFrame, column: str = "value", title: str = "") -> Sheet:
    """Rows by scene, method, variant, component and split, if any; a column a metric: value [interval].

    ``column``: ``value``, or ``published`` for the paper's numbers, which have no interval.
    """
    metrics = list(dict.fromkeys(results["metric"]))
    heads = [layout.metric_label(metric) for metric in metrics]
    keys = ["scene", "method", "variant", "component", *(["split"] if any(results["split"]) else [])]
    out = Sheet(title, keys, [("", heads)], [])
    for place, rows in _shared(results, keys).groupby(keys, sort=False):
        scene, method, variant, *rest = (str(part) for part in place)  # pyright: ignore
        found = {row.metric: row for row in rows.itertuples()}
        cells = [Entry([figure(found[m], column) if m in found else layout.MISSING]) for m in metrics]
        said = spec.labels.get(f"{method}[{variant}]", variant)
        lead = [spec.labels.get(scene, scene), spec.labels.get(method, method), said, *rest]
        out.rows.append((lead, cells))
    return out


def _shared(results: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The results with figures of no component or split, as a size, repeated in every row they hold for."""
    broad = [key for key in keys if key not in ("component", "split")]
    places = results[keys].drop_duplicates().to_dict("records")
    rows: list[tuple[int, dict[str, Any]]] = []
    for one in results.to_dict("records"):
        # a place of the same scene, method and variant, that is the same where this one says anything
        held = [
            (i, place)
            for i, place in enumerate(places)
            if all(place[key] == one[key] or (key not in broad and not one[key]) for key in keys)
        ]
        fuller = [(i, place) for i, place in held if any(place[key] != one[key] for key in keys)]
        rows += [(i, {**one, **place}) for i, place in fuller or held]
    return pd.DataFrame([row for _, row in sorted(rows, key=lambda at: at[0])], columns=results.columns)


def figure(row: Any, column: str = "value") -> str:
    """``0.93 [0.91, 0.95]``."""
    if column == "published":
        return f"{row.published:.3g}"
    interval = f" [{row.lo:.3g}, {row.hi:.3g}]" if row.lo == row.lo and row.hi == row.hi else ""
    return f"{row.value:.3g}{interval}"


def how(spec: "Spec", cfg: DictConfig, results: pd.DataFrame) -> str:
    """Machine, code, lighting and settings."""
    seen = provenance.collect(cfg)
    commit = (seen["commit"] or "not recorded")[:12] + (" with uncommitted changes" if seen["dirty"] else "")
    packages = ", ".join(f"{name} {version}" for name, version in seen["packages"].items() if version)
    settings = [f"{key} {value}" for key, value in spec.benchmark.items() if key != "_target_"]
    return "\n".join([
        f"- device: {'; '.join(filter(None, dict.fromkeys(results['device']))) or seen['system']}",
        f"- system: {seen['system']}, Python {seen['python']}; {seen['time']}",
        f"- code: commit {commit}, `{spec.benchmark['_target_']}`",
        f"- packages: {packages}",
        f"- settings: {', '.join(settings)}; {' '.join(spec.common)}",
    ])  # fmt: skip

"""Finished runs made into one tidy table: ``results.csv``, from which every table, claim and chart is made.

Per-image figures stay available (:func:`read_images`), because claims compare image by image.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd

from prt.bench.run_folder import METRIC_COLUMNS, RunFolder
from prt.cache import write_atomically
from prt.errors import PrtError
from prt.metrics.diagnostics import diagnostic_of
from prt.metrics.intervals import Interval, mean_interval, standard_error
from prt.metrics.registry import BAD_PIXELS, METRICS, metric_of

COLUMNS = [
    "scene", "method", "variant", "budget", "device", "split", "component", "metric",
    "value", "lo", "hi", "n", "seeds", "published",
]  # fmt: skip
#: what a row is about; two rows never share all of these
KEYS = COLUMNS[:8]
#: what a published and a measured row must share to stand side by side (a paper has its own GPU and budget)
PUBLISHED_KEYS = ["scene", "method", "variant", "split", "component", "metric"]
FEW_GROUPS = 4
#: timed for every method; a method's own parts are named in timing.json's ``parts``
TIME_SCOPES = ("gbuffer", "light", "shade", "denoise")
#: variant token of figures taken after denoising
DENOISED = "denoised"
#: PSNR of a reference against another seed of itself
NOISE_FLOOR = "noise_floor"
IMAGE_COLUMNS = [
    "scene", "method", "variant", "budget", "device", "seed",
    "split", "view", "lighting", "component", "metric", "value",
]  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One run of a table's grid and where it lies; its state is read from the folder, never kept here."""

    scene: str
    method: str
    variant: str  #: what the grid varies beside scene, method and seed, as ``wavelets=64``; empty for nothing
    seed: int
    budget: str
    run: RunFolder
    overrides: tuple[str, ...] = ()  #: the Hydra overrides that ``prt run`` takes for it

    @property
    def done(self) -> bool:
        return self.run.done

    @property
    def device(self) -> str:
        """The processor or GPU that shaded, and how many threads a CPU had."""
        seen = self.run.provenance()
        name = str(seen.get("device_name") or seen.get("device") or "")
        return (
            f"{name}, {seen['threads']} threads"
            if seen.get("device") == "cpu" and "threads" in seen
            else name
        )

    @property
    def reason(self) -> str:
        """Why there are no figures, in one line; empty for a finished run."""
        if self.run.done:
            return ""
        state = self.run.state()
        words = {"absent": "not run", "stopped": "stopped before its end", "running": "still running"}
        return self.run.failure() or words.get(state, state)


def is_cost(metric: str) -> bool:
    """Whether a metric is a time or a size: one figure a run, no images, less is better."""
    return metric.startswith(("time/", "bytes/"))


def measured_once(metric: str) -> bool:
    """Whether a metric has one figure, not one an image, and so no split: costs, some diagnostics."""
    known = diagnostic_of(metric)
    return is_cost(metric) or (known is not None and known.once)


def direction_of(metric: str) -> str:
    """``higher`` or ``lower``, from the metric's own definition.

    Raises:
        PrtError: for a metric nobody defines.
    """
    if is_cost(metric):
        return "lower"
    if metric == BAD_PIXELS:
        return "lower"
    if metric == NOISE_FLOOR:
        return "higher"
    known = diagnostic_of(metric)
    if known is not None:
        return known.direction
    # a part of an image metric's error, as psnr/fit
    return metric_of(metric.partition("/")[0]).direction


def join_variant(*tokens: str) -> str:
    """Tokens as one variant: ``wavelets=64,denoised``."""
    return ",".join(token for token in tokens if token)


def variant_tokens(variant: str) -> dict[str, str]:
    """The inverse of :func:`join_variant`, by name: ``{"wavelets": "64", "denoised": ""}``."""
    parts = (token.partition("=") for token in variant.split(",") if token)
    return {name: value for name, _, value in parts}


def read_images(cells: Iterable[Cell]) -> pd.DataFrame:
    """Every per-image figure of the finished runs (columns :data:`IMAGE_COLUMNS`).

    Raises:
        PrtError: if a finished run has no readable ``metrics.csv``.
    """
    frames = []
    for cell in cells:
        if not cell.done:
            continue
        try:
            frame = cell.run.metrics()[list(METRIC_COLUMNS)].copy()
            frame["value"] = frame["value"].astype(float)
        except (OSError, KeyError, ValueError) as error:
            where = cell.run.path
            raise PrtError(
                f"cannot read {where}/metrics.csv ({error}); compute it again with `prt score {where}`"
            ) from error
        denoised = frame.pop("denoised").astype(str).str.lower().isin(["true", "1"])
        frame["variant"] = [join_variant(cell.variant, DENOISED if flag else "") for flag in denoised]
        frame = frame.assign(
            scene=cell.scene, method=cell.method, budget=cell.budget, device=cell.device, seed=cell.seed
        )
        frames.append(frame[IMAGE_COLUMNS])
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=IMAGE_COLUMNS)


def in_views(images: pd.DataFrame, views: Sequence[str]) -> pd.DataFrame:
    """The figures of test items whose view is in the list (``*`` stands for any text); all without one."""
    if not views:
        return images
    names = images["view"].map(lambda name: any(fnmatchcase(str(name), view) for view in views))
    return cast(pd.DataFrame, images[names.astype(bool)])


def summarise(cells: list[Cell], images: pd.DataFrame, published: pd.DataFrame | None = None) -> pd.DataFrame:
    """The tidy table: means with 95 % intervals, costs, and the paper's numbers in a column of their own.

    ``n`` counts test images. The interval is over them, and over seeds where there are several.
    One figure that is not available (NaN) makes the mean not available: nothing is dropped in silence.
    """
    rows = []
    for key, group in images.groupby(KEYS, sort=False) if len(images) else ():
        values = by_seed(group)
        row = dict(zip(KEYS, key, strict=True), n=len(values), seeds=values.shape[1])
        if values.notna().all(axis=None):
            row["value"], row["lo"], row["hi"], _ = image_interval(values)
        rows.append(row)
        rows += _spread(values, key)
    rows += _cost_rows(cells)
    table = pd.DataFrame(rows, columns=COLUMNS)
    return merge_published(table, published)


def _spread(values: pd.DataFrame, key: Any) -> list[dict[str, Any]]:
    """How far the mean over images differs from seed to seed; nothing where there is one seed."""
    means = values.mean(axis=0, skipna=False)
    place = dict(zip(KEYS, key, strict=True))
    if len(means) < 2 or place["metric"] not in METRICS:
        return []
    metric = f"spread/{place['metric']}"
    return [place | {"metric": metric, "value": float(means.std()), "n": len(means), "seeds": len(means)}]


def by_seed(figures: pd.DataFrame) -> pd.DataFrame:
    """A row per (view, lighting), a column per seed; NaN where a figure is, or is missing."""
    if not len(figures):
        return pd.DataFrame(index=pd.MultiIndex.from_tuples([], names=["view", "lighting"]))
    groups = figures.groupby(["view", "lighting", "seed"], sort=True)["value"]
    return cast(pd.DataFrame, groups.agg(lambda v: v.mean(skipna=False)).unstack("seed"))


def over_seeds(values: pd.DataFrame) -> pd.Series:
    """One figure per (view, lighting): the mean over seeds, NaN where one of them is."""
    return cast(pd.Series, values.mean(axis=1, skipna=False))


def less(left: pd.DataFrame, right: pd.DataFrame) -> pd.DataFrame:
    """Left minus right, image by image, seed by seed where both have the same seeds."""
    if left.columns.equals(right.columns):
        return left - right
    return (over_seeds(left) - over_seeds(right)).to_frame()


def image_interval(values: pd.DataFrame) -> Interval:
    """The mean of figures by (view, lighting) and seed, with its 95 % interval.

    The squares of two margins are added: that of the images, averaged over seeds, and where there are
    several seeds that of the seeds' means (Student's t): fits differ, whatever images they are judged on.
    """
    mean, lo, hi, n = over_images(over_seeds(values))
    seeds = mean_interval(values.mean(axis=0, skipna=False).to_numpy(float))
    if seeds.n < 2 or not np.isfinite(seeds.hi - seeds.lo) or not np.isfinite(hi - lo):
        return Interval(mean, lo, hi, n)
    below, above = np.hypot(mean - lo, seeds.mean - seeds.lo), np.hypot(hi - mean, seeds.hi - seeds.mean)
    return Interval(mean, float(mean - below), float(mean + above), n)


def over_images(values: pd.Series) -> Interval:
    """The mean of figures indexed by (view, lighting), with its 95 % interval.

    Images of one view depend on each other, and so do images under one lighting: the wider of the two
    grouped intervals is taken. A grouping into fewer than :data:`FEW_GROUPS` says next to nothing (Student's
    t with two groups is 13 standard errors wide) and is used only where the other one is as coarse.
    """
    found = [mean_interval(values.to_numpy(float), groups=groups) for groups in _groupings(values)]
    known = [interval for interval in found if np.isfinite(interval.hi - interval.lo)]
    return max(known, key=lambda interval: interval.hi - interval.lo) if known else found[0]


def image_error(values: pd.Series) -> float:
    """Standard error of the mean of figures by (view, lighting), grouped as in :func:`over_images`."""
    found = [standard_error(values.to_numpy(float), groups) for groups in _groupings(values)]
    return max((error for error in found if np.isfinite(error)), default=np.nan)


def _groupings(values: pd.Series) -> list[list[str]]:
    """The labels, view or lighting, by which figures are taken as one draw."""
    labels = sorted((list(values.index.get_level_values(i)) for i in (0, 1)), key=lambda g: -len(set(g)))
    return [groups for groups in labels if len(set(groups)) >= FEW_GROUPS] or labels[:1]


def _cost_rows(cells: list[Cell]) -> list[dict[str, Any]]:
    """Times (median over repetitions; ``hi`` the 95th percentile) and the model's size; median over seeds."""
    found: dict[tuple, list[tuple[float, float | None]]] = {}

    def add(cell: Cell, variant: str, metric: str, value: float, p95: float | None = None) -> None:
        key = (cell.scene, cell.method, variant, cell.budget, cell.device, "", "", metric)
        found.setdefault(key, []).append((float(value), p95))

    for cell in cells:
        timing = cell.run.timing() if cell.done else {}
        names = (*TIME_SCOPES, *timing.get("parts", ()))
        scopes = {scope: timing[scope] for scope in names if isinstance(timing.get(scope), dict)}
        denoised = join_variant(cell.variant, DENOISED)
        for scope, entry in scopes.items():
            # denoising belongs to the denoised images; all else is spent either way
            add(cell, denoised if scope == "denoise" else cell.variant, f"time/{scope}", *_sum(entry))
        if "shade" in scopes:
            # what one more frame costs under a fixed light: G-buffer, shading, and denoising where done
            frame = [scopes[scope] for scope in ("gbuffer", "shade") if scope in scopes]
            add(cell, cell.variant, "time/frame", *_sum(*frame))
            if "denoise" in scopes:
                add(cell, denoised, "time/frame", *_sum(*frame, scopes["denoise"]))
        for name, metric in (("fit", "time/fit"), ("bake", "time/bake"), ("bytes", "bytes/model")):
            if timing.get(name) is not None:
                add(cell, cell.variant, metric, timing[name])
        for name, size in timing.get("sizes", {}).items():
            add(cell, cell.variant, f"bytes/{name}", size)
    rows = []
    for key, figures in found.items():
        value = float(pd.Series([f[0] for f in figures]).median())
        tails = [f[1] for f in figures if f[1] is not None]
        row = dict(zip(KEYS, key, strict=True), value=value, n=len(figures), seeds=len(figures))
        if tails:
            row["hi"] = float(pd.Series(tails).median())
        rows.append(row)
    return rows


def _sum(*entries: dict[str, float]) -> tuple[float, float]:
    """Median and 95th percentile of scopes one after the other (percentiles added: an upper bound)."""
    return sum(e["median"] for e in entries), sum(e.get("p95", e["median"]) for e in entries)


def read_published(path: Path) -> pd.DataFrame:
    """A paper's numbers: the columns of ``results.csv`` with only ``published`` filled in.

    Raises:
        PrtError: for a missing file, other columns, or a number in a measured column.
    """
    if not path.is_file():
        raise PrtError(f"published numbers not found: {path}; correct or remove `published` in the YAML")
    table = pd.read_csv(path, dtype={"variant": str, "split": str, "component": str})
    if list(table.columns) != COLUMNS:
        raise PrtError(f"{path}: columns are {list(table.columns)}; they must be {COLUMNS}")
    if table[["value", "lo", "hi"]].notna().any(axis=None):
        raise PrtError(f"{path}: a published file may fill only the column `published`, not value, lo or hi")
    for column in KEYS:
        table[column] = table[column].fillna("")
    return table


def merge_published(measured: pd.DataFrame, published: pd.DataFrame | None) -> pd.DataFrame:
    """Set the paper's numbers beside the measured ones; rows that only the paper has keep ``value`` empty."""
    if published is None or not len(published):
        return measured
    numbers = published.set_index(PUBLISHED_KEYS)["published"]
    measured = measured.copy()
    places = pd.MultiIndex.from_frame(measured[PUBLISHED_KEYS])
    measured["published"] = numbers.reindex(places).to_numpy() if len(measured) else []
    only_paper = published[~pd.MultiIndex.from_frame(published[PUBLISHED_KEYS]).isin(places)]
    frames = [frame for frame in (measured, only_paper) if len(frame)]
    return pd.concat([frame.astype(object) for frame in frames], ignore_index=True).loc[:, COLUMNS]


def write_results(table: pd.DataFrame, path: Path) -> None:
    """Write ``results.csv``: six significant digits, empty where there is no figure."""
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(path, text.encode())


def read_results(path: Path) -> pd.DataFrame:
    """Read ``results.csv`` back: text columns as text (empty, not NaN), figures as floats."""
    table = pd.read_csv(path, dtype={column: str for column in KEYS})
    for column in KEYS:
        table[column] = table[column].fillna("")
    for column in COLUMNS[8:]:
        table[column] = pd.to_numeric(table[column])
    return table

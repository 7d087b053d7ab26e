"""Finished runs made into one tidy table: ``results.csv``, from which every table, claim and chart is made.

Per-image figures stay available (:func:`read_images`), because claims compare image by image.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from prt.errors import PrtError
from prt.metrics.intervals import mean_interval

COLUMNS = [
    "scene", "method", "variant", "budget", "device", "split", "component", "metric",
    "value", "lo", "hi", "n", "seeds", "published",
]  # fmt: skip
#: what a row is about; two rows never share all of these
KEYS = COLUMNS[:8]
#: what a published row and a measured row must share to stand side by side (a paper has its own GPU and budget)
PUBLISHED_KEYS = ["scene", "method", "variant", "split", "component", "metric"]
#: variant token of figures taken after denoising
DENOISED = "denoised"
IMAGE_COLUMNS = [
    "scene", "method", "variant", "budget", "device", "seed",
    "split", "view", "lighting", "component", "metric", "value",
]  # fmt: skip
TIME_SCOPES = ("gbuffer", "light", "shade", "denoise")


@dataclass(frozen=True)
class Cell:
    """One run of a table's grid, as found on disk."""

    scene: str
    method: str
    variant: str  #: what the grid varies beside scene, method and seed, as ``wavelets=64``; empty for nothing
    seed: int
    budget: str
    state: str  #: ``done``, ``failed`` or ``missing``
    folder: Path | None = None
    reason: str = ""  #: one line: why it failed

    @property
    def device(self) -> str:
        timing = self.read_json("timing.json")
        return str(timing.get("device") or self.read_json("provenance.json").get("device") or "")

    def read_json(self, name: str) -> dict[str, Any]:
        """A JSON file of the run folder; empty where there is none (a run that failed early)."""
        path = (self.folder or Path("/nonexistent")) / name
        return json.loads(path.read_text()) if path.is_file() else {}


def join_variant(*tokens: str) -> str:
    """Tokens as one variant: ``wavelets=64,denoised``."""
    return ",".join(token for token in tokens if token)


def read_images(cells: Iterable[Cell]) -> pd.DataFrame:
    """Every per-image figure of the finished runs (columns :data:`IMAGE_COLUMNS`).

    Raises:
        PrtError: if a finished run has no readable ``metrics.csv``.
    """
    frames = []
    for cell in cells:
        if cell.state != "done" or cell.folder is None:
            continue
        path = cell.folder / "metrics.csv"
        try:
            frame = pd.read_csv(path, dtype={"view": str, "lighting": str, "denoised": str}, keep_default_na=True)
            frame = frame[["split", "view", "lighting", "component", "denoised", "metric", "value"]].copy()
        except (OSError, KeyError, ValueError) as error:
            raise PrtError(f"cannot read {path} ({error}); run `prt score {cell.folder}` to compute it again") from error
        denoised = frame.pop("denoised").fillna("").str.lower().isin(["true", "1"])
        frame["variant"] = [join_variant(cell.variant, DENOISED if flag else "") for flag in denoised]
        frame = frame.assign(
            scene=cell.scene, method=cell.method, budget=cell.budget, device=cell.device, seed=cell.seed
        )
        for column in ("split", "view", "lighting", "component"):
            frame[column] = frame[column].fillna("")
        frames.append(frame[IMAGE_COLUMNS])
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=IMAGE_COLUMNS)


def summarise(cells: list[Cell], images: pd.DataFrame, published: pd.DataFrame | None = None) -> pd.DataFrame:
    """The tidy table of means with 95 % intervals, timings and sizes, the paper's numbers in a column of their own.

    An image's figure is first averaged over seeds, so that ``n`` counts test images and the interval is over them.
    One figure that is not available (NaN) makes the mean not available: nothing is dropped in silence.
    """
    rows = []
    if len(images):
        seeds = images.groupby(KEYS, sort=False)["seed"].nunique()
        for key, group in images.groupby(KEYS, sort=False):
            values = group.groupby(["view", "lighting"], sort=False)["value"].apply(lambda v: v.mean(skipna=False))
            row = dict(zip(KEYS, key, strict=True), n=len(values), seeds=int(seeds[key]))
            if values.notna().all():
                row["value"], row["lo"], row["hi"], _ = mean_interval(values.to_numpy(dtype=float))
            rows.append(row)
    rows += _cost_rows(cells)
    table = pd.DataFrame(rows, columns=COLUMNS)
    return merge_published(table, published)


def _cost_rows(cells: list[Cell]) -> list[dict[str, Any]]:
    """Times (median over repetitions; ``hi`` the 95th percentile) and the model's size, the median over seeds."""
    found: dict[tuple, list[tuple[float, float | None]]] = {}

    def add(cell: Cell, variant: str, metric: str, value: float, p95: float | None = None) -> None:
        key = (cell.scene, cell.method, variant, cell.budget, cell.device, "", "", metric)
        found.setdefault(key, []).append((float(value), p95))

    for cell in cells:
        timing = cell.read_json("timing.json") if cell.state == "done" else {}
        scopes = {s: timing[s] for s in TIME_SCOPES if isinstance(timing.get(s), dict) and "median" in timing[s]}
        for scope, figures in scopes.items():
            variant = join_variant(cell.variant, DENOISED if scope == "denoise" else "")
            add(cell, variant, f"time/{scope}", figures["median"], figures.get("p95"))
        if "shade" in scopes:
            # what one more frame costs under a fixed light: the G-buffer, shading it, and denoising where done
            frame = [scopes[s] for s in ("gbuffer", "shade") if s in scopes]
            add(cell, cell.variant, "time/frame", *_sum(frame))
            if "denoise" in scopes:
                add(cell, join_variant(cell.variant, DENOISED), "time/frame", *_sum([*frame, scopes["denoise"]]))
        for source, metric in (("fit", "time/fit"), ("bytes", "bytes/model")):
            if timing.get(source) is not None:
                value = timing[source]
                add(cell, cell.variant, metric, value["median"] if isinstance(value, dict) else value)
    rows = []
    for key, figures in found.items():
        value = float(pd.Series([f[0] for f in figures]).median())
        tails = [f[1] for f in figures if f[1] is not None]
        row = dict(zip(KEYS, key, strict=True), value=value, n=len(figures), seeds=len(figures))
        if tails:
            row["hi"] = float(pd.Series(tails).median())
        rows.append(row)
    return rows


def _sum(parts: list[dict[str, float]]) -> tuple[float, float]:
    return sum(p["median"] for p in parts), sum(p.get("p95", p["median"]) for p in parts)


def read_published(path: Path) -> pd.DataFrame:
    """A paper's numbers: the columns of ``results.csv`` with only ``published`` filled in.

    Raises:
        PrtError: for a missing file, other columns, or a number in a measured column.
    """
    if not path.is_file():
        raise PrtError(f"published numbers not found: {path}; correct `published` in the table's YAML or remove it")
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
    return pd.concat([frame.astype(object) for frame in frames], ignore_index=True)[COLUMNS]


def write_results(table: pd.DataFrame, path: Path) -> None:
    """Write ``results.csv``: six significant digits, empty where there is no figure."""
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")


def read_results(path: Path) -> pd.DataFrame:
    """Read ``results.csv`` back: text columns as text (empty, not NaN), figures as floats."""
    table = pd.read_csv(path, dtype={column: str for column in KEYS})
    for column in KEYS:
        table[column] = table[column].fillna("")
    for column in COLUMNS[8:]:
        table[column] = pd.to_numeric(table[column])
    return table

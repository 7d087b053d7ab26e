"""Claims judged on finished runs: holds, fails or undecided, scene by scene, with the figures."""

import functools
import math
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from prt.bench.claims import Claim, Term
from prt.bench.results import NOISE_FLOOR, by_seed, direction_of, image_interval, less, measured_once
from prt.metrics.intervals import Interval, better

VERDICT_COLUMNS = ["claim", "scene", "verdict", "metric", "difference", "lo", "hi", "n", "note"]
#: the scene of a claim's last row, its verdict over all scenes
SCOPES = {"every": "every scene", "most": "most scenes", "named": "named scenes"}
#: a PSNR closer than this to the reference's own noise floor says nothing (dB)
FLOOR_MARGIN = 10.0


class _Missing(Exception):
    """No figures for one side, with the reason."""


@dataclass
class Evidence:
    """What claims are judged on."""

    images: pd.DataFrame  #: per-image figures (:func:`prt.bench.results.read_images`)
    results: pd.DataFrame  #: the tidy table, for costs and noise floors
    scenes: list[str]  #: of the table's grid
    reasons: dict[tuple[str, str], str] = field(
        default_factory=dict
    )  #: (scene, method) -> why it has no figures
    once: bool = False  #: whether every figure was taken once and stands in ``results``: a benchmark's


def judge(claims: list[Claim], evidence: Evidence) -> pd.DataFrame:
    """One row per claim and scene (``difference``: left minus right, in the metric's unit) and one for all.

    A claim holds on a scene where the whole 95 % interval lies on its side, fails where the whole interval
    lies on the other, and is undecided otherwise, as it is without figures (the note says which are missing).
    """
    rows = []
    for claim in claims:
        scenes = list(claim.scenes) or evidence.scenes
        found = [_judge_scene(claim, scene, evidence) for scene in scenes]
        verdicts = [row["verdict"] for row in found]
        counts = ", ".join(
            f"{v} on {verdicts.count(v)}" for v in ("holds", "fails", "undecided") if v in verdicts
        )
        overall = {
            "verdict": _over_scenes(verdicts, claim.scope == "most"),
            "metric": claim.metric,
            "note": counts,
        }
        rows += [*found, {"claim": claim.statement, "scene": SCOPES[claim.scope], **overall}]
    return pd.DataFrame(rows, columns=VERDICT_COLUMNS)


def _over_scenes(verdicts: list[str], most: bool) -> str:
    holds, fails = verdicts.count("holds"), verdicts.count("fails")
    if most:
        half = len(verdicts) / 2
        return "holds" if holds > half else "fails" if len(verdicts) - fails <= half else "undecided"
    return "fails" if fails else "holds" if holds == len(verdicts) > 0 else "undecided"


def _judge_scene(claim: Claim, scene: str, evidence: Evidence) -> dict:
    row = {
        "claim": claim.statement,
        "scene": scene,
        "metric": claim.metric,
        "verdict": "undecided",
        "note": "",
    }
    try:
        left = _side(claim.better, claim, scene, evidence)
        right = _side(claim.than, claim, scene, evidence)
        value, lo, hi, n = _difference(left, right)
    except _Missing as missing:
        return row | {"note": str(missing)}
    row |= {"difference": value, "lo": lo, "hi": hi, "n": n}
    if not np.isfinite(hi - lo):
        return row | {
            "note": f"{n} image(s) give no interval" if np.isfinite(value) else "a figure is not available"
        }
    if claim.within is not None:
        inside, outside = lo >= -claim.within and hi <= claim.within, lo > claim.within or hi < -claim.within
        verdict = "holds" if inside else "fails" if outside else "undecided"
    else:
        verdict = better(Interval(value, lo, hi, n), direction_of(claim.metric), claim.margin)
    floor = _noise_floor(claim, scene, evidence)
    if floor is not None and min(left.level, right.level) > floor - FLOOR_MARGIN:
        verdict, row["note"] = (
            "undecided",
            f"within {FLOOR_MARGIN:g} dB of the reference's noise floor {floor:.1f} dB",
        )
    return row | {"verdict": verdict}


@dataclass
class _Side:
    values: pd.DataFrame | None  #: by (view, lighting) and seed; None for a number or what is measured once
    mean: Interval
    splits: frozenset[str]
    level: float  #: the lowest mean among its terms, to hold against the noise floor


def _side(terms: tuple[Term, ...], claim: Claim, scene: str, evidence: Evidence) -> _Side:
    parts = [_figures(term, claim, scene, evidence) for term in terms]
    first, rest = parts[0], parts[1:]
    if not rest:
        return first
    series = [part.values for part in parts]
    if any(s is None for s in series) or any(not s.index.equals(series[0].index) for s in series):
        raise _Missing("the terms of a difference were not measured on the same images")
    values = functools.reduce(less, series)
    level = min(part.level for part in parts)
    return _Side(values, image_interval(values), frozenset().union(*(part.splits for part in parts)), level)


def _figures(term: Term, claim: Claim, scene: str, evidence: Evidence) -> _Side:
    if not term.method:
        return _Side(None, Interval(term.number, term.number, term.number, 1), frozenset(), math.inf)
    split = term.split or claim.split

    def found(source: pd.DataFrame, split: str) -> pd.DataFrame:
        wanted = (
            (source["scene"] == scene) & (source["method"] == term.method)
            & (source["variant"] == term.variant) & (source["metric"] == claim.metric)
            & (source["component"] == claim.component) & (source["split"] == split)
        )  # fmt: skip
        return source.loc[wanted]

    if evidence.once or measured_once(claim.metric):
        places = dict.fromkeys([split, ""] if evidence.once else [""])
        rows = pd.concat([found(evidence.results, place) for place in places])
        rows = rows[rows["value"].notna()]
        if len(rows):
            row = rows.iloc[0]
            value, lo, hi = (float(row[name]) for name in ("value", "lo", "hi"))
            lo, hi = (value if bound != bound else bound for bound in (lo, hi))
            return _Side(None, Interval(value, lo, hi, 1), frozenset(), math.inf)
    # also what is usually measured once, where a task took it image by image
    rows = found(evidence.images, split)
    if not len(rows):
        raise _Missing(_why_missing(term, claim, scene, split, evidence))
    values = by_seed(rows)
    interval = image_interval(values)
    return _Side(values, interval, frozenset([split]), interval.mean)


def _why_missing(term: Term, claim: Claim, scene: str, split: str, evidence: Evidence) -> str:
    name = term.method + (f"[{term.variant}]" if term.variant else "")
    images = evidence.images
    known = list(dict.fromkeys(images.loc[images["scene"] == scene, "split"]))
    reason = f"no {claim.metric} figures"
    if split and known and split not in known:
        reason += f" of split {split}, there are {', '.join(known)}"
    return f"{name}: {evidence.reasons.get((scene, term.method), reason)}"


def _difference(left: _Side, right: _Side) -> Interval:
    """Left minus right: image by image where both have the same, else between two independent means."""
    if left.values is not None and right.values is not None and left.splits == right.splits:
        if not left.values.index.equals(right.values.index):
            raise _Missing(
                "the two sides were not measured on the same images; run both with the same settings"
            )
        return image_interval(less(left.values, right.values))
    a, b = left.mean, right.mean
    value = a.mean - b.mean
    below, above = math.hypot(a.mean - a.lo, b.hi - b.mean), math.hypot(a.hi - a.mean, b.mean - b.lo)
    return Interval(
        value, value - below, value + above, min(s.mean.n for s in (left, right) if s.splits or s is left)
    )


def _noise_floor(claim: Claim, scene: str, evidence: Evidence) -> float | None:
    """The reference's PSNR against a second seed, where it was measured for this scene."""
    if claim.metric != "psnr" or not len(evidence.results):
        return None
    r = evidence.results
    rows = r[(r["scene"] == scene) & (r["metric"] == NOISE_FLOOR) & (r["component"] == claim.component)]
    splits = {term.split or claim.split for term in (*claim.better, *claim.than) if term.method}
    values = rows.loc[rows["split"].isin(list(splits)), "value"].dropna()
    return float(values.min()) if len(values) else None

"""How good the advice of ``prt needs`` is: judged against a table's full sweep over sizes.

A table's YAML asks for it beside ``enough``, whose axes, split and distance it takes::

    advice: {scenes: [cornell_glossy, four_animals]}     # {} for every scene

What is advised is a configuration; the nearest rung of the sweep stands for it, in powers of two of the
settings that the rungs vary. The knee is the rung that ``enough`` names.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import pandas as pd
from omegaconf import DictConfig

from prt.bench import compose
from prt.bench.chart import Axis
from prt.bench.enough import Rung, best_of, knee, nearly, rungs_of
from prt.bench.layout import Layout
from prt.bench.results import Cell
from prt.methods.advice import Advice

Cells = Sequence[tuple[Cell, DictConfig]]
COLUMNS = (
    "scene", "advice", "method", "variant", "cost", "figure", "knee", "knee_cost", "knee_figure", "steps",
    "enough", "rival", "rival_variant", "rival_figure",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Judged:
    """The advice for one scene beside what the sweep says.

    Attributes:
        rung: the nearest size of the advised method in the sweep; None where it has none there.
        knee: the smallest size that is enough.
        steps: sizes that the rung lies above the knee; negative below it.
        enough: whether the rung's own figure is within the distance of its method's best.
        rival: the method and the size of the best figure at no more cost than the rung's.
    """

    scene: str
    method: str
    overrides: tuple[str, ...]
    rung: Rung | None = None
    knee: Rung | None = None
    steps: int = 0
    enough: bool = False
    rival: tuple[str, Rung] | None = None

    def row(self) -> dict[str, Any]:
        """A line of ``advice.csv``."""
        rung, knee, (rival, best) = self.rung, self.knee, self.rival or ("", None)
        values = (
            self.scene, " ".join(self.overrides), self.method,
            *(rung or ("", math.nan, math.nan)), *(knee or ("", math.nan, math.nan)),
            self.steps if rung else math.nan, self.enough if rung else "",
            rival, best.variant if best else "", best.figure if best else math.nan,
        )  # fmt: skip
        return dict(zip(COLUMNS, values, strict=True))


def judge(
    cells: Cells,
    results: pd.DataFrame,
    plan: Layout,
    settings: dict[str, Any],
    advice: dict[str, list[Advice]],
) -> list[Judged]:
    """The advice for every scene against the sweep's results.

    Args:
        settings: of the table's ``enough``.
    """
    x, y = Axis.parse(str(settings["x"])), Axis.parse(str(settings["y"]))
    split, within = str(settings.get("split") or plan.splits[0]), float(settings["within"])
    found = []
    for scene, given in advice.items():
        overrides = tuple(each.override for each in given)
        method = next(word.partition("=")[2] for word in overrides if word.startswith("method="))
        rungs = rungs_of(results, scene, method, x, y, split)
        nearest = nearest_rung([c for c in cells if c[0].scene == scene and c[0].method == method], overrides)
        at = next((i for i, rung in enumerate(rungs) if rung.variant == nearest), None)
        if at is None:
            found.append(Judged(scene, method, overrides))
            continue
        rung, enough = rungs[at], knee(rungs, y, within)
        rivals = [
            (other, one)
            for other in dict.fromkeys(m for m, _ in plan.methods)
            for one in rungs_of(results, scene, other, x, y, split)
            if one.cost <= rung.cost
        ]
        best = best_of([one for _, one in rivals], y)
        found.append(
            Judged(
                scene, method, overrides, rung, enough, at - rungs.index(enough),
                nearly(rung.figure, best_of(rungs, y).figure, y, within),
                next(rival for rival in rivals if rival[1] is best),
            )
        )  # fmt: skip
    return found


def nearest_rung(rungs: Cells, overrides: Sequence[str]) -> str | None:
    """The variant nearest to a configuration; None where it has no number for what they vary."""
    if not rungs:
        return None
    shared = [word for word in rungs[0][0].overrides if all(word in cell.overrides for cell, _ in rungs)]
    wanted = numbers(compose.compose([*shared, *overrides]))
    own = {cell.variant: numbers(cfg) for cell, cfg in rungs}
    keys = [key for key in wanted if len({sizes.get(key) for sizes in own.values()}) > 1]
    if not keys:
        return None

    def distance(variant: str) -> float:
        pairs = [(wanted[key], own[variant].get(key, 0.0)) for key in keys]
        return sum(abs(math.log2(max(a, 0.5) / max(b, 0.5))) for a, b in pairs)

    return min(own, key=distance)


def numbers(cfg: DictConfig, prefix: str = "") -> dict[str, float]:
    """The numbers among the settings of task and method, by dotted name; logarithms undone."""
    found: dict[str, float] = {}
    groups = {"task": cfg.task, "method": cfg.method} if not prefix else cfg
    for key, value in groups.items():
        name = f"{prefix}{key}"
        if isinstance(value, DictConfig):
            found |= numbers(value, f"{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[name] = 2.0**value if str(key).startswith("log2_") else float(value)
    return found


def markdown(judged: Sequence[Judged], plan: Layout, settings: dict[str, Any]) -> str:
    """The section of a report: how often the advice lies on the knee, and how far off otherwise."""
    x, y = Axis.parse(str(settings["x"])), Axis.parse(str(settings["y"]))
    lines = [
        "| scene | advised | its size in the sweep | "
        f"{x.label} | {y.label} | smallest that is enough | off by | best at no more cost |",
        "|---|---|---|---:|---:|---|---:|---|",
    ]
    for one in judged:
        said = " ".join(f"`{word}`" for word in one.overrides)
        if one.rung is None or one.knee is None or one.rival is None:
            lines.append(f"| {plan.label(one.scene)} | {said} | not in this sweep | – | – | – | – | – |")
            continue
        off = (
            "on the knee"
            if not one.steps
            else f"{one.steps:+d} sizes, {one.rung.cost / one.knee.cost:.2g} times"
        )
        off += "" if one.enough else f", {abs(one.rung.figure - one.knee.figure):.3g} worse"
        rival = "itself" if one.rival[1] == one.rung else (
            f"{plan.method_label(one.rival[0], one.rival[1].variant)}: {one.rival[1].figure:.4g}"
        )  # fmt: skip
        lines.append(
            f"| {plan.label(one.scene)} | {said} | {plan.variant_label(one.method, one.rung.variant)} "
            f"| {one.rung.cost * x.scale:.3g} | {one.rung.figure:.4g} "
            f"| {plan.variant_label(one.method, one.knee.variant)} | {off} | {rival} |"
        )
    known = [one for one in judged if one.rung is not None]
    count = sum(not one.steps for one in known)
    good = sum(one.enough for one in known)
    lines += [
        "",
        f"On the knee in {count} of {len(known)} scenes, large enough in {good}; "
        "measured without training ([advice.csv](advice.csv)).",
    ]
    return "\n".join(lines)


def table(judged: Sequence[Judged]) -> pd.DataFrame:
    """``advice.csv``."""
    return pd.DataFrame([one.row() for one in judged], columns=list(COLUMNS))

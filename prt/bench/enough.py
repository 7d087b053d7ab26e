"""The smallest rung of a ladder that is nearly as good as the best, read from a table's results.

A table's YAML asks for it::

    enough: {y: mape/full, x: bytes/model, within: 0.1, split: inside}

``within`` is a share of the best figure where lower is better, and an amount where higher is.
"""

from typing import Any, NamedTuple

import pandas as pd

from prt.bench.chart import Axis
from prt.bench.layout import Layout, split_name
from prt.bench.results import direction_of
from prt.errors import PrtError


class Rung(NamedTuple):
    """One size of a method: what it varies, its cost, its figure."""

    variant: str
    cost: float
    figure: float


def check(settings: dict[str, Any]) -> None:
    """Raises PrtError for a missing key, a wrong axis or a distance that is no positive number."""
    for key in ("x", "y", "within"):
        if key not in settings:
            raise PrtError(f"enough: {key} is missing; write {{y: mape/full, x: bytes/model, within: 0.1}}")
    for key in ("x", "y"):
        Axis.parse(str(settings[key]))
    if not isinstance(settings["within"], int | float) or settings["within"] <= 0:
        raise PrtError(f"enough: within={settings['within']!r} must be a number above 0")


def markdown(results: pd.DataFrame, plan: Layout, settings: dict[str, Any]) -> list[str]:
    """One line a scene and method that comes in several sizes."""
    if not settings:
        return []
    x, y = Axis.parse(str(settings["x"])), Axis.parse(str(settings["y"]))
    split, within = str(settings.get("split") or plan.splits[0]), float(settings["within"])
    lines = []
    for scene in plan.scenes:
        for method in dict.fromkeys(method for method, _ in plan.methods):
            rungs = rungs_of(results, scene, method, x, y, split)
            if len(rungs) < 2:
                continue
            (name, cost, figure), best = knee(rungs, y, within), best_of(rungs, y)
            distance = f"{within:g}" if direction_of(y.metric) == "higher" else f"{within:.0%}"
            lines.append(
                f"- {plan.label(scene)}, {split_name(split)}: {plan.method_label(method, name)}, "
                f"{cost * x.scale:.3g} of {x.label}, has {figure:.4g} of {y.label}: the smallest within "
                f"{distance} of the best, {best.figure:.4g} of {best.variant} ({best.cost * x.scale:.3g})."
            )
    return lines


def best_of(rungs: list[Rung], y: Axis) -> Rung:
    """The rung of the best figure."""
    return (max if direction_of(y.metric) == "higher" else min)(rungs, key=lambda rung: rung.figure)


def knee(rungs: list[Rung], y: Axis, within: float) -> Rung:
    """The cheapest rung whose figure is within this distance of the best one's."""
    return next(rung for rung in rungs if nearly(rung.figure, best_of(rungs, y).figure, y, within))


def nearly(figure: float, best: float, y: Axis, within: float) -> bool:
    """Whether a figure is within this distance of the best."""
    return figure >= best - within if direction_of(y.metric) == "higher" else figure <= best * (1 + within)


def rungs_of(results: pd.DataFrame, scene: str, method: str, x: Axis, y: Axis, split: str) -> list[Rung]:
    """Every size of a method on a scene, the cheapest first."""
    own = results[(results["scene"] == scene) & (results["method"] == method) & results["value"].notna()]
    cost = own[(own["metric"] == x.metric) & (own["component"] == x.component)]
    good = own[(own["metric"] == y.metric) & (own["component"] == y.component) & (own["split"] == split)]
    costs = dict(zip(cost["variant"], cost["value"].astype(float), strict=True))
    figures = dict(zip(good["variant"], good["value"].astype(float), strict=True))
    found = [Rung(variant, costs[variant], figure) for variant, figure in figures.items() if variant in costs]
    return sorted(found, key=lambda rung: rung.cost)

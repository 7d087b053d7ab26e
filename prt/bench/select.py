"""``prt select``: the smallest model that meets a target, found by walking a method's ladder from below.

A rung is a run like any other: done ones are read, missing ones carried out, and a stopped walk goes on where
it was. The walk ends at the first rung that meets the target, or where rungs bring nothing more.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from prt.bench import compose, ladder, table
from prt.bench import run as runner
from prt.bench.chart import Axis
from prt.bench.curves import axis_key
from prt.bench.layout import splits_of
from prt.bench.results import Cell, by_seed, direction_of, image_error, over_seeds, read_images, summarise
from prt.bench.spec import Spec
from prt.bench.target import HOW, Target
from prt.errors import PrtError

#: rungs in a row that raise quality by less than one standard error end a walk
IDLE = 2
#: what ``prt select`` itself reads among the words of its command line
OWN = ("target", "over", "split", "quality", "report")


@dataclasses.dataclass(frozen=True)
class Rung:
    """One size of the method and what it came to.

    Attributes:
        value, error: of the target's metric, mean over test images and its standard error; a cost has none.
        quality, quality_error: of the metric that ranks rungs; the target's own unless that is a cost.
        bytes, shade: size of the model, and seconds that shading a frame takes.
    """

    cell: Cell
    value: float
    error: float
    quality: float
    quality_error: float
    bytes: float
    shade: float

    @property
    def name(self) -> str:
        return self.cell.variant or "as configured"


@dataclasses.dataclass(frozen=True)
class Answer:
    """The rungs that were walked, smallest first, the chosen one, and why."""

    rungs: list[Rung]
    chosen: Rung | None
    reason: str


@dataclasses.dataclass(frozen=True)
class Walk:
    """What is looked for.

    Attributes:
        quality: the metric that ranks rungs.
        split: the test images that count.
    """

    target: Target
    quality: Axis
    split: str

    def go(
        self, cells: Sequence[tuple[Cell, DictConfig]], carry_out: Callable[[DictConfig], Any] = runner.run
    ) -> Answer:
        """Carry out rung by rung, smallest first, and choose.

        A quality target is met by the first rung that is not below it by more than one standard error. Under
        a cost target the walk ends at the first rung that costs more; of those that fit, the smallest is
        chosen that is within one standard error of the best.

        Raises:
            PrtError: where a run fails, or has no such figure.
        """
        rungs: list[Rung] = []
        for number, (cell, cfg) in enumerate(cells, 1):
            runner.say(f"[{number}/{len(cells)}] {table.called(cell)}")
            carry_out(cfg)
            rungs.append(self.measured(cell))
            met = self.target.met(rungs[-1].value, _known(rungs[-1].error))
            if met != self.target.of_cost:  # a good one, or the first that is too dear
                break
            if not self.target.of_cost and self.idle(rungs):
                why = f"the last {IDLE} rungs brought less than a standard error; larger ones are not tried"
                return Answer(rungs, None, why)
        if self.target.of_cost:
            return self.within_cost(rungs)
        if self.target.met(rungs[-1].value, _known(rungs[-1].error)):
            return Answer(rungs, rungs[-1], "the smallest that meets the target within one standard error")
        return Answer(rungs, None, "the largest rung misses the target")

    def within_cost(self, rungs: list[Rung]) -> Answer:
        """Of the rungs that fit, the smallest within one standard error of the best one's quality."""
        fitting = [rung for rung in rungs if self.target.met(rung.value)]
        if not fitting:
            return Answer(rungs, None, "the smallest rung costs more than the target")
        best = max(fitting, key=self.rank)
        least = self.rank(best) - _known(best.quality_error)
        chosen = next(rung for rung in fitting if self.rank(rung) >= least)
        return Answer(rungs, chosen, "the smallest within one standard error of the best that fits")

    def idle(self, rungs: list[Rung]) -> bool:
        """Whether the last rungs brought nothing over the best one before that is more than noise."""
        if len(rungs) <= IDLE:
            return False
        before = max(map(self.rank, rungs[:-IDLE]))
        return all(self.rank(rung) <= before + _known(rung.quality_error) for rung in rungs[-IDLE:])

    def rank(self, rung: Rung) -> float:
        """Quality of a rung; higher is better."""
        return rung.quality if direction_of(self.quality.metric) == "higher" else -rung.quality

    def measured(self, cell: Cell) -> Rung:
        """The figures of a finished rung."""
        images = read_images([cell])
        costs = summarise([cell], images.iloc[:0])
        cost = {row.metric: float(row.value) for row in costs.itertuples() if row.variant == cell.variant}
        quality = self._mean(cell, images)
        if not self.target.of_cost:
            value = quality
        elif self.target.metric in cost:
            value = (cost[self.target.metric], 0.0)
        else:
            raise PrtError(f"{cell.run.path} has no {self.target.metric}; it has {', '.join(sorted(cost))}")
        return Rung(cell, *value, *quality, cost.get("bytes/model", np.nan), cost.get("time/shade", np.nan))

    def _mean(self, cell: Cell, images: pd.DataFrame) -> tuple[float, float]:
        """Mean and standard error of the ranking metric over the test images of the split, as rendered."""
        rows = images[
            (images["metric"] == self.quality.metric)
            & (images["component"] == self.quality.component)
            & (images["variant"] == cell.variant)
        ]
        mine = cast(pd.DataFrame, rows[rows["split"] == self.split])
        if not len(mine):
            known = ", ".join(sorted(set(rows["split"]))) or "none"
            raise PrtError(
                f"{cell.run.path} has no {axis_key(self.quality)} on split={self.split}; "
                f"splits with it: {known}"
            )
        values = over_seeds(by_seed(mine))
        return float(values.mean(skipna=False)), image_error(values)


def _known(error: float) -> float:
    """A standard error, 0 where one image alone gives none."""
    return error if np.isfinite(error) else 0.0


def main(words: Sequence[str]) -> int:
    """``prt select [overrides] "target=..." [over=...] [split=...] [quality=...] [report=...]``.

    Prints the rungs and the answer, and writes a report with the curve that shows it.

    Returns:
        0 with an answer, 1 where no rung meets the target.

    Raises:
        PrtError: for a mistake in the command line, or a run that fails.
    """
    own = {key: value for key, _, value in (word.partition("=") for word in words) if key in OWN}
    overrides = [word for word in words if word.partition("=")[0] not in OWN]
    if "target" not in own:
        raise PrtError(f"no target; {HOW}")
    target = Target.parse(own["target"])
    cfg = compose.compose(overrides)  # a mistake is said before anything runs
    method = str(cfg.choice.method)
    chosen = [word for word in overrides if not word.startswith("method=")]
    rungs = ladder.over(own["over"]) if "over" in own else ladder.ladder_of(method, chosen)
    spec = spec_of(cfg, chosen, method, rungs, target, words, own.get("report"))
    cells = table.resolve(spec)
    task = runner.build_task(cfg)
    quality = Axis.parse(own["quality"]) if "quality" in own else default_quality(cfg, task, target)
    split = own.get("split") or splits_of(item.split for item in task.tests())[0]
    table.check_writable(spec.report)
    answer = Walk(target, quality, split).go(cells)
    tell(answer, target, quality, split, spec)
    return 0 if answer.chosen else 1


def default_quality(cfg: DictConfig, task: Any, target: Target) -> Axis:
    """The target's metric; for a cost the first metric of the run, on the task's own component."""
    if not target.of_cost:
        return Axis(target.metric, target.component)
    own = runner.build(cfg, "method").component.value
    scored = getattr(task, "components", (own,))
    return Axis(str(cfg.run.metrics[0]), own if own in scored else scored[0])


def spec_of(
    cfg: DictConfig, overrides: list[str], method: str, rungs: list[str], target: Target,
    words: Sequence[str], report: str | None,
) -> Spec:  # fmt: skip
    """The walk as a table, so that its report is made like any other."""
    scene = [word for word in overrides if word.startswith("scene=")]
    common = [word for word in overrides if not word.startswith(("scene=", "seed="))]
    folder = Path(report or f"reports/select/{cfg.choice.task}_{cfg.choice.scene}_{method}")
    return Spec(
        name=" ".join(f'"{w}"' if any(c in w for c in "<>[] ") else w for w in words), path=folder,
        title=f"The smallest {method} with {target} on {cfg.choice.scene}",
        grid={
            "scene": [scene[-1].partition("=")[2] if scene else str(cfg.choice.scene)],
            "method": [f"{method} {rung}" for rung in rungs],
            "seed": [str(cfg.seed)],
        },
        common=common, report=folder, overrides=[], verb="prt select",
    )  # fmt: skip


def tell(answer: Answer, target: Target, quality: Axis, split: str, spec: Spec) -> None:
    """Print the rungs and the answer, and write the report of those that were walked."""
    from prt.bench.report import write_report

    cells = [rung.cell for rung in answer.rungs]
    spec.columns = {"metrics": [quality.metric], "components": [quality.component], "splits": [split]}
    spec.chart = {"x": "bytes/model", "y": axis_key(quality), "split": split}
    if len({rung.bytes for rung in answer.rungs}) == 1:  # sizes that differ in arithmetic alone
        spec.chart["x"] = "time/shade"
    if not target.of_cost:
        spec.chart["target"] = target.value
    said = (
        f"{answer.chosen.name}: {answer.reason}"
        if answer.chosen
        else f"no rung meets {target}: {answer.reason}"
    )
    spec.about = f"{said}. Rungs were walked from the smallest on, split {split}."
    write_report(spec, table.layout_of(spec, cells), cells, console=Console(quiet=True))
    shown = Table(title=f"{spec.title} (split {split})", title_justify="left")
    ranked = [axis_key(quality), "± error"] if target.of_cost else []
    for name in ("rung", target.axis, "± error", *ranked, "bytes", "s/frame", ""):
        shown.add_column(name, justify="left" if name in ("rung", "") else "right")
    for rung in answer.rungs:
        figures = [f"{rung.value:.4g}", f"{rung.error:.2g}"]
        figures += [f"{rung.quality:.4g}", f"{rung.quality_error:.2g}"] if ranked else []
        chosen = "<- chosen" if rung is answer.chosen else ""
        shown.add_row(rung.name, *figures, f"{rung.bytes:.3g}", f"{rung.shade:.3g}", chosen)
    Console(width=140).print(shown)
    print(said)
    if answer.chosen:
        print(f"prt run {' '.join(answer.chosen.cell.overrides)}")
    print(f"report: {spec.report / 'report.md'}")

"""``prt table``: a table's YAML resolved to runs, the missing ones run, and the report made.

What the YAML may hold stands in :mod:`prt.bench.spec`.
"""

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig, OmegaConf

from prt.bench import compose as composer
from prt.bench import launch, launchers
from prt.bench import run as runner
from prt.bench.cost import Cost, Watch, clock
from prt.bench.layout import Layout
from prt.bench.results import Cell
from prt.bench.score import complete
from prt.bench.spec import Spec, find, has_matrix, load_spec
from prt.cache import settings_key, write_atomically
from prt.errors import PrtError
from prt.metrics.registry import METRICS

if TYPE_CHECKING:
    from prt.bench import advised

#: grid axes with columns of their own in the results; all others make the variant
NAMED = ("scene", "method", "seed")


def grid_overrides(spec: Spec) -> list[tuple[list[str], str]]:
    """Every run of the grid, scene by scene: (Hydra overrides, variant)."""
    axes = ["scene", *(k for k in spec.grid if k not in NAMED), "method", "seed"]
    axes = [axis for axis in axes if axis in spec.grid]  # a benchmark has no methods
    found = []
    for values in itertools.product(*(spec.grid[axis] for axis in axes)):
        variant: list[str] = []
        overrides: list[str] = []
        of_named: list[str] = []
        for axis, value in zip(axes, values, strict=True):
            first, *extra = value.split()
            of_named += spec.settings.get(first, []) if axis in ("scene", "method") else []
            overrides.append(f"{axis}={first}")
            overrides += extra
            variant += [short(text) for text in ([] if axis in NAMED else [f"{axis}={first}"]) + extra]
        named = {axis: value.split()[0] for axis, value in zip(axes, values, strict=True)}
        of_named += spec.settings.get(f"{named['scene']}/{named.get('method', '')}", [])
        # the command line's settings are in common and win
        found.append(([*of_named, *spec.common, *overrides], ",".join(variant)))
    return found


def short(override: str) -> str:
    """``method.wavelets=16`` as ``wavelets=16``, the form variants are written in."""
    key, equals, value = override.lstrip("+").partition("=")
    return key.rpartition(".")[2] + equals + value


def resolve(spec: Spec, gpu: bool | None = None) -> list[tuple[Cell, DictConfig]]:
    """The grid as cells with their composed configurations; a mistake in any stops before anything runs.

    ``gpu`` as in :func:`prt.bench.compose.compose`.
    """
    cells = []
    for overrides, variant in grid_overrides(spec):
        cfg = composer.compose(overrides, gpu)
        cell = Cell(
            cfg.choice.scene, cfg.choice.method, variant, int(cfg.seed), str(cfg.budget.name),
            runner.folder_of(cfg), tuple(overrides),
        )  # fmt: skip
        cells.append((cell, cfg))
    return cells


def layout_of(spec: Spec, cells: Sequence[Cell]) -> Layout:
    """Order and labels of rows and columns, from the grid and ``columns``.

    Raises:
        PrtError: for an unknown metric in ``columns``, method in ``figure.columns`` or row in ``labels``.
    """
    for metric in spec.columns.get("metrics", []):
        if metric not in METRICS:
            raise PrtError(
                f"{spec.path}: unknown metric {metric!r} in columns.metrics; choose from {', '.join(METRICS)}"
            )
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    methods = list(dict.fromkeys((cell.method, cell.variant) for cell in cells))
    plan = Layout(scenes, methods, labels=spec.labels, **spec.columns)
    if not spec.overrides:  # they may leave out rows that have labels
        plan.chosen([name for name in spec.labels if "[" in name], f"{spec.path}: labels")
        if unknown := [s for s in (spec.advice or {}).get("scenes", []) if s not in scenes]:
            raise PrtError(
                f"{spec.path}: advice.scenes: no scene {unknown[0]!r}; choose from {', '.join(scenes)}"
            )
    plan.chosen(spec.figure.get("columns") or [], f"{spec.path}: figure.columns")
    return plan


def run_missing(
    cells: Sequence[tuple[Cell, DictConfig]],
    carry_out: Callable[[DictConfig], Any] = runner.run,
    cost: Cost | None = None,
) -> dict[Cell, str]:
    """Run what is not done here, one after the other; returns the reasons of those that failed.

    A failure does not stop the rest. ``cost`` gets the account.
    """
    failed: dict[Cell, str] = {}
    cost = cost or Cost()
    todo = begin(cells, cost)
    for cell, cfg in todo:
        say(f"[{cost.runs + 1}/{len(todo)}] {called(cell)}: {progress(cost, len(todo))}")
        watch = Watch(cell.run)
        try:
            carry_out(cfg)
        except PrtError as error:
            failed[cell] = str(error)
        except (
            Exception
        ) as error:  # a bug in one run must not cost the others; its traceback lies in its folder
            failed[cell] = f"{type(error).__name__}: {' '.join(str(error).split())}"
        cost.add(watch.parts(), cell in failed)
        if cell in failed:
            say(f"    failed: {failed[cell]}")
    return failed


def send_missing(
    cells: Sequence[tuple[Cell, DictConfig]], launcher: Launcher, settings: launchers.Settings, cost: Cost
) -> dict[Cell, str]:
    """Send what is not done to a launcher, every run a job of its own; returns as :func:`run_missing`.

    Raises:
        PrtError: where the launcher's engine cannot be reached.
    """
    todo = [cell for cell, _ in begin(cells, cost)]
    plans = [launch.plan(cell.overrides, settings) for cell in todo]
    place = {plan.run.path: cell for plan, cell in zip(plans, todo, strict=True)}

    def tell(plan: launch.Plan, outcome: launch.Outcome) -> None:
        came = f"failed: {outcome.reason}" if outcome.reason else "done"
        say(
            f"[{cost.runs}/{len(place)}] {called(place[plan.run.path])}: {came}; {progress(cost, len(place))}"
        )

    found = launch.deliver(launcher, settings, plans, cost, tell)
    return {cell: one.reason for cell, one in zip(todo, found, strict=True) if one.reason}


def begin(cells: Sequence[tuple[Cell, DictConfig]], cost: Cost) -> list[tuple[Cell, DictConfig]]:
    """Say what there is to do, and return it."""
    todo = [(cell, cfg) for cell, cfg in cells if not cell.done]
    cost.before = len(cells) - len(todo)
    for cell, cfg in cells:
        if cell.done:
            complete(cell.run, list(cfg.run.metrics))
    say(f"{len(cells)} runs: {cost.before} done already, {len(todo)} to run")
    return todo


def called(cell: Cell) -> str:
    """A run as people call it."""
    return f"{cell.scene} {cell.method}{f' {cell.variant}' if cell.variant else ''} seed {cell.seed}"


def progress(cost: Cost, runs: int) -> str:
    """How long it took so far, and may still take at this pace."""
    spent = time.monotonic() - cost.started
    left = f", about {clock(spent / cost.runs * (runs - cost.runs))} left" if 0 < cost.runs < runs else ""
    return f"{clock(spent)} elapsed{left}"


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main(name: str, overrides: Sequence[str] = (), dry_run: bool = False) -> int:
    """``prt table <name> [--dry-run] [overrides]``: run what is missing, write the report, print the table.

    With ``launcher=ray`` or another, every missing run is a job of that launcher, and the report is written
    here when all have ended. Benchmarks are always measured in this process. What the runs of this call cost
    is printed, and added to the report folder's ``cost.json``.

    Returns 1 where some run failed or its worker died, else 0. Raises PrtError for a mistake in the YAML or
    the overrides.
    """
    path = find(name)
    if has_matrix(path):
        from prt.bench import matrix_report

        return matrix_report.main(name, path, list(overrides))
    spec = load_spec(name, overrides)
    if spec.benchmark:
        from prt.bench import benchmark

        if spec.launcher:
            say(f"{spec.launcher[0]}: a benchmark is measured in this process, one scene after the other")
        return benchmark.main(spec, dry_run)
    with composer.reported(spec.launcher):
        place = [text for text in spec.common if text.startswith("run.folder=")]
        master, context, settings = launchers.master([*spec.launcher, *place])
    cells = resolve(spec, settings.gpu)
    layout = layout_of(spec, [cell for cell, _ in cells])
    if dry_run:
        print(f"{spec.title}: {len(cells)} runs, report in {spec.report}")
        for cell, _ in cells:
            print(f"  {cell.run.state():8} {cell.run.path}  prt run {' '.join(cell.overrides)}")
        return 0
    check_writable(spec.report)  # before hours of runs, not after
    cost = Cost()
    if settings.here:
        if settings.threads is not None:
            launch.limit_threads(settings.threads)
        failed = run_missing(cells, cost=cost)
    else:
        failed = send_missing(
            cells, launchers.plugin(master, context, launch.job_of(settings)), settings, cost
        )

    from prt.bench.report import write_report

    write_report(
        spec, layout, [cell for cell, _ in cells], failed, TaskReferences(dict(cells)),
        judge_advice=lambda results, plan: judged(spec, cells, results, plan),
    )  # fmt: skip
    if cost.runs:
        say(cost.text())
        cost.keep(spec.report / "cost.json")
    return 1 if failed else 0


def judged(
    spec: Spec, cells: Sequence[tuple[Cell, DictConfig]], results: pd.DataFrame, plan: Layout
) -> "list[advised.Judged]":
    """The advice of ``prt needs`` for the table's scenes against its results, where the table asks for it."""
    if spec.advice is None:
        return []
    from prt.bench import advised, needs
    from prt.methods.advice import advise

    wanted = spec.advice.get("scenes") or plan.scenes
    first = {cell.scene: cfg for cell, cfg in reversed(list(cells)) if cell.scene in wanted}
    advice = {}
    for scene in (scene for scene in plan.scenes if scene in first):
        say(f"measuring what {scene} needs")
        try:
            advice[scene] = advise(str(first[scene].choice.task), needs.measured(first[scene]))
        except PrtError as error:  # must not cost the report of finished runs
            say(f"{scene}: no advice to judge: {error}")
    return advised.judge(cells, results, plan, spec.enough, advice)


def check_writable(folder: Path) -> None:
    """Raises PrtError where the report could not be written."""
    probe = folder / ".writable"
    write_atomically(probe, b"", "report=")
    probe.unlink()


class TaskReferences:
    """Reference images for the figure, from the task itself (its cache holds them)."""

    def __init__(self, configs: dict[Cell, DictConfig]):
        self.configs = configs
        self.kept: tuple[str, list[Any]] = ("", [])  # only the last: they are large

    def __call__(self, cell: Cell, split: str, view: str, lighting: str) -> dict[str, Any]:
        cfg = self.configs[cell]
        settings = {part: OmegaConf.to_container(cfg[part]) for part in ("task", "scene", "lighting")}
        if self.kept[0] != (told := settings_key(settings)):
            self.kept = (told, runner.build_task(cfg).tests())
        for item in self.kept[1]:
            if (str(item.split), str(item.view_name), str(item.lighting_name)) == (split, view, lighting):
                return {component: image.numpy() for component, image in item.references.items()}
        raise PrtError(
            f"the task has no test image {split}/{view}/{lighting}; were its settings changed since the run?"
        )

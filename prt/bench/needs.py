"""``prt needs``: what a scene asks of a model, and what to use, without training anything."""

import time
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from prt.bench import compose
from prt.bench.run import build_task
from prt.errors import PrtError


def main(overrides: Sequence[str]) -> int:
    """Measure, print the figures, then the advice with a reason in a line each.

    Without ``task=`` a scene that moves is measured for task animate, a scenario of local lights for
    local_lights, and everything else for relight_indirect.

    Raises:
        PrtError: for a mistake in the overrides, or a scene that cannot be measured.
    """
    from prt.methods.advice import advise
    from prt.tasks.needs import MEASURES, measure

    started = time.monotonic()
    cfg = compose.compose(with_task(overrides))
    task = build_task(cfg)
    if task.name not in MEASURES:
        raise PrtError(f"task={task.name} has no measurements; choose one of {', '.join(MEASURES)}")
    needs = measure(task)
    shown = Table(title=f"{cfg.choice.scene} under {cfg.choice.lighting}", title_justify="left")
    shown.add_column("figure")
    shown.add_column("value", justify="right")
    shown.add_column("what it is")
    for need in needs:
        shown.add_row(need.name, need.shown, need.about)
    console = Console(width=150)
    console.print(shown)
    advice = advise(task.name, needs)
    words = Table(title="Recommended", title_justify="left")
    for column in ("setting", "because"):
        words.add_column(column)
    for each in advice:
        words.add_row(each.override, each.reason)
    console.print(words)
    kept = [word for word in overrides if word.partition("=")[0] not in ("task", "method")]
    console.print(
        " ".join(["prt run", *kept, *(each.override for each in advice)]), soft_wrap=True, markup=False
    )
    print(f"measured in {time.monotonic() - started:.0f} s, nothing was trained")
    return 0


def with_task(overrides: Sequence[str]) -> list[str]:
    """The overrides with the task that their scene and lighting are for, where they name none."""
    given = {word.partition("=")[0]: word.partition("=")[2] for word in overrides}
    if "task" in given:
        return list(overrides)
    for task in ("local_lights", "animate"):
        with_it = [f"task={task}", *overrides]
        try:
            cfg = compose.compose(with_it)
            built = build_task(cfg)
        except PrtError:
            continue  # not what this scene or lighting is for
        if task == "animate" and not built.scene.animation.dimension:
            continue
        if "lighting" in given or (task == "animate" and "scene" in given):
            return with_it
    return ["task=relight_indirect", *overrides]

"""``prt needs``: what a scene asks of a model, and what to use, without training anything."""

import dataclasses
import json
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from prt.bench import compose
from prt.bench.run import build_task
from prt.cache import settings_key, write_atomically
from prt.errors import PrtError
from prt.paths import cache_folder

if TYPE_CHECKING:
    from prt.tasks.needs import Need


def main(overrides: Sequence[str]) -> int:
    """Measure, print the figures, then the advice with a reason in a line each.

    Without ``task=`` a scene that moves is measured for task animate, a scenario of local lights for
    local_lights, and everything else for relight_indirect.

    Raises:
        PrtError: for a mistake in the overrides, or a scene that cannot be measured.
    """
    from prt.methods.advice import advise

    started = time.monotonic()
    cfg = compose.compose(with_task(overrides))
    needs = measured(cfg)
    shown = Table(title=f"{cfg.choice.scene} under {cfg.choice.lighting}", title_justify="left")
    shown.add_column("figure")
    shown.add_column("value", justify="right")
    shown.add_column("what it is")
    for need in needs:
        shown.add_row(need.name, need.shown, need.about)
    console = Console(width=150)
    console.print(shown)
    advice = advise(str(cfg.choice.task), needs)
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


def measured(cfg: DictConfig) -> "list[Need]":
    """The figures of a configuration's scene and lighting, from the cache where they were measured before.

    Raises:
        PrtError: for a task without measurements, or a scene that cannot be measured.
    """
    from prt.tasks.needs import MEASURES, VERSION, Need, measure

    if cfg.choice.task not in MEASURES:
        raise PrtError(f"task={cfg.choice.task} has no measurements; choose one of {', '.join(MEASURES)}")
    task = build_task(cfg)
    # files that settings only name may have changed
    scene = task.scene.lit_fingerprint() if task.name == "animate" else task.scene.fingerprint()
    told = {
        "version": VERSION, "task": OmegaConf.to_container(cfg.task), "scene": scene,
        "lighting": task.lighting.fingerprint(),
    }  # fmt: skip
    path = cache_folder() / "needs" / f"{settings_key(told)}.json"
    if path.is_file():
        return [Need(**need) for need in json.loads(path.read_text())]
    found = measure(task)
    write_atomically(path, json.dumps([dataclasses.asdict(need) for need in found], indent=1).encode())
    return found


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

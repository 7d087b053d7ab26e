"""One run: build what the configuration names, fit, evaluate, time, and leave a run folder behind.

Every stage is skipped where its files are whole, so the same command resumes an interrupted run.
"""

import functools
import hashlib
import os
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from prt.bench import compose, provenance
from prt.bench.build import build, target_class
from prt.bench.evaluate import evaluate_run, time_run
from prt.bench.fit_log import RunLog
from prt.bench.run_folder import RunFolder, file_name, run_hash, write_json
from prt.cache import write_atomically
from prt.errors import PrtError

#: what timing.json says of the fit
FIT_TIMING = ("fit", "bake", "device", "threads")


def folder_of(cfg: DictConfig) -> RunFolder:
    """Where the run of a composed configuration lies: ``<run.folder>/<task>/<scene>/<method>/<hash>``."""
    names = [file_name(cfg.choice[group]) for group in ("task", "scene", "method")]
    last = run_hash(compose.hashed_settings(cfg))
    return RunFolder(Path(cfg.run.folder).expanduser().joinpath(*names, last))


def run(cfg: DictConfig) -> RunFolder:
    """Carry out a run, or go on with it, or skip it where it is done; returns its folder.

    Args:
        cfg: from :func:`prt.bench.compose.compose`.

    Raises:
        PrtError: for everything a user can mend. Mistakes in the configuration leave no folder behind; later
            ones are also kept in the folder's ``FAILED``, and the next call tries again.
    """
    folder = folder_of(cfg)
    if folder.done:
        from prt.bench.score import complete  # which uses this module

        say(f"done already: {folder.path}")
        complete(folder, list(cfg.run.metrics))
        return folder
    task, method = build_task(cfg), build(cfg, "method")
    check_task(cfg, task, method)
    with folder.lock():
        if folder.done:  # by another process while this one waited or built
            return folder
        say(f"{'resume' if folder.state() != 'absent' else 'run'}: {folder.path}")
        folder.begin(cfg, provenance.collect(cfg))
        try:
            carry_out(folder, cfg, task, method)
        except Exception as error:
            reason = str(error) if isinstance(error, PrtError) else f"{type(error).__name__}: {error}"
            folder.fail(reason, traceback.format_exc())
            raise
    return folder


def build_task(cfg: DictConfig) -> Any:
    """The task with its scene and lighting."""
    return build(cfg, "task", scene=build(cfg, "scene"), lighting=build(cfg, "lighting"))


def check_task(cfg: DictConfig, task: Any, method: Any) -> None:
    """Refuse a method that cannot do the task, naming those that can."""
    if task.name in method.tasks:
        return
    able = [
        name
        for name in compose.choices("method")
        if task.name in getattr(target_class("method", name), "tasks", ())
    ]
    raise PrtError(
        f"method={cfg.choice.method} cannot do task={cfg.choice.task} "
        f"(it can do {', '.join(sorted(method.tasks))}); methods that can: {', '.join(able) or 'none'}"
    )


def carry_out(folder: RunFolder, cfg: DictConfig, task: Any, method: Any) -> None:
    """Fit, reload, evaluate, time, mark as done; mistakes in what is tested are found before the fit."""
    if hasattr(task, "check_tests"):
        task.check_tests()
    model = stored(folder, cfg, task, method)
    evaluate_run(folder, cfg, task, model)
    if "shade" not in folder.timing():
        time_run(folder, cfg, task, model)
    folder.finish()


def stored(folder: RunFolder, cfg: DictConfig, task: Any, method: Any) -> Any:
    """The fitted model, from another run where one has it: as it was stored, read back by a fresh method."""
    if not whole_checkpoint(folder) and not adopt(folder, cfg, method):
        fit(folder, cfg, task, method)
    del method
    model = build(cfg, "method")
    model.load(folder.checkpoint, task, str(cfg.device))
    return model


def fitted(cfg: DictConfig, task: Any) -> Any:
    """The configured method, fitted, for benchmarks: kept as that of any run, so that a stopped fit goes on.

    Raises:
        PrtError: as :func:`run`.
    """
    folder, method = folder_of(cfg), build(cfg, "method")
    check_task(cfg, task, method)
    with folder.lock():
        if not whole_checkpoint(folder):
            folder.begin(cfg, provenance.collect(cfg))
        return stored(folder, cfg, task, method)


def adopt(folder: RunFolder, cfg: DictConfig, method: Any) -> bool:
    """Take over the fitted model of a run that differs only in what a fit does not depend on.

    Those settings are the method's ``rendering``, as the number of wavelets that are kept in a frame.
    """
    names = getattr(method, "rendering", frozenset())
    if not names or not folder.path.parent.is_dir():
        return False
    mine = fit_settings(cfg, names)
    for path in sorted(folder.path.parent.iterdir()):
        other = RunFolder(path)
        if path == folder.path or not other.checkpoint.exists():
            continue
        timing = {key: value for key, value in other.timing().items() if key in FIT_TIMING}
        if "fit" not in timing:
            continue
        if fit_settings(other.config(), names) != mine or not undamaged(other):
            continue
        say(f"    fitted already: {path}")
        write_json(folder.path / "provenance.json", {**folder.provenance(), "fitted_by": path.name})
        folder.add_timing(**timing)
        write_atomically(folder.log_file, other.log_file.read_bytes() if other.log_file.exists() else b"")
        write_atomically(digest_file(folder), digest_file(other).read_bytes())
        write_atomically(folder.checkpoint, other.checkpoint.read_bytes())
        return True
    return False


def fit_settings(cfg: DictConfig, rendering: frozenset[str]) -> dict[str, Any]:
    """What a fitted model depends on, as plain data."""
    plain = compose.hashed_settings(cfg)
    plain["method"] = {key: value for key, value in plain["method"].items() if key not in rendering}
    return {key: value for key, value in plain.items() if key != "run"}


def fit(folder: RunFolder, cfg: DictConfig, task: Any, method: Any) -> None:
    """Fit from the last kept state and store the model; the time of the data it asks for is kept apart."""
    torch.manual_seed(cfg.seed)
    baked = Baking(task)
    try:
        with RunLog(folder, cfg.run.checkpoint_seconds, excluded=lambda: baked.seconds) as log:
            method.fit(baked, log, int(cfg.seed), str(cfg.device))
            seconds = log.seconds
    finally:  # an interrupted fit finds its data in the cache when it goes on
        folder.add_timing(bake=folder.timing().get("bake", 0.0) + baked.seconds - baked.references)
    folder.add_timing(fit=seconds, device=str(cfg.device), threads=torch.get_num_threads())
    temporary = folder.checkpoint.with_suffix(".part")
    method.save(temporary)
    write_atomically(digest_file(folder), (digest(temporary) + "\n").encode())
    os.replace(temporary, folder.checkpoint)


class Baking:
    """A task seen through a stopwatch: the seconds spent in it while a method fits are not training.

    Attributes:
        seconds: all of them.
        references: of those, the ones for the test items, which no method is charged for.
    """

    def __init__(self, task: Any):
        self._task, self.seconds, self.references = task, 0.0, 0.0

    def __getattr__(self, name: str) -> Any:
        value = self._clocked(lambda: getattr(self._task, name))
        # images that a method has rendered as it learns are a part of its learning
        if not callable(value) or name in ("scene", "render"):
            return value

        @functools.wraps(value)
        def call(*arguments: Any, **settings: Any) -> Any:
            before = self.seconds
            result = self._clocked(lambda: value(*arguments, **settings))
            self.references += self.seconds - before if name == "tests" else 0.0
            return result

        return call

    def _clocked(self, work: Any) -> Any:
        started = time.monotonic()
        try:
            return work()
        finally:
            self.seconds += time.monotonic() - started


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def digest_file(folder: RunFolder) -> Path:
    return folder.path / "checkpoint.sha256"


def whole_checkpoint(folder: RunFolder) -> bool:
    """Whether the fitted model is there and undamaged; a damaged one is dropped and fitted again."""
    if not folder.checkpoint.exists():
        return False
    if undamaged(folder):
        return True
    warnings.warn(f"{folder.checkpoint} is damaged and will be fitted again", stacklevel=2)
    folder.checkpoint.unlink()
    return False


def undamaged(folder: RunFolder) -> bool:
    """Whether the fitted model is the one that was written."""
    path = digest_file(folder)
    return path.exists() and path.read_text().strip() == digest(folder.checkpoint)


def summary(folder: RunFolder) -> str:
    """A finished run in a few lines: mean PSNR per split and component, times, size."""
    metrics, timing = folder.metrics(), folder.timing()
    lines = []
    psnr = metrics[metrics.metric == "psnr"]
    for key, rows in psnr.groupby(["split", "component", "denoised"], sort=False):
        split, component, denoised = tuple(key)  # pyright: ignore
        lines.append(
            f"  psnr {component}{' denoised' if denoised else ''}, {split}: {rows.value.mean():.2f} dB "
            f"({len(rows)} images)"
        )
    times = [f"{name} {1e3 * timing[name]['median']:.3g} ms" for name in ("light", "shade") if name in timing]
    if "fit" in timing:
        times.append(f"fit {timing['fit']:.1f} s")
    times.append(f"model {timing.get('bytes', 0) / 1e6:.3g} MB")
    return "\n".join([*lines, "  " + ", ".join(times)])


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)

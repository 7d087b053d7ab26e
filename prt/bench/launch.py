"""Runs sent through a Hydra launcher, and an answer for every one of them, whatever became of its worker.

What a run came to is read from its folder; a worker's answer only adds the reason and the seconds.
"""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.utils import get_class
from omegaconf import DictConfig

from prt.bench import compose, engines
from prt.bench.cost import Cost, Watch
from prt.bench.launchers import Settings
from prt.bench.run import fit_settings, folder_of, run
from prt.bench.run_folder import RunFolder
from prt.cache import settings_key
from prt.errors import PrtError

RESUMES = "the same command resumes it from its last state"


@dataclass(frozen=True)
class Job:
    """The task function of every launcher: one run, in whichever process it finds itself.

    Attributes:
        folder: where the command was called: relative paths mean the same everywhere.
        environment: prt's own variables there (PRT_DATA, PRT_CACHE, PRT_CONF_DIRS, ...).
        command: the words of the command, for the run's provenance.
        threads: processor threads of the run, None to leave them as they are.
    """

    folder: str
    environment: dict[str, str]
    command: tuple[str, ...]
    threads: int | None = None

    def __call__(self, cfg: DictConfig) -> dict[str, Any]:
        """Returns ``reason`` (empty for a run that is done) and ``seconds`` by the parts of its cost."""
        watch: Watch | None = None
        try:
            self.settle()
            with compose.reported([]):
                cfg = compose.finish(cfg, HydraConfig.get().runtime.choices)
            watch = Watch(folder_of(cfg))
            run(cfg)
            reason = ""
        except Exception as error:
            # text only: an exception of a user's own class may not come through to the other process
            reason = reason_of(error)
        return {"reason": reason, "seconds": watch.parts() if watch else {}}

    def settle(self) -> None:
        """Make this process like the one that was called."""
        if not Path(self.folder).is_dir():
            raise PrtError(f"this machine sees no {self.folder}; all machines of a sweep share their folders")
        os.chdir(self.folder)
        if self.folder not in sys.path:  # a user's own method may lie there
            sys.path.append(self.folder)
        os.environ.update(self.environment)
        sys.argv = list(self.command)
        if os.environ.get("SUBMITIT_EXECUTOR") == "local":  # submitit has it ignored, which suits Slurm alone
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if self.threads is not None:
            limit_threads(self.threads)


def job_of(settings: Settings) -> Job:
    """The task function of this call."""
    ours = {name: value for name, value in os.environ.items() if name.startswith("PRT_")}
    return Job(os.getcwd(), ours, tuple(sys.argv), settings.threads)


def thread_variables(threads: int) -> dict[str, str]:
    """What libraries read when they are loaded."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OIDN_NUM_THREADS")
    return dict.fromkeys(names, str(threads))


def limit_threads(threads: int) -> None:
    """Keep torch, the denoiser and the renderer of this process to so many threads."""
    os.environ.update(thread_variables(threads))
    torch.set_num_threads(threads)
    from prt.scene.mitsuba_setup import choose_variant, mitsuba

    # the renderer takes all cores, and no variable would tell it; where it cannot start, the run says why
    with contextlib.suppress(PrtError, ImportError):
        if choose_variant() == "llvm_ad_rgb":
            mitsuba()
            import drjit

            drjit.set_thread_count(threads)


@dataclass(frozen=True, eq=False)
class Plan:
    """One run that is asked for: its overrides as a worker gets them, its configuration, its folder."""

    words: tuple[str, ...]
    cfg: DictConfig
    run: RunFolder


def plan(overrides: Sequence[str], settings: Settings) -> Plan:
    """Compose a run here, as its worker will.

    Raises:
        PrtError: as :func:`prt.bench.compose.compose`.
    """
    words = compose.with_companions(overrides)
    cfg = compose.compose(words, settings.gpu)
    # `auto` would mean the worker's machine there, and another folder
    device = f"device={cfg.device}"
    return Plan(tuple(words) if device in words else (*words, device), cfg, folder_of(cfg))


@dataclass(frozen=True)
class Outcome:
    """What became of a run: done, or why not."""

    run: RunFolder
    reason: str = ""
    before: bool = False  #: done when the call began


def deliver(
    launcher: Launcher,
    settings: Settings,
    plans: Sequence[Plan],
    cost: Cost,
    told: Callable[[Plan, Outcome], None],
) -> list[Outcome]:
    """Carry out what is not done, and say what became of every run, in the order of ``plans``.

    Args:
        cost: gets the account of it.
        told: called for each run: for those done already at once, for the others when they end.

    Raises:
        PrtError: where the launcher's engine cannot be reached.
    """
    outcomes: dict[Path, Outcome] = {}

    def settled(one: Plan, outcome: Outcome) -> None:
        outcomes[one.run.path] = outcome
        told(one, outcome)

    todo: list[Plan] = []
    for one in {one.run.path: one for one in plans}.values():  # two at a time in one folder would collide
        if one.run.done:
            settled(one, Outcome(one.run, before=True))
        else:
            todo.append(one)
    cost.before += len(outcomes)
    if not todo:  # no engine need be started
        return [outcomes[one.run.path] for one in plans]
    cost.launcher, cost.workers = settings.name, workers_of(settings, len(todo))
    waves = [todo] if settings.here else waves_of(todo)
    jobs = [[(todo.index(one), list(one.words)) for one in wave] for wave in waves]
    with child_environment(settings):
        for number, answer in engines.answers(launcher, settings.workers, jobs):
            outcome = judged(todo[number].run, answer)
            cost.add(answer.get("seconds", {}) if isinstance(answer, dict) else {}, bool(outcome.reason))
            settled(todo[number], outcome)
    return [outcomes[one.run.path] for one in plans]


def workers_of(settings: Settings, runs: int) -> int:
    """Runs at a time, as far as it is known here: a running cluster may take all at once."""
    return 1 if settings.here else max(min(settings.workers or runs, runs), 1)


def judged(folder: RunFolder, answer: engines.Answer) -> Outcome:
    """The folder has the last word: a run may be done although its worker died with the answer."""
    if folder.done:
        return Outcome(folder)
    if isinstance(answer, dict):
        return Outcome(folder, answer["reason"] or f"it ended, but there is no DONE in {folder.path}")
    return Outcome(folder, f"{answer}; {RESUMES}" if answer.startswith(engines.DIED) else answer)


def waves_of(plans: Sequence[Plan]) -> list[list[Plan]]:
    """Runs that could share a fit wait for the first of them, and then take over what it fitted."""
    first: list[Plan] = []
    later: list[Plan] = []
    seen: set[str] = set()
    for one in plans:
        key = fit_key(one)
        (later if key in seen else first).append(one)
        seen.add(key)
    return [wave for wave in (first, later) if wave]


def fit_key(one: Plan) -> str:
    """Equal for runs that differ only in what their fit does not depend on."""
    rendering: frozenset[str] = frozenset()
    with contextlib.suppress(Exception):  # a class that cannot be imported fails in its run, with its reason
        rendering = getattr(get_class(str(one.cfg.method._target_)), "rendering", rendering)
    return settings_key(fit_settings(one.cfg, rendering)) if rendering else str(one.run.path)


@contextlib.contextmanager
def child_environment(settings: Settings) -> Iterator[None]:
    """What processes started here inherit: as many threads as a run may use."""
    threads = {} if settings.here or settings.threads is None else thread_variables(settings.threads)
    with mock.patch.dict(os.environ, threads):
        yield


def reason_of(error: BaseException) -> str:
    """One line, with the kind of error where it is not one of ours."""
    kind = "" if isinstance(error, PrtError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split())}"


class Answering(Launcher):
    """Stands in a Hydra sweeper in the place of its launcher, plans its runs and answers for all of them."""

    def __init__(self, launcher: Launcher, settings: Settings, told: Callable[[Plan, Outcome], None]):
        self.launcher, self.settings, self.told = launcher, settings, told
        self.cost = Cost()
        self.outcomes: list[Outcome] = []

    def setup(self, **_: Any) -> None:
        """The launcher within is set up already."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """As every launcher; but a run that failed raises nothing here.

        Raises:
            PrtError: for a mistake in any run's overrides, before one of them begins.
        """
        plans = [plan(words, self.settings) for words in job_overrides]
        found = deliver(self.launcher, self.settings, plans, self.cost, self.told)
        self.outcomes += found
        return [
            JobReturn(overrides=list(words), status=JobStatus.COMPLETED, _return_value=str(outcome.run.path))
            for words, outcome in zip(job_overrides, found, strict=True)
        ]

"""The engines behind Hydra's launcher plug-ins, asked run by run: a dead worker costs its own run alone.

The plug-ins wait for all their jobs at once: the first job without an answer raises, and the sweep is lost
(docs/decisions/0008-launchers.md). Here the plug-ins ship the jobs, and answers are collected one by one.
"""

import importlib
from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher

#: what a run's worker gave back: a dict of the run's own making, or the reason why there is none
Answer = dict[str, Any] | str
#: number of a job, its Hydra overrides
Job = tuple[int, list[str]]
Waves = Sequence[Sequence[Job]]
Answers = Iterator[tuple[int, Answer]]
DIED = "its worker died before the run ended"
#: the classes of plug-ins whose jobs can be asked one by one, and the module that does
ENGINES = {"RayLauncher": "prt.bench.ray_engine", "BaseSubmititLauncher": "prt.bench.submitit_engine"}


def answers(launcher: Launcher, workers: int | None, waves: Waves) -> Answers:
    """Carry out all jobs, a wave beginning when the last has ended; answers in the order in which they come.

    Args:
        launcher: Hydra's plug-in, set up with a task function that returns a dict and raises nothing.
        workers: jobs at a time, where it is not the engine that decides.

    Raises:
        PrtError: where the engine cannot be reached, or can never carry out a job.
    """
    kinds = {kind.__name__ for kind in type(launcher).__mro__}
    for kind, module in ENGINES.items():
        if kind in kinds:  # imported only now: it needs the plug-in
            yield from importlib.import_module(module).answers(launcher, workers, waves)
            return
    yield from (one_by_one if "BasicLauncher" in kinds else all_at_once)(launcher, waves)


def one_by_one(launcher: Launcher, waves: Waves) -> Answers:
    """In this process, which answers for itself."""
    for number, words in (job for wave in waves for job in wave):
        yield number, content(launcher.launch([words], number)[0])


def all_at_once(launcher: Launcher, waves: Waves) -> Answers:
    """Any other plug-in: where it raises, nobody answers for its jobs; their folders show which are done."""
    for wave in waves:
        try:
            found = [content(job) for job in launcher.launch([words for _, words in wave], wave[0][0])]
        except Exception as error:
            found = [f"{DIED}, or another's did ({last_line(error)})"] * len(wave)
        yield from zip((number for number, _ in wave), found, strict=True)


def content(job: JobReturn) -> Answer:
    """What a job returned."""
    return job.return_value if job.status == JobStatus.COMPLETED else last_line(job._return_value)


def last_line(error: object) -> str:
    """The last line of an engine's error, which ends with the exception of the worker."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__

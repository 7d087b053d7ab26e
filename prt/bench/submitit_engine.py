"""Runs as jobs of Slurm, or as processes of this machine, shipped by hydra-submitit-launcher (imported only
where that is installed).
"""

import collections
import contextlib
import os
import signal
import sys
import time
from typing import Any

import submitit
from hydra.core.singleton import Singleton
from hydra_plugins.hydra_submitit_launcher.config import BaseQueueConf
from omegaconf import OmegaConf
from submitit.core.utils import FailedJobError, UncompletedJobError

from prt.bench.engines import DIED, Answer, Answers, Waves, content, last_line
from prt.errors import PrtError

#: seconds between two looks at the jobs
POLL = 0.2


def answers(launcher: Any, workers: int | None, waves: Waves) -> Answers:
    """As :func:`prt.bench.engines.answers`; an interruption ends the processes here, but not Slurm's jobs."""
    executor, here = executor_of(launcher), launcher._EXECUTOR == "local"
    running: dict[Any, int] = {}
    try:
        for wave in waves:
            waiting = collections.deque(wave)
            while waiting or running:
                # Slurm keeps to `workers` by itself; the local executor would start all jobs at once
                free = workers - len(running) if here and workers else len(waiting)
                batch = [waiting.popleft() for _ in range(min(free, len(waiting)))]
                if batch:
                    calls = [
                        (words, "hydra.sweep.dir", number, f"job_id_for_{number}", Singleton.get_state())
                        for number, words in batch
                    ]
                    jobs = submitted(executor, launcher, calls)
                    running |= {job: number for job, (number, _) in zip(jobs, batch, strict=True)}
                for job in [job for job in running if job.done()]:
                    yield running.pop(job), submitit_answer(job, here)
                time.sleep(POLL)
    finally:
        for job in running if here else ():
            with contextlib.suppress(ProcessLookupError):  # its id is that of its process, which passes it on
                os.kill(int(job.job_id), signal.SIGTERM)
        if running and not here:
            left = " ".join(job.job_id for job in running)
            print(f"prt: Slurm goes on with these jobs; to stop them: scancel {left}", file=sys.stderr)


def submitted(executor: Any, launcher: Any, calls: list[tuple[Any, ...]]) -> list[Any]:
    """The jobs of these calls of the launcher; raises PrtError with Slurm's reason for taking none."""
    try:
        return executor.map_array(launcher, *zip(*calls, strict=True))
    except FailedJobError as error:
        raise PrtError(last_line(error)) from error


def submitit_answer(job: Any, here: bool) -> Answer:
    """What became of a job that has ended."""
    logs = f"its log: {job.paths.stderr}"
    # a file system between machines may show the result late, and submitit waits for it; here there is none
    if here and not job.paths.result_pickle.exists():
        return f"{DIED} ({logs})"
    try:
        return content(job.results()[0])
    except UncompletedJobError:
        return f"{DIED} (Slurm: {job.state}; {logs})"
    except Exception as error:  # not the run, which catches: the worker could not begin it
        return f"its worker could not begin: {trace_end(error)} ({logs})"


def trace_end(error: Exception) -> str:
    """The exception in the traceback that submitit's error quotes between two lines of dashes."""
    parts = str(error).split("-" * 22)
    return last_line(parts[1] if len(parts) > 2 else error)


def executor_of(launcher: Any) -> Any:
    """The executor that the plug-in would make for itself, from the same settings."""
    given = dict(launcher.params)
    folder, shared = given.pop("submitit_folder"), set(OmegaConf.structured(BaseQueueConf).keys())
    start = {"slurm_max_num_timeout": given.pop("max_num_timeout")} if "max_num_timeout" in given else {}
    executor = submitit.AutoExecutor(folder=folder, cluster=launcher._EXECUTOR, **start)
    executor.update_parameters(
        **{key if key in shared else f"{launcher._EXECUTOR}_{key}": value for key, value in given.items()}
    )
    return executor

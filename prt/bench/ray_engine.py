"""Runs as tasks of a Ray cluster, shipped by hydra-ray-launcher; imported only where that is installed."""

import contextlib
import os
import signal
import socket
from collections.abc import Iterator
from typing import Any

import ray
from hydra.core.singleton import Singleton
from hydra_plugins.hydra_ray_launcher._launcher_util import launch_job_on_ray
from omegaconf import OmegaConf, open_dict

from prt.bench.engines import DIED, Answer, Answers, Waves, content, last_line
from prt.errors import PrtError


def answers(launcher: Any, workers: int | None, waves: Waves) -> Answers:
    """As :func:`prt.bench.engines.answers`; a cluster that was started here ends here."""
    with cluster(launcher.ray_cfg):
        for wave in waves:
            tasks = {}
            for number, words in wave:
                cfg = launcher.hydra_context.config_loader.load_sweep_config(launcher.config, words)
                with open_dict(cfg):
                    cfg.hydra.job.id, cfg.hydra.job.num = f"job_id_for_{number}", number
                task = launch_job_on_ray(
                    launcher.hydra_context,
                    launcher.ray_cfg.remote,
                    cfg,
                    launcher.task_function,
                    Singleton.get_state(),
                )
                tasks[task] = number
            while tasks:
                for task in ray.wait(list(tasks))[0]:
                    yield tasks.pop(task), ray_answer(task)


def ray_answer(task: Any) -> Answer:
    """What became of a Ray task that has ended."""
    try:
        return content(ray.get(task))
    except ray.exceptions.RayTaskError as error:  # not the run, which catches: the worker could not begin it
        return f"its worker could not begin: {last_line(error)}"
    except ray.exceptions.RayError as error:
        return f"{DIED} ({type(error).__name__})"


@contextlib.contextmanager
def cluster(cfg: Any) -> Iterator[None]:
    """A Ray cluster to talk to: the one this process is connected to, a running one, or one of our own.

    Raises:
        PrtError: if the running one cannot be reached, or our own is too small for a single run.
    """
    if ray.is_initialized():
        yield
        return
    handler = signal.getsignal(signal.SIGTERM)
    settings: Any = OmegaConf.to_container(cfg.init, resolve=True)
    check_reachable(settings.get("address") or os.environ.get("RAY_ADDRESS") or "")
    try:
        ray.init(**settings)
    except (ConnectionError, ValueError, RuntimeError) as error:
        said = " ".join(str(error).split())
        raise PrtError(
            f"launcher.address={settings.get('address')}: {said}; is RAY_AUTH_MODE=token wanted there?"
        ) from error
    # Ray puts its own in the place of ours, and a request to end would no longer be an interruption
    with contextlib.suppress(ValueError):  # not the main thread: it has replaced none
        signal.signal(signal.SIGTERM, handler)
    try:
        if settings.get("num_cpus"):  # of our own; another may grow on demand
            check_room(cfg.remote, ray.cluster_resources())
        yield
    finally:
        ray.shutdown()


def check_reachable(address: str) -> None:
    """Ray tries for minutes, and fills the screen, where a look at the port tells at once."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not port.isdigit():  # auto, local, or nothing
        return
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        reason = error.strerror or error
        raise PrtError(
            f"launcher.address={address} cannot be reached: {reason}; see `ray status` there"
        ) from error


def check_room(wanted: Any, have: dict[str, float]) -> None:
    """A task that needs more than there is would wait for ever."""
    for setting, name, unit, key in (
        ("gpus", "GPU", 1, "num_gpus"), ("memory_gb", "memory", 2**30, "memory"),
    ):  # fmt: skip
        need, found = wanted.get(key) or 0, have.get(name, 0.0)
        if need > found:
            raise PrtError(
                f"launcher.{setting}={need / unit:g}: Ray finds {found / unit:.3g} on this machine; give less"
            )

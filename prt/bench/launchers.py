"""The Hydra group ``launcher``: where sweeps and tables carry out their runs, and what each may use there.

Its settings stand in ``conf/launcher/<name>.yaml`` and are bookkeeping: no run's name depends on them.
"""

import importlib.util
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, RunMode, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from prt.bench import compose
from prt.errors import PrtError

RAY = ("hydra_plugins.hydra_ray_launcher", "ray")
SUBMITIT = ("hydra_plugins.hydra_submitit_launcher", "submitit")
#: choices that need packages: those, and the extra of prt that brings them
NEEDS = {
    "launcher=ray": (RAY, "ray"),
    "launcher=local": (SUBMITIT, "submitit"),
    "launcher=slurm": (SUBMITIT, "submitit"),
    "hydra/launcher=ray": (RAY, "ray"),
    "hydra/launcher=submitit_local": (SUBMITIT, "submitit"),
    "hydra/launcher=submitit_slurm": (SUBMITIT, "submitit"),
}
#: settings that are counts, and the least each may be
LEAST = {"workers": 1, "threads": 1, "minutes": 1, "retries": 0, "requeues": 0}


@dataclass(frozen=True)
class Settings:
    """What of a launcher's settings matters whichever it is.

    Attributes:
        name: the choice, as ``ray``.
        here: whether runs are carried out in this process, one after the other.
        workers: runs at a time; None where a running cluster decides.
        threads: processor threads of a run, None for as many as its process takes by itself.
        gpus: GPUs of a run, None for those of this process.
    """

    name: str
    here: bool
    workers: int | None
    threads: int | None
    gpus: float | None

    @property
    def gpu(self) -> bool | None:
        """Whether a run sees a GPU; None where it is this process's own affair."""
        return None if self.gpus is None else self.gpus > 0


def is_launcher(override: str) -> bool:
    """Whether an override is about the launcher, not about the runs."""
    key = override.partition("=")[0].lstrip("+~")
    return key in ("launcher", "hydra/launcher") or key.startswith(("launcher.", "hydra.launcher."))


def split(overrides: Iterable[str]) -> tuple[list[str], list[str]]:
    """The overrides about the launcher, then the others."""
    given = list(overrides)
    return [text for text in given if is_launcher(text)], [text for text in given if not is_launcher(text)]


def refuse(overrides: Sequence[str]) -> None:
    """Raises PrtError for a launcher where nothing would read it: in a single run."""
    for text in split(overrides)[0]:
        raise PrtError(f"{text}: a launcher carries out sweeps; add -m (a sweep may have one run)")


def check_installed(overrides: Sequence[str]) -> None:
    """Find out before Hydra does, whose message does not say what to install.

    Raises:
        PrtError: naming the extra of prt, or what else the launcher needs.
    """
    for text in overrides:
        modules, extra = NEEDS.get(text, ((), ""))
        missing = [module for module in modules if not importable(module)]
        if missing:
            package = missing[0].rpartition(".")[2].replace("_", "-")
            raise PrtError(f"{text} needs {package}, which is not installed: pip install 'prt[{extra}]'")
        if text in ("launcher=slurm", "hydra/launcher=submitit_slurm") and shutil.which("sbatch") is None:
            raise PrtError(
                f"{text}: there is no sbatch here; call prt where Slurm takes jobs, or take launcher=local"
            )


def importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # not even the package it would lie in
        return False


def master(overrides: Sequence[str]) -> tuple[DictConfig, HydraContext, Settings]:
    """Hydra's configuration of a sweep, what its plug-ins are set up with, and the launcher's settings.

    Raises:
        PrtError: for a missing plug-in, or a setting of the launcher that makes no sense.
        HydraException, OmegaConfBaseException: for mistakes in the overrides; see :func:`compose.reported`.
    """
    from hydra._internal.callbacks import Callbacks

    check_installed(overrides)
    words = [*compose.searchpath_override(), *overrides]
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(compose.conf_folder()), version_base="1.3", job_name="prt"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        cfg = hydra.compose_config("config", words, RunMode.MULTIRUN, with_log_configuration=False)
        context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(cfg))
    return cfg, context, settle(cfg)


def plugin(cfg: DictConfig, context: HydraContext, function: TaskFunction) -> Launcher:
    """The plug-in that :func:`master`'s configuration chooses, set up to carry out ``function``."""
    return Plugins.instance().instantiate_launcher(context, function, cfg)


def settle(cfg: DictConfig) -> Settings:
    """Check the launcher's settings and put this machine's numbers in the place of ``auto``, in ``cfg``.

    Raises:
        PrtError: naming the setting and what is allowed.
    """
    choices = cfg.hydra.runtime.choices
    plug_in, choice = (str(choices.get(group)) for group in ("hydra/launcher", "launcher"))
    given = cfg.get("launcher") or OmegaConf.create({})  # a user's own YAML needs none
    name = given.get("name")  # of ours; a user's own YAML may be made from it
    for key in given:
        check(str(key), given[key])
    threads = given.get("threads")
    clustered = bool(given.get("address") or (name == "ray" and os.environ.get("RAY_ADDRESS")))
    with open_dict(cfg):
        if given.get("gpus") == "auto":
            given.gpus = int(torch.cuda.is_available())
        if clustered:
            if given.workers != "auto":
                raise PrtError(
                    f"launcher.workers={given.workers} with a running cluster: it takes as many runs as its "
                    "processors allow; leave workers out, or set launcher.threads"
                )
            given.workers = None
        elif given.get("workers") == "auto":
            given.workers = max(cores() // (threads or 1), 1)
        if name == "ray":
            settle_ray(cfg, clustered)
        if name == "slurm" and not given.gpus:
            cfg.hydra.launcher.gpus_per_node = None  # a cluster without GPUs refuses even 0
    # hydra/launcher=... without a YAML of ours: any other plug-in, with its own settings
    shown = plug_in if choice == "basic" else choice
    return Settings(shown, plug_in == "basic", given.get("workers"), threads, given.get("gpus"))


def check(key: str, value: Any) -> None:
    """One setting of a launcher; those that only the engine can judge pass."""
    optional = value is None and key == "threads" or value == "auto" and key == "workers"
    if key in LEAST and not optional:
        if not isinstance(value, int) or isinstance(value, bool) or value < LEAST[key]:
            other = {"workers": ", or auto", "threads": ", or null"}.get(key, "")
            raise PrtError(f"launcher.{key}={value!r} must be an integer of at least {LEAST[key]}{other}")
    if key in ("gpus", "memory_gb") and value not in (None, "auto"):
        if not isinstance(value, int | float) or isinstance(value, bool) or value < 0:
            raise PrtError(f"launcher.{key}={value!r} must be a number of at least 0")


def settle_ray(cfg: DictConfig, clustered: bool) -> None:
    """What Ray reserves; a cluster of our own has exactly the processors that the workers need."""
    given, ray = cfg.launcher, cfg.hydra.launcher.ray
    if given.threads is None:
        raise PrtError("launcher.threads=null: Ray reserves processors for every run; give their number")
    if given.memory_gb is not None:
        ray.remote.memory = int(given.memory_gb * 2**30)
    if not clustered:
        ray.init.address = "local"  # without it Ray would join a cluster that happens to run here
        ray.init._node_ip_address = "127.0.0.1"  # and nobody else would be kept from joining ours
        ray.init.num_cpus = given.workers * given.threads
        ray.init.num_gpus = torch.cuda.device_count()


def cores() -> int:
    """Processor cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def plain(cfg: DictConfig) -> list[str]:
    """The overrides of a sweep that are about its runs, as Hydra read them."""
    return split(OmegaConf.to_container(cfg.hydra.overrides.task, resolve=False))[1]  # pyright: ignore

"""Where a run's numbers come from: code, packages, machine, settings of the moment."""

import importlib.metadata
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

import prt

#: packages whose version can change a number
PACKAGES = (
    "mitsuba", "drjit", "mitsuba-oidn", "moderngl", "xatlas", "torch", "numpy", "hydra-core", "omegaconf",
    "scikit-image",
    "flip-evaluator", "safetensors", "OpenEXR", "pandas", "karellen-llvm-core",
)  # fmt: skip

#: where the code lies
CODE = Path(prt.__file__).resolve().parent


def collect(cfg: DictConfig) -> dict[str, Any]:
    """Everything that goes into provenance.json, plain JSON."""
    commit, dirty = git_state()
    return {
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "prt": package_version("prt"),
        "commit": commit,
        "dirty": dirty,
        "python": platform.python_version(),
        "packages": {name: package_version(name) for name in PACKAGES},
        "machine": platform.node(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "cpu": cpu_model(),
        "device": str(cfg.device),
        "device_name": device_name(str(cfg.device)),
        "threads": torch.get_num_threads(),
        "seed": int(cfg.seed),
        "command": sys.argv,
    }


def package_version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def git_state(folder: Path = CODE) -> tuple[str | None, bool | None]:
    """Commit of the code and whether files differ from it; None outside a checkout.

    Reports do not count: a table that was written anew changes nothing that makes the next one.
    """
    code = (":(top)", ":(top,exclude)reports")
    try:
        commit = git(folder, "rev-parse", "HEAD")
        return commit, bool(git(folder, "status", "--porcelain", "--untracked-files=no", "--", *code))
    except (OSError, subprocess.SubprocessError):
        return None, None


def git(folder: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True, timeout=20
    ).stdout.strip()


def cpu_model() -> str:
    """The processor's name, as the system gives it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def device_name(device: str) -> str:
    """The name of what shades: the GPU's, else the processor's."""
    return torch.cuda.get_device_name() if device == "cuda" else cpu_model()

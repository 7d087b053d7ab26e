"""Mitsuba, set up once: find an LLVM it can use, choose the variant, hand the module out.

Every module that needs Mitsuba calls :func:`mitsuba`; nothing else sets a variant. torch is imported
before drjit because the two load their own OpenMP and LLVM symbols and this order is the one that is
tested (``tests/scene/test_mitsuba_setup.py``).
"""

import ctypes
import functools
import os
import re
import sys
import warnings
from pathlib import Path
from types import ModuleType

import torch  # noqa: F401  (before drjit, see above)

from prt.errors import PrtError

ALLOWED = ("auto", "cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
#: libLLVM versions Dr.Jit refuses (too old) or that abort the process at compile time.
OLDEST_LLVM = 17


def find_llvm() -> Path | None:
    """The libLLVM that Dr.Jit shall load: the user's choice, else the wheel's, else the system's newest."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH", "").strip()
    if chosen:
        return Path(chosen)
    folders = [
        Path(sys.prefix) / "lib",
        Path("/usr/lib/x86_64-linux-gnu"),
        Path("/usr/lib/aarch64-linux-gnu"),
    ]
    folders += sorted(Path("/usr/lib").glob("llvm-*/lib"), reverse=True)
    usable = [
        (version, -rank, path)
        for rank, folder in enumerate(folders)
        for path in folder.glob("libLLVM*.so*")
        if (version := llvm_version(path) or 0) >= OLDEST_LLVM
    ]
    return max(usable)[2] if usable else None


def llvm_version(path: Path) -> int | None:
    """Major version in a libLLVM file name (``libLLVM.so.23.1``, ``libLLVM-19.so.1``), or None."""
    match = re.fullmatch(r"libLLVM(?:-(\d+)[\d.]*\.so[\d.]*|\.so\.(\d+)[\d.]*)", path.name)
    return int(match.group(1) or match.group(2)) if match else None


def choose_variant() -> str:
    """``PRT_MITSUBA_VARIANT`` or the best of cuda, llvm, scalar that this machine can run."""
    wanted = os.environ.get("PRT_MITSUBA_VARIANT", "auto").strip() or "auto"
    if wanted not in ALLOWED:
        raise PrtError(f"PRT_MITSUBA_VARIANT={wanted!r} is not one of {', '.join(ALLOWED)}")
    if wanted != "auto":
        return wanted
    if torch.cuda.is_available():
        return "cuda_ad_rgb"
    return "llvm_ad_rgb" if find_llvm() else "scalar_rgb"


@functools.cache
def mitsuba() -> ModuleType:
    """The ``mitsuba`` module with its variant set.

    Raises:
        PrtError: if the chosen variant needs an LLVM that this machine lacks or that is known to abort, or
            if drjit was imported earlier and took such a one.
    """
    variant = choose_variant()
    if variant.startswith("llvm"):
        library = find_llvm()
        version = llvm_version(library) if library else None
        if library is None or (version is not None and version < OLDEST_LLVM):
            raise PrtError(
                f"Mitsuba's LLVM mode needs libLLVM {OLDEST_LLVM} or newer, found {library or 'none'}; "
                "pip install karellen-llvm-core, or set DRJIT_LIBLLVM_PATH"
            )
        try:
            ctypes.CDLL(str(library))
        except OSError as error:
            raise PrtError(
                f"cannot load {library}: {error}; set DRJIT_LIBLLVM_PATH to another libLLVM"
            ) from error
        os.environ["DRJIT_LIBLLVM_PATH"] = str(library)
    elif variant == "scalar_rgb":
        warnings.warn(
            "no usable libLLVM: falling back to Mitsuba's scalar_rgb, several times slower and without the "
            "transport recorder; pip install karellen-llvm-core",
            stacklevel=2,
        )
    import mitsuba as mi

    if variant.startswith("llvm"):
        check_loaded_llvm()
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi


def check_loaded_llvm() -> None:
    """Refuse an LLVM that would abort the process: Dr.Jit takes its LLVM when it is imported, not later."""
    import drjit

    version = drjit.detail.llvm_version()[0]
    if version < OLDEST_LLVM:
        loaded = f"LLVM {version}" if version > 0 else "no LLVM"
        raise PrtError(
            f"mitsuba or drjit was imported before prt and loaded {loaded}, but {OLDEST_LLVM} or newer is "
            "needed: call prt.scene.mitsuba_setup.mitsuba() before importing them, or start Python with "
            f"DRJIT_LIBLLVM_PATH={os.environ['DRJIT_LIBLLVM_PATH']}"
        )

"""C++ of this project, compiled at first use where there is a compiler and kept in the cache; never required.

What it computes also exists in torch: see :mod:`prt.nn.hashgrid` and :mod:`prt.methods.wavelet_shading`.
"""

import ctypes
import functools
import hashlib
import os
import shutil
import subprocess
import uuid
from pathlib import Path

from torch import Tensor

from prt.errors import PrtError
from prt.paths import cache_folder

#: shared by all sources
HEADERS = Path(__file__).parent
FLAGS = ("-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", "-pthread", f"-I{HEADERS}")
#: seconds
TIMEOUT = 120
FIX = "install a C++ compiler (CXX names one), or set method.kernel=auto"


@functools.cache
def library(source: Path) -> ctypes.CDLL:
    """The shared library of a C++ file.

    Raises:
        PrtError: if there is no compiler, or it fails, in one line.
    """
    compiler = find_compiler()
    if compiler is None:
        raise PrtError(f"{source.name} needs a C++ compiler and there is none; {FIX}")
    path = cache_folder() / "compiled" / f"{source.stem}-{key(source, compiler)}.so"
    if not path.exists():
        build(source, compiler, path)
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise PrtError(f"{path} cannot be loaded ({error}); delete it, or set method.kernel=auto") from error


def find_compiler() -> str | None:
    """``CXX``, or the first of c++, g++ and clang++ on the path."""
    names = [os.environ.get("CXX", "").strip(), "c++", "g++", "clang++"]
    return next((found for name in names if name and (found := shutil.which(name))), None)


def key(source: Path, compiler: str) -> str:
    """A hash of what determines the library: sources, compiler, flags, and the processor it is made for."""
    parts = [source.read_bytes(), *(path.read_bytes() for path in sorted(HEADERS.glob("*.hpp")))]
    told = subprocess.run([compiler, "--version"], capture_output=True, check=False, timeout=TIMEOUT).stdout
    parts += [told, " ".join(FLAGS[:-1]).encode(), " ".join(sorted(cpu_flags())).encode()]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:20]


@functools.cache
def cpu_flags() -> frozenset[str]:
    """The instruction sets the processor names, empty where the system does not list them."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    line = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return frozenset(line.partition(":")[2].split())


def build(source: Path, compiler: str, path: Path) -> None:
    """Compile under a temporary name, then rename: another process never loads half a library."""
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        command = [compiler, *FLAGS, str(source), "-o", str(temporary)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=TIMEOUT)
        if done.returncode:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or ["no message"]
            raise PrtError(f"{compiler} cannot compile {source.name}: {lines[0].strip()}; {FIX}")
        os.replace(temporary, path)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PrtError(f"{compiler} cannot compile {source.name} to {path}: {error}; {FIX}") from error
    finally:
        temporary.unlink(missing_ok=True)


def pointer(tensor: Tensor) -> ctypes.c_void_p:
    """The address of a contiguous CPU tensor's first number; keep the tensor alive over the call."""
    if not tensor.is_contiguous() or tensor.device.type != "cpu":
        raise ValueError("compiled code takes contiguous CPU tensors")
    return ctypes.c_void_p(tensor.data_ptr())

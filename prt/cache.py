"""A cache of files keyed by exactly the settings that determine their content.

Written to a temporary name, checksummed, renamed: a reader never sees half a file and two processes may
share one cache; what both want is built by one of them. A damaged file is detected by its checksum, named in
a warning, and rebuilt.
"""

import contextlib
import hashlib
import json
import os
import sys
import uuid
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import torch
from safetensors.torch import load, save
from torch import Tensor

from prt.errors import PrtError
from prt.paths import cache_folder

try:
    import fcntl
except ImportError:  # no flock on this system: two processes may build the same
    fcntl = None

Tensors = dict[str, Tensor]


def settings_key(settings: dict[str, Any]) -> str:
    """A short hash of plain settings, independent of the order of their keys."""
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def cached(kind: str, version: int, settings: dict[str, Any], build: Callable[[], Tensors]) -> Tensors:
    """The tensors that ``build`` returns, from the cache where they are there and whole.

    Args:
        kind: a folder name such as ``transport``.
        version: of the code that builds; raise it when the content changes for equal settings.
        settings: plain JSON data, all that determines the content.
        build: called on a miss.

    Raises:
        PrtError: if the cache folder cannot be read or written; known before ``build`` is called.
    """
    folder = cache_folder() / kind
    path = folder / f"{settings_key({'version': version, **settings})}.safetensors"
    found = read_checked(path)
    if found is not None:
        return found
    # An unwritable folder is better known before the minutes of building than after.
    probe = path.with_name(f"{path.name}.{uuid.uuid4().hex}.probe")
    write_atomically(probe, b"")
    probe.unlink(missing_ok=True)
    with alone(path):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damage, which has been said
            found = read_checked(path)
        if found is not None:  # another process has built it in the meantime
            return found
        # clone: safetensors refuses tensors that share memory, and a slice's file should hold only the slice
        tensors = {
            name: value.detach().clone(memory_format=torch.contiguous_format)
            for name, value in build().items()
        }
        write_checked(path, tensors)
    return tensors


@contextlib.contextmanager
def alone(path: Path) -> Iterator[None]:
    """Let one process at a time build what ``path`` will hold: runs of one scene begin together in a sweep.

    The system drops the lock of a process that died. Where locks do not work, none is taken.
    """
    lock = path.with_name(f"{path.name}.lock")
    file = wait_for(lock)
    try:
        yield
    finally:
        if file is not None:
            lock.unlink(missing_ok=True)
            file.close()


def wait_for(lock: Path) -> TextIO | None:
    """The lock file, opened and locked; None where the file system knows no locks."""
    if fcntl is None:
        return None
    while True:
        file = lock.open("a")
        try:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                print(f"another process is making {lock.with_suffix('')}; waiting for it", file=sys.stderr)
                fcntl.flock(file, fcntl.LOCK_EX)
            # whoever held it has removed the file: ours would guard nothing
            if os.fstat(file.fileno()).st_ino == lock.stat().st_ino:
                return file
        except FileNotFoundError:  # removed just now
            pass
        except OSError:
            file.close()
            return None
        except BaseException:
            file.close()
            raise
        file.close()


def read_checked(path: Path) -> Tensors | None:
    """The tensors of a cache file, or None where it is absent or damaged (a warning names the damaged file).

    Raises:
        PrtError: if the file is there but cannot be read.
    """
    try:
        blob = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise PrtError(
            f"cannot read {path}: {error.strerror or error}; "
            "make it readable or choose another folder (PRT_CACHE, run.folder)"
        ) from error
    digest, body = blob[:32], blob[32:]
    if hashlib.sha256(body).digest() != digest:
        warnings.warn(f"cache file {path} is damaged and will be rebuilt", stacklevel=3)
        return None
    return load(body)


def write_checked(path: Path, tensors: Tensors) -> None:
    """Write ``tensors`` behind their SHA-256, atomically."""
    body = save(tensors)
    write_atomically(path, hashlib.sha256(body).digest() + body)


def write_atomically(path: Path, content: bytes, instead: str = "PRT_CACHE, run.folder") -> None:
    """Put ``content`` at ``path`` through a temporary file in the same folder.

    Args:
        instead: what chooses another folder, for the error.

    Raises:
        PrtError: if the folder cannot be made or written.
    """
    # not tempfile: its files are readable by their owner alone, and a cache may be shared
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):  # it may never have come to be
            temporary.unlink()
        if isinstance(error, OSError):
            raise PrtError(
                f"cannot write {path}: {error.strerror or error}; "
                f"choose another folder ({instead}) or free the disk"
            ) from error
        raise

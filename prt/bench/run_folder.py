"""One run on disk: where its files lie, what state they show, and how they are read back.

State is read from the files, never remembered: ``DONE`` is written last, ``FAILED`` holds the reason, a held
lock means the run is under way, anything else was stopped and resumes with the same command.
"""

import contextlib
import csv
import io
import json
import os
import platform
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from prt.cache import settings_key, write_atomically
from prt.errors import PrtError

try:
    import fcntl
except ImportError:  # no flock on this system: runs still work, two processes are not kept apart
    fcntl = None

METRIC_COLUMNS = ("split", "view", "lighting", "component", "denoised", "metric", "value")
#: seconds a process waits for a lock that somebody only probes
LOCK_PATIENCE = 1.0


class RunFolder:
    """``runs/<task>/<scene>/<method>/<hash>/`` and the readers of its files."""

    def __init__(self, path: Path | str):
        self.path = Path(path)

    def __repr__(self) -> str:
        return f"RunFolder({str(self.path)!r})"

    # ---- where things lie
    @property
    def checkpoint(self) -> Path:
        """What rendering needs, as :meth:`prt.methods.base.Method.save` wrote it."""
        return self.path / "checkpoint.safetensors"

    @property
    def log_file(self) -> Path:
        return self.path / "log.csv"

    def image_file(
        self, split: str, view: str, lighting: str, component: str, denoised: bool = False
    ) -> Path:
        """The linear EXR of a test image: ``images/<split>/<view>/<lighting>/<component>[_denoised].exr``."""
        parts = [file_name(part) for part in (split, view, lighting)]
        name = component + ("_denoised" if denoised else "")
        return self.path.joinpath("images", *parts, name + ".exr")

    # ---- reading
    def config(self) -> DictConfig:
        """The resolved configuration; raises PrtError where the folder holds no run."""
        path = self.path / "config.yaml"
        if not path.exists():
            raise PrtError(
                f"{self.path} is no run folder: it has no config.yaml; `prt status` lists the runs"
            )
        return DictConfig(OmegaConf.load(path))

    def metrics(self) -> pd.DataFrame:
        """metrics.csv: split, view, lighting, component, metric (text), denoised (bool), value (float)."""
        path = self.path / "metrics.csv"
        if not path.exists():
            return pd.DataFrame({name: [] for name in METRIC_COLUMNS})
        kinds = {name: str for name in METRIC_COLUMNS if name not in ("denoised", "value")}
        return pd.read_csv(path, dtype=kinds, keep_default_na=False, na_values={"value": ["nan"]})

    def timing(self) -> dict[str, Any]:
        """timing.json: ``fit`` and ``bake`` in seconds, ``bytes`` of the model, ``device``, ``threads``, and
        for ``light``, ``shade``, ``gbuffer``, ``denoise`` a dict: ``median``, ``p95``, ``repetitions``."""
        return read_json(self.path / "timing.json")

    def provenance(self) -> dict[str, Any]:
        """provenance.json: commit, package versions, machine, device, threads, seed, times."""
        return read_json(self.path / "provenance.json")

    def log(self) -> pd.DataFrame:
        """log.csv: step, seconds of fitting, and what the method reported."""
        return (
            pd.read_csv(self.log_file)
            if self.log_file.exists()
            else pd.DataFrame({"step": [], "seconds": []})
        )

    @property
    def done(self) -> bool:
        return (self.path / "DONE").exists()

    def failure(self) -> str | None:
        """The reason in FAILED, None if the run did not fail."""
        path = self.path / "FAILED"
        return path.read_text().strip() if path.exists() else None

    def state(self) -> str:
        """``done``, ``failed``, ``running``, ``stopped`` (resumes with the same command) or ``absent``."""
        if self.done:
            return "done"
        if not (self.path / "config.yaml").exists():
            return "absent"
        if locked(self.path / "lock"):
            return "running"
        return "failed" if self.failure() is not None else "stopped"

    # ---- writing
    def begin(self, cfg: DictConfig, provenance: dict[str, Any]) -> None:
        """Write configuration and provenance; clears an earlier failure."""
        if not (self.path / "config.yaml").exists():
            write_atomically(self.path / "config.yaml", OmegaConf.to_yaml(cfg, resolve=True).encode())
        session = {name: provenance.get(name) for name in ("time", "commit", "machine", "command")}
        earlier = self.provenance()
        sessions = [*earlier.get("sessions", []), session]
        kept = {"fitted_by": earlier["fitted_by"]} if "fitted_by" in earlier else {}
        write_json(self.path / "provenance.json", {**provenance, **kept, "sessions": sessions})
        for name in ("FAILED", "traceback.txt"):
            (self.path / name).unlink(missing_ok=True)

    def write_metrics(self, rows: Iterable[tuple[str, ...]]) -> None:
        """Replace metrics.csv atomically; rows in the order of METRIC_COLUMNS, already text."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(METRIC_COLUMNS)
        writer.writerows(rows)
        write_atomically(self.path / "metrics.csv", text.getvalue().encode())

    def metric_rows(self) -> list[tuple[str, ...]]:
        """The rows of metrics.csv as text, exactly as written."""
        path = self.path / "metrics.csv"
        if not path.exists():
            return []
        with path.open(newline="") as file:
            return [tuple(row) for row in csv.reader(file)][1:]

    def add_timing(self, **entries: Any) -> None:
        """Merge entries into timing.json."""
        write_json(self.path / "timing.json", {**self.timing(), **entries})

    def finish(self) -> None:
        """Mark the run as done, the last thing written, and drop what only a resumed fit needs."""
        write_atomically(self.path / "DONE", (time.strftime("%Y-%m-%dT%H:%M:%S%z") + "\n").encode())
        shutil.rmtree(self.path / "state", ignore_errors=True)

    def fail(self, reason: str, trace: str) -> None:
        """Mark the run as failed with one line, the traceback beside it."""
        write_atomically(self.path / "traceback.txt", trace.encode())
        write_atomically(self.path / "FAILED", (" ".join(reason.split()) + "\n").encode())

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes out of this folder; the system drops the lock of a process that died.

        Raises:
            PrtError: if another process holds it, naming its pid and host, or the folder cannot be written.
        """
        path = self.path / "lock"
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            file = take(path)
        except OSError as error:
            reason = error.strerror or error
            raise PrtError(
                f"cannot write the run folder {self.path}: {reason}; choose another with run.folder=<path>"
            ) from error
        if file is None:
            raise PrtError(f"{self.path} is in use by {holder(path)}; wait for that run, or stop it")
        try:
            file.write(json.dumps({"pid": os.getpid(), "host": platform.node(), "time": int(time.time())}))
            file.flush()
            yield
        finally:
            path.unlink(missing_ok=True)
            file.close()


def run_hash(settings: dict[str, Any]) -> str:
    """The short hash that names a run folder."""
    return settings_key(settings)[:10]


def find_runs(folder: Path | str) -> list[RunFolder]:
    """All runs below ``folder`` (task/scene/method/hash), in the order of their paths."""
    return [RunFolder(path.parent) for path in sorted(Path(folder).glob("*/*/*/*/config.yaml"))]


def file_name(text: str) -> str:
    """Text made safe as part of a path."""
    return "".join(c if c.isalnum() or c in "-_.+" else "_" for c in text).lstrip(".") or "_"


def read_json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text()) if path.exists() else {}


def write_json(path: Path, content: dict[str, Any]) -> None:
    write_atomically(path, (json.dumps(content, indent=1, sort_keys=True) + "\n").encode())


def take(path: Path) -> io.TextIOWrapper | None:
    """The lock file opened and locked, or None if another process holds it."""
    end = time.monotonic() + LOCK_PATIENCE
    while True:
        file = path.open("a+")
        if fcntl is None:
            file.truncate(0)
            return file
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # a holder that just finished has removed the file: ours would guard nothing
            if path.exists() and os.fstat(file.fileno()).st_ino == path.stat().st_ino:
                file.truncate(0)
                return file
        except BlockingIOError:
            if time.monotonic() > end:
                file.close()
                return None
            time.sleep(0.05)
        except FileNotFoundError:
            pass
        file.close()


def locked(path: Path) -> bool:
    """Whether a living process holds the lock; does not disturb it."""
    if fcntl is None or not path.exists():
        return False
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except FileNotFoundError:
        return False
    return False


def holder(path: Path) -> str:
    """Who holds a lock, in words."""
    try:
        info = json.loads(path.read_text())
        return f"process {info['pid']} on {info['host']}"
    except (OSError, ValueError, KeyError):
        return "another process"

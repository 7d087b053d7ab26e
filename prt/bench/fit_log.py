"""What a method tells the runner while it fits: progress, log.csv, resumable states, and the watch for NaN.

A resumed fit is indistinguishable in its files from an uninterrupted one: rows of log.csv after the state it
resumes from are dropped, and the seconds of fitting go on from where that state was kept.
"""

import csv
import json
import math
import os
import time
import warnings
from collections.abc import Callable
from typing import Any, TextIO

import numpy as np
import torch
from torch import Tensor

from prt.bench.run_folder import RunFolder
from prt.cache import Tensors, read_checked, write_atomically, write_checked
from prt.errors import PrtError
from prt.progress import Bar

#: the tensor that holds the JSON tree of a state; no method's own path can have this name
TREE = "//tree"


class RunLog:
    """The :class:`prt.methods.base.FitLog` of one run folder; use as a context manager.

    Args:
        folder: the locked run folder.
        checkpoint_seconds: at least this long between two kept states.
        excluded: seconds spent so far on what is not fitting (preparing the data).
    """

    def __init__(
        self, folder: RunFolder, checkpoint_seconds: float = 30.0, excluded: Callable[[], float] = lambda: 0.0
    ):
        self.folder, self.checkpoint_seconds, self.excluded = folder, checkpoint_seconds, excluded
        self.steps = self.last = self.kept = 0
        self.carried = 0.0
        self.columns = ["step", "seconds"]
        self.file: TextIO | None = None
        self.bar: Bar | None = None
        self.resumed = False
        self.opened = self.saved = time.monotonic()
        self.not_fitting = excluded()

    def __enter__(self) -> "RunLog":
        self._restart(0.0)
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.__exit__(None, None, None)
        if self.file is not None:
            self.file.close()

    @property
    def seconds(self) -> float:
        """Wall seconds of fitting over all resumed parts, without what an interruption threw away."""
        return self.carried + time.monotonic() - self.opened - (self.excluded() - self.not_fitting)

    def _restart(self, carried: float) -> None:
        self.carried, self.not_fitting = carried, self.excluded()
        self.opened = self.saved = time.monotonic()

    # ---- the FitLog protocol

    def start(self, steps: int, label: str) -> None:
        if not self.resumed:  # a method that never resumes starts its log anew
            self._truncate(0)
        self.steps = steps
        self.bar = Bar(label, steps, self.last)
        self.bar.__enter__()

    def step(self, step: int, **values: float) -> None:
        for name, value in values.items():
            if not math.isfinite(value):
                kept = f"step {self.kept}" if self.kept else "none yet"
                became = "NaN" if math.isnan(value) else "infinite"
                raise PrtError(
                    f"{name} became {became} at step {step}, last good checkpoint: {kept}; "
                    "lower the method's learning rates or check the lighting, then run again"
                )
        self._row(step, values)
        if self.bar is not None:
            note = "  ".join(f"{name} {value:.3g}" for name, value in values.items())
            self.bar.advance(step - self.last, note=note)
        self.last = step

    def checkpoint_due(self, step: int) -> bool:
        return step == self.steps or time.monotonic() - self.saved >= self.checkpoint_seconds

    def save(self, step: int, state: dict[str, Any]) -> None:
        if self.file is not None:  # the log must not lag behind the state if the machine dies
            os.fsync(self.file.fileno())
        random = torch.get_rng_state()
        content = pack({"step": step, "seconds": self.seconds, "random": random, "state": state})
        current, previous = self._states()
        if current.exists():
            os.replace(current, previous)
        write_checked(current, content)
        self.kept, self.saved = step, time.monotonic()

    def resume(self) -> tuple[int, dict[str, Any]] | None:
        for path in self._states():
            if not path.exists():
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = read_checked(path)
            if found is None:
                warnings.warn(f"checkpoint {path} is damaged; taking the one before it", stacklevel=2)
                path.unlink()
                continue
            content = unpack(found)
            self.kept = self.last = int(content["step"])
            self._restart(float(content["seconds"]))
            torch.set_rng_state(content["random"])
            self._truncate(self.kept)
            return self.kept, content["state"]
        self._truncate(0)
        return None

    # ---- log.csv

    def _states(self):
        folder = self.folder.path / "state"
        return folder / "current.safetensors", folder / "previous.safetensors"

    def _row(self, step: int, values: dict[str, float]) -> None:
        new = [name for name in values if name not in self.columns]
        if new or self.file is None:
            self._reopen([*self.columns, *new])
        row = {"step": step, "seconds": f"{self.seconds:.3f}"}
        row |= {name: repr(float(value)) for name, value in values.items()}
        self.file.write(",".join(str(row.get(name, "")) for name in self.columns) + "\n")
        self.file.flush()

    def _reopen(self, columns: list[str], last_step: int | None = None) -> None:
        """Open log.csv for appending under these columns, keeping its rows up to ``last_step``."""
        if self.file is not None:
            self.file.close()
        path, rows = self.folder.log_file, []
        if path.exists():
            with path.open(newline="") as file:
                # a row cut short by a kill has no step or too few values
                whole = [row for row in csv.DictReader(file) if None not in row.values()]
                rows = [row for row in whole if row["step"].isdigit()]
        if last_step is not None:
            rows = [row for row in rows if int(row["step"]) <= last_step]
        lines = [",".join(columns)] + [",".join(row.get(name) or "" for name in columns) for row in rows]
        write_atomically(path, ("\n".join(lines) + "\n").encode())
        self.columns, self.file = columns, path.open("a")

    def _truncate(self, step: int) -> None:
        path, columns = self.folder.log_file, ["step", "seconds"]
        if step and path.exists():
            with path.open(newline="") as file:
                columns = next(csv.reader(file), columns)
        self._reopen(columns, step)
        self.resumed = True


def pack(state: dict[str, Any]) -> Tensors:
    """A nested state as tensors only: the structure and its plain values become JSON in one uint8 tensor.

    Keeps dicts with string or integer keys, lists, tuples, tensors, numbers, strings, booleans and None.

    Raises:
        TypeError: for anything else, naming where it is.
    """
    tensors: Tensors = {}

    def visit(value: Any, path: str) -> Any:
        if isinstance(value, Tensor):
            tensors[path] = value.detach().cpu().clone().contiguous()
            return {"tensor": path}
        if isinstance(value, dict):
            if any(not isinstance(key, str | int) for key in value):
                raise TypeError(f"training state {path or '/'}: keys must be strings or integers")
            return {"dict": [[key, visit(part, f"{path}/{key!r}")] for key, part in value.items()]}
        if isinstance(value, list | tuple):
            kind = "list" if isinstance(value, list) else "tuple"
            return {kind: [visit(part, f"{path}/{i}") for i, part in enumerate(value)]}
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | int | float | str):
            return {"value": value}
        raise TypeError(
            f"training state {path}: cannot keep a {type(value).__name__}, give tensors or numbers"
        )

    text = json.dumps(visit(state, ""))
    tensors[TREE] = torch.frombuffer(bytearray(text.encode()), dtype=torch.uint8)
    return tensors


def unpack(tensors: Tensors) -> dict[str, Any]:
    """The inverse of :func:`pack`; executes no code from the file."""

    def visit(node: dict[str, Any]) -> Any:
        ((kind, content),) = node.items()
        if kind == "tensor":
            return tensors[content]
        if kind == "dict":
            return {key: visit(part) for key, part in content}
        if kind in ("list", "tuple"):
            return (list if kind == "list" else tuple)(visit(part) for part in content)
        return content

    return visit(json.loads(bytes(tensors[TREE].numpy()).decode()))

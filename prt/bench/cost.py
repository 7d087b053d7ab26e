"""What a sweep cost: its wall time, the machine time of its runs, and what running several at a time saved.

Machine time is what one run after the other would have taken: seconds of fitting, of the data that methods
ask for, and of the rest (building, test images, metrics, timings), summed over the runs of this call.
"""

import contextlib
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prt.bench.run_folder import RunFolder
from prt.cache import write_atomically

#: the parts of a run's machine time, in seconds
PARTS = ("fit", "bake", "evaluate")


@dataclass
class Cost:
    """The running account of one call of ``prt run -m`` or ``prt table``.

    Attributes:
        launcher: its name, as ``ray``.
        workers: runs at a time, 1 where they run one after the other.
        before: runs that were done when the call began.
        done, failed: of those carried out by this call; ``failed`` counts the runs of dead workers too.
        seconds: machine time by :data:`PARTS`; that of dead workers is not known, and not counted.
    """

    launcher: str = "basic"
    workers: int = 1
    before: int = 0
    done: int = 0
    failed: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PARTS, 0.0))
    started: float = field(default_factory=time.monotonic)
    wall: float = 0.0

    def add(self, parts: dict[str, float], failed: bool) -> None:
        """Book a run that has ended, as :meth:`Watch.parts` gives it."""
        self.failed += failed
        self.done += not failed
        for name in PARTS:
            self.seconds[name] += parts.get(name, 0.0)
        self.wall = time.monotonic() - self.started

    @property
    def runs(self) -> int:
        """Runs that this call carried out."""
        return self.done + self.failed

    @property
    def machine(self) -> float:
        """Seconds of all runs."""
        return sum(self.seconds.values())

    def text(self) -> str:
        """One line for people."""
        counts = [f"{self.done} done"]
        counts += [f"{self.failed} failed"] if self.failed else []
        counts += [f"{self.before} done before"] if self.before else []
        parts = ", ".join(
            f"{word} {clock(self.seconds[name])}"
            for word, name in (("fits", "fit"), ("data", "bake"), ("the rest", "evaluate"))
        )
        speed = self.machine / self.wall if self.wall else 1.0
        workers = f"{self.workers} workers" if self.workers > 1 else "1 worker"
        return (
            f"cost: {', '.join(counts)} in {clock(self.wall)}; machine time {clock(self.machine)} ({parts}); "
            f"speed-up {speed:.2g} with {workers} (launcher={self.launcher})"
        )

    def keep(self, path: Path) -> None:
        """Add this call to the list in a JSON file; a damaged file is begun anew.

        Raises:
            PrtError: if it cannot be written.
        """
        try:
            calls = json.loads(path.read_text())
        except (OSError, ValueError):
            calls = []
        entry: dict[str, Any] = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "launcher": self.launcher, "workers": self.workers,
            "before": self.before, "done": self.done, "failed": self.failed,
            "wall": round(self.wall, 3),
            **{name: round(value, 3) for name, value in self.seconds.items()},
            "speedup": round(self.machine / self.wall, 3) if self.wall else 1.0,
        }  # fmt: skip
        calls = [*(calls if isinstance(calls, list) else []), entry]
        text = "[\n" + ",\n".join(" " + json.dumps(call) for call in calls) + "\n]\n"
        write_atomically(path, text.encode())


class Watch:
    """A stopwatch on one run, started before it: what this call spends, not what earlier ones did."""

    def __init__(self, folder: RunFolder):
        self.folder, self.started, self.earlier = folder, time.monotonic(), spent(folder)

    def parts(self) -> dict[str, float]:
        """Seconds since the start, by :data:`PARTS`."""
        whole, now = time.monotonic() - self.started, spent(self.folder)
        # a model taken over from another run was paid for there
        taken = "fitted_by" in self.folder.provenance()
        used = {name: 0.0 if taken else max(now[name] - self.earlier[name], 0.0) for name in now}
        fit = min(used["fit"], whole)
        bake = min(used["bake"], whole - fit)
        return {"fit": fit, "bake": bake, "evaluate": whole - fit - bake}


def spent(folder: RunFolder) -> dict[str, float]:
    """Seconds of fitting and data that the files of a run tell of."""
    timing = folder.timing()
    if "fit" in timing:
        return {"fit": float(timing["fit"]), "bake": float(timing.get("bake", 0.0))}
    # an interrupted fit goes on from its last state, with the seconds that state was kept with
    seconds = 0.0
    if (folder.path / "state").exists():
        with contextlib.suppress(ValueError, KeyError):  # a log cut short by a kill
            seconds = float(folder.log()["seconds"].max())
    return {"fit": seconds if seconds > 0 else 0.0, "bake": 0.0}


def clock(seconds: float) -> str:
    """``42 s``, ``3 min 05 s``, ``1 h 12 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"

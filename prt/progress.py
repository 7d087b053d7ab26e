"""Progress bars with remaining time; plain lines where the output is no terminal."""

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")
#: seconds between two lines of progress where the output is a file or a pipe
PLAIN_INTERVAL = 15.0


class Bar:
    """One progress bar; use as a context manager."""

    def __init__(self, label: str, total: int, done: int = 0):
        self.label, self.total, self.done = label, total, done
        self.rich: Progress | None = None
        self.started = self.printed = time.monotonic()
        self.first = done

    def __enter__(self) -> "Bar":
        if sys.stderr.isatty():
            self.rich = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[note]}"),
                transient=True,
            )
            from rich.console import Console

            self.rich.live.console = Console(stderr=True)
            self.rich.start()
            self.task = self.rich.add_task(self.label, total=self.total, completed=self.done, note="")
        return self

    def advance(self, by: int = 1, note: str = "") -> None:
        self.done += by
        if self.rich is not None:
            self.rich.update(self.task, completed=self.done, note=note)
        elif time.monotonic() - self.printed > PLAIN_INTERVAL:
            self.printed = time.monotonic()
            pace = (self.printed - self.started) / max(self.done - self.first, 1)
            left = pace * (self.total - self.done)
            print(
                f"{self.label}: {self.done}/{self.total}, {left:.0f} s left {note}".rstrip(),
                file=sys.stderr,
                flush=True,
            )

    def __exit__(self, *_: object) -> None:
        if self.rich is not None:
            self.rich.stop()


def track(items: Iterable[Item], label: str, total: int) -> Iterator[Item]:
    """Iterate with a progress bar."""
    with Bar(label, total) as bar:
        for item in items:
            yield item
            bar.advance()

"""How long a piece of work takes: warmed up, synchronised, repeated; median and 95th percentile.

Compare times only within one run of one command on one machine.
"""

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from prt.errors import PrtError


@dataclass(frozen=True)
class Timing:
    """Seconds per call over ``repetitions`` calls, with what they ran on."""

    median: float
    p95: float
    repetitions: int
    threads: int
    device: str

    def to_dict(self) -> dict[str, float | int | str]:
        return asdict(self)


def time_repeated(
    function: Callable[[], object],
    repetitions: int = 30,
    warmup: int = 3,
    device: str = "cpu",
    synchronise: Callable[[], object] | None = None,
) -> Timing:
    """Time ``function`` call by call with the monotonic clock.

    Args:
        function: the work, without arguments.
        repetitions: timed calls; a reported time has at least 30.
        warmup: calls before, untimed: caches, compiled kernels, clocks.
        device: where it runs, ``cpu`` or ``cuda``; names the result, and for ``cuda`` sets ``synchronise``.
        synchronise: waits until the device is idle, before and after each call; for asynchronous work
            elsewhere (``dr.sync_thread`` for Dr.Jit).

    Raises:
        PrtError: if ``repetitions`` < 1 or ``warmup`` < 0.
    """
    if repetitions < 1 or warmup < 0:
        raise PrtError(
            f"repetitions={repetitions}, warmup={warmup}: at least 1 and 0; use 30 and 3 for reported times"
        )
    if synchronise is None:
        synchronise = torch.cuda.synchronize if torch.device(device).type == "cuda" else lambda: None
    for _ in range(warmup):
        function()
    seconds = np.empty(repetitions)
    for i in range(repetitions):
        synchronise()
        start = time.perf_counter()
        function()
        synchronise()
        seconds[i] = time.perf_counter() - start
    return Timing(
        float(np.median(seconds)), float(np.percentile(seconds, 95)), repetitions, torch.get_num_threads(),
        device_name(device),
    )  # fmt: skip


def device_name(device: str = "cpu") -> str:
    """The hardware behind a torch device, in words: the GPU's or the processor's model."""
    if torch.device(device).type == "cuda":
        return torch.cuda.get_device_name(torch.device(device))
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()

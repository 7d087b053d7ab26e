"""``prt status``: runs by state, read from their folders."""

import time
from pathlib import Path

from prt.bench.run_folder import RunFolder, find_runs
from prt.errors import PrtError

HEAD = ("state", "task", "scene", "method", "run", "budget", "step", "age", "note")
ORDER = ("running", "failed", "stopped", "done")


def main(folder: Path) -> int:
    """Print the table; raises PrtError where there is no such folder."""
    if not folder.is_dir():
        raise PrtError(f"--folder {folder} does not exist; give the folder of your runs (run.folder)")
    runs = [RunFolder(folder)] if (folder / "config.yaml").exists() else below(folder)
    lines = sorted((line(run) for run in runs), key=lambda cells: ORDER.index(cells[0]))
    if not lines:
        print(f"no runs in {folder}; start one: prt run scene=cornell_glossy")
        return 0
    widths = [max(len(cells[i]) for cells in (HEAD, *lines)) for i in range(len(HEAD))]
    for cells in (HEAD, *lines):
        print("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
    counts = {state: sum(cells[0] == state for cells in lines) for state in ORDER}
    print(", ".join(f"{count} {state}" for state, count in counts.items() if count))
    if counts["stopped"] or counts["failed"]:
        print("stopped runs resume and failed runs try again with the command that started them")
    return 0


def below(folder: Path) -> list[RunFolder]:
    """Runs anywhere below a folder, at whatever level of runs/<task>/<scene>/<method> it is."""
    return find_runs(folder) or [RunFolder(path.parent) for path in sorted(folder.glob("**/config.yaml"))]


def line(run: RunFolder) -> tuple[str, ...]:
    """The cells of one run."""
    state = run.state()
    cfg = run.config()
    return (
        state, str(cfg.choice.task), str(cfg.choice.scene), str(cfg.choice.method), run.path.name,
        str(cfg.choice.budget), last_step(run), age(run), note(run, state),
    )  # fmt: skip


def last_step(run: RunFolder) -> str:
    """The last step in log.csv; an empty text for methods that do not train."""
    if not run.log_file.exists():
        return ""
    lines = run.log_file.read_text().splitlines()
    return lines[-1].split(",")[0] if len(lines) > 1 else "0"


def age(run: RunFolder) -> str:
    """Time since the run's files last changed."""
    seconds = time.time() - max((path.stat().st_mtime for path in run.path.iterdir()), default=time.time())
    for size, unit in ((86400, "d"), (3600, "h"), (60, "min")):
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(seconds, 0):.0f} s"


def note(run: RunFolder, state: str) -> str:
    """Why it failed, or how far it came."""
    if state == "failed":
        return run.failure() or "no reason was written"
    items = len({row[:3] for row in run.metric_rows()})
    if state == "done":
        return f"{items} test images"
    if run.checkpoint.exists():
        return f"fitted, {items} test images judged"
    return "fitting"

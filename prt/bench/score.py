"""``prt score``: metrics again from the stored images, without fitting anything."""

from collections.abc import Sequence
from pathlib import Path

from prt.bench.evaluate import image_rows, key
from prt.bench.exr import read_exr
from prt.bench.run import build_task, say, summary
from prt.bench.run_folder import RunFolder
from prt.bench.status import below
from prt.errors import PrtError
from prt.metrics.registry import BAD_PIXELS, METRICS, metric_of
from prt.progress import Bar


def main(folders: Sequence[Path], metrics: Sequence[str] | None = None) -> int:
    """Score every finished run in or below the folders; raises PrtError where there is none."""
    for name in metrics or ():
        metric_of(name)
    runs = []
    for folder in folders:
        found = [RunFolder(folder)] if (folder / "config.yaml").exists() else below(folder)
        if not found:
            raise PrtError(f"no runs in {folder}; `prt status --folder <folder>` lists those there are")
        runs += found
    skipped = [run for run in runs if not run.done]
    for run in runs:
        if run.done:
            score(run, metrics)
            print(f"{run.path}\n{summary(run)}")
    for run in skipped:
        say(f"skipped, {run.state()}: {run.path}")
    if len(skipped) == len(runs):
        raise PrtError("none of these runs is finished; finish them with the command that started them")
    return 0


def score(run: RunFolder, metrics: Sequence[str] | None = None) -> None:
    """Replace the image metrics of one run; figures that need the method (the error split) are kept.

    Raises:
        PrtError: if its images were not kept.
    """
    cfg = run.config()
    names = list(metrics or cfg.run.metrics)
    images = {row[:5] for row in run.metric_rows() if row[5] in (*METRICS, BAD_PIXELS)}
    replaced = {*names, BAD_PIXELS}
    kept = [row for row in run.metric_rows() if row[5] not in replaced]
    rows = []
    with run.lock():
        items = build_task(cfg).tests()
        known = {key(item) for item in items}
        rows += [row for row in run.metric_rows() if row[:3] not in known]  # they have no reference any more
        with Bar(f"score {cfg.choice.method}", len(items)) as bar:
            for item in items:
                for component in item.references:
                    for flag in (False, True):
                        if (*key(item), component, "true" if flag else "false") not in images:
                            continue
                        image = read_exr(run.image_file(*key(item), component, flag))
                        rows += image_rows(item, component, flag, image, names)
                rows += [row for row in kept if row[:3] == key(item)]
                bar.advance()
        run.write_metrics(rows)


def complete(run: RunFolder, wanted: Sequence[str]) -> None:
    """Give a finished run the metrics that another table did not ask for, from its stored images.

    Where those were not kept (run.images.save=false) the metrics stay away, and a line says so.
    """
    have = {row[5] for row in run.metric_rows()}
    missing = [name for name in wanted if name not in have]
    if not missing or not have:
        return
    try:
        say(f"{', '.join(missing)} of {run.path}, from its images")
        score(run, missing)
    except PrtError as error:
        say(f"    not possible: {error}")

"""Sweeps: every combination of the values given, through whichever launcher is chosen."""

from collections.abc import Sequence
from pathlib import Path

from hydra.core.plugins import Plugins

from prt.bench import compose, launch, launchers
from prt.bench.run import say, summary
from prt.errors import PrtError


def sweep(overrides: Sequence[str]) -> int:
    """Run every combination; a failed run, or one whose worker died, does not stop the others.

    Prints every run's summary, and in the end what the sweep cost (kept in ``cost.json`` of the sweep's
    folder, below ``<run.folder>/.sweeps/``).

    Returns:
        0 if all runs are done, 2 otherwise (each failure has been printed; those of a run's own stand in its
        folder's FAILED).

    Raises:
        PrtError: for mistakes in the overrides, before anything runs; for a launcher that cannot be reached.
    """
    overrides = compose.with_companions(overrides)
    compose.check_additions(overrides)
    with compose.reported(overrides):
        cfg, context, settings = launchers.master(overrides)
        sweeper = Plugins.instance().instantiate_sweeper(
            config=cfg, hydra_context=context, task_function=launch.job_of(settings)
        )
        # every sweeper sends its jobs through its launcher; ours asks that one, and answers for dead workers
        answering = launch.Answering(sweeper.launcher, settings, tell)  # pyright: ignore
        sweeper.launcher = answering  # pyright: ignore
        try:
            context.callbacks.on_multirun_start(config=cfg, config_name="config")
            sweeper.sweep(arguments=launchers.plain(cfg))
            context.callbacks.on_multirun_end(config=cfg, config_name="config")
        except OSError as error:  # Hydra's own folder of the sweep; a run's errors are in its outcome
            where = f"{error.filename}: {error.strerror}"
            raise PrtError(f"cannot write {where}; choose another with run.folder=<path>") from error
    if answering.cost.runs:
        say(answering.cost.text())
        answering.cost.keep(Path(str(cfg.hydra.sweep.dir)) / "cost.json")
    failed = sum(bool(outcome.reason) for outcome in answering.outcomes)
    if failed:
        count = f"{failed} of {len(answering.outcomes)}"
        say(f"prt: error: some runs of the sweep failed ({count}), the others are done; see `prt status`")
    return 2 if failed else 0


def tell(plan: launch.Plan, outcome: launch.Outcome) -> None:
    """Print what became of a run when it is known."""
    if outcome.reason:
        say(f"prt: error: {' '.join(plan.words)}: {outcome.reason}")
        return
    if outcome.before:
        say(f"done already: {outcome.run.path}")
    print(f"{outcome.run.path}\n{summary(outcome.run)}", flush=True)

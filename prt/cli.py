"""The ``prt`` command: one subcommand per question, every mistake in one line."""

import argparse
import os
import shlex
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prt.arguments import parser
from prt.errors import PrtError

BUG = "; this is a bug, see traceback.txt in the run folder or add --debug"


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; the exit status: 0 done, 1 a bug or failed runs, 2 a mistake to mend, 130 interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    warnings.showwarning = show_warning
    signal.signal(signal.SIGTERM, stop)
    if os.getcwd() not in sys.path:  # a user's own method may lie in the current folder
        sys.path.append(os.getcwd())
    try:
        options, rest = parser().parse_known_args(words)
        strange = [word for word in rest if word.startswith("-") or not hasattr(options, "overrides")]
        if strange:
            called = " ".join(["prt", *([options.command] if options.command else [])])
            raise PrtError(f"unknown option {strange[0]!r}; see `{called} --help`")
        if options.command is None:
            parser().print_help()
            return 0
        if rest:
            options.overrides = in_order(words, [*options.overrides, *rest])
        return COMMANDS[options.command](options)
    except PrtError as error:
        return report(error, 2, "--debug" in words)
    except KeyboardInterrupt:
        again = shlex.join(["prt", *words])
        print(f"\nprt: interrupted; the same command resumes where it stopped: {again}", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stdout = None  # whoever read us has left: nothing to flush
        return 1
    except Exception as error:  # a bug: still one line, the traceback on request and in FAILED
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return report(PrtError(text + BUG), 1, "--debug" in words)


def in_order(words: list[str], overrides: list[str]) -> list[str]:
    """Overrides in the order of the command line (options may stand between them)."""
    return sorted(overrides, key=words.index)


def report(error: BaseException, status: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    print(f"prt: error: {' '.join(str(error).split())}", file=sys.stderr)
    return status


def show_warning(message: Any, *_: Any, **__: Any) -> None:
    print(f"prt: warning: {' '.join(str(message).split())}", file=sys.stderr)


def stop(*_: object) -> None:
    """A polite request to end (SIGTERM, a time limit) is an interruption: the run resumes later."""
    raise KeyboardInterrupt


def add_conf_dirs(folders: Sequence[str]) -> None:
    """Make a user's own YAML folders known, to this process and to those a launcher starts."""
    known = [part for part in os.environ.get("PRT_CONF_DIRS", "").split(os.pathsep) if part]
    os.environ["PRT_CONF_DIRS"] = os.pathsep.join([*known, *(str(Path(f).resolve()) for f in folders)])


def run_command(options: argparse.Namespace) -> int:
    from prt.bench import compose, launchers, run, sweep

    add_conf_dirs(options.conf_dir)
    if options.multirun:
        return sweep.sweep(options.overrides)
    launchers.refuse(options.overrides)
    cfg = compose.compose(options.overrides)
    if options.show:
        from omegaconf import OmegaConf

        print(OmegaConf.to_yaml(cfg).rstrip())
        print(f"# run folder: {run.folder_of(cfg).path}")
        return 0
    folder = run.run(cfg)
    print(f"{folder.path}\n{run.summary(folder)}")
    return 0


def table_command(options: argparse.Namespace) -> int:
    from prt.bench import table

    add_conf_dirs(options.conf_dir)
    return table.main(options.name, options.overrides, options.dry_run) or 0


def needs_command(options: argparse.Namespace) -> int:
    from prt.bench import needs

    add_conf_dirs(options.conf_dir)
    return needs.main(options.overrides)


def select_command(options: argparse.Namespace) -> int:
    from prt.bench import select

    add_conf_dirs(options.conf_dir)
    return select.main(options.overrides)


def report_command(options: argparse.Namespace) -> int:
    from prt.bench.html import page

    return page.main(options.names, options.output)


def view_command(options: argparse.Namespace) -> int:
    from prt.bench import viewer

    return viewer.main(options.runs, options.port, options.size, options.host, options.component)


def export_command(options: argparse.Namespace) -> int:
    from prt.bench import export

    return export.main(
        options.run, options.kind, options.frames, options.size, options.fps, options.formats.split(","),
        options.output, options.component, options.lighting,
    )  # fmt: skip


def status_command(options: argparse.Namespace) -> int:
    from prt.bench import status

    return status.main(options.folder)


def score_command(options: argparse.Namespace) -> int:
    from prt.bench import score

    return score.main(options.folders, options.metrics.split(",") if options.metrics else None)


def doctor_command(options: argparse.Namespace) -> int:
    from prt.bench import doctor

    return doctor.main()


COMMANDS = {
    "run": run_command,
    "table": table_command,
    "needs": needs_command,
    "select": select_command,
    "view": view_command,
    "export": export_command,
    "report": report_command,
    "status": status_command,
    "score": score_command,
    "doctor": doctor_command,
}

if __name__ == "__main__":
    sys.exit(main())

"""Sweeps: every combination of the values given, through whichever Hydra launcher is chosen."""

import os
import sys
from collections.abc import Sequence
from unittest import mock

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from prt.bench import compose
from prt.bench.run import run, say, summary
from prt.errors import PrtError


def job(cfg: DictConfig) -> str:
    """One run of a sweep; module level so that launchers can send it to other processes."""
    chosen = HydraConfig.get().runtime.choices
    words = " ".join(HydraConfig.get().overrides.task)
    try:
        with compose.reported([]):
            folder = run(compose.finish(cfg, chosen))
        print(f"{folder.path}\n{summary(folder)}", flush=True)
        return str(folder.path)
    except Exception as error:
        kind = "" if isinstance(error, PrtError) else f"{type(error).__name__}: "
        say(f"prt: error: {words}: {kind}{' '.join(str(error).split())}")
        # a plain error of text only crosses every launcher's process border
        raise PrtError(f"{words}: {kind}{error}") from None


def sweep(overrides: Sequence[str]) -> int:
    """Run every combination; a failed run does not stop the others.

    Returns:
        0 if all runs are done, 2 otherwise (each failure has been printed and stands in its folder's FAILED).

    Raises:
        PrtError: for mistakes in the overrides, before anything runs.
    """
    overrides = compose.with_companions(overrides)
    compose.check_additions(overrides)
    app = hydra.main(version_base="1.3", config_path=str(compose.conf_folder()), config_name="config")(job)
    words = ["prt run", "--multirun", *compose.searchpath_override(), *overrides]
    # Hydra reads the command line, and only with this variable hands its errors to the caller
    with mock.patch.object(sys, "argv", words), mock.patch.dict(os.environ, {"HYDRA_FULL_ERROR": "1"}):
        try:
            app()
        except (HydraException, OmegaConfBaseException) as error:
            raise compose.translate(error, overrides) from error
        except OSError as error:  # Hydra's own folder of the sweep; a run's errors come as PrtError
            where = f"{error.filename}: {error.strerror}"
            raise PrtError(f"cannot write {where}; choose another with run.folder=<path>") from error
        except PrtError:
            say("prt: error: some runs of the sweep failed, the others are done; `prt status` lists them")
            return 2
    return 0

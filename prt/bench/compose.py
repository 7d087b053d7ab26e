"""From overrides to one strict, resolved configuration.

Every mistake becomes one line with the nearest right spelling.
"""

import contextlib
import difflib
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException

import prt
from prt.errors import PrtError
from prt.metrics.registry import metric_of

#: the groups whose settings are constructor arguments; only these take new keys with ``+``
BUILT = ("task", "scene", "lighting", "method")
GROUPS = (*BUILT, "budget")
#: settings that decide how a run is carried out and stored, not what comes out of it
RUN_ONLY = ("folder", "checkpoint_seconds", "metrics", "repetitions", "images")


def conf_folder() -> Path:
    """The folder of the Hydra groups: ``PRT_CONF``, or ``conf/`` beside the package."""
    value = os.environ.get("PRT_CONF", "").strip()
    folder = Path(value).expanduser() if value else Path(prt.__file__).resolve().parent.parent / "conf"
    if not (folder / "config.yaml").is_file():
        raise PrtError(f"no configuration in {folder}; set PRT_CONF to the folder of prt's config.yaml")
    return folder.resolve()


def conf_folders() -> list[Path]:
    """Folders of YAML files: the project's, then the user's own (``--conf-dir``, ``PRT_CONF_DIRS``)."""
    listed = os.environ.get("PRT_CONF_DIRS", "").split(os.pathsep)
    own = [Path(part).expanduser().resolve() for part in listed if part]
    for folder in own:
        if not folder.is_dir():
            raise PrtError(f"--conf-dir: {folder} is no folder; give the one that holds method/, scene/, ...")
    return [conf_folder(), *own]


def choices(group: str) -> list[str]:
    """The names of the YAML files of a group, over all conf folders."""
    return sorted({path.stem for folder in conf_folders() for path in (folder / group).glob("*.yaml")})


def searchpath_override() -> list[str]:
    """The Hydra override that adds the user's own conf folders."""
    own = conf_folders()[1:]
    return [f"hydra.searchpath=[{','.join(f'file://{folder}' for folder in own)}]"] if own else []


def by_budget(table: dict[str, Any], *, _root_: DictConfig) -> Any:
    """Resolver ``${by_budget:{smoke:16,laptop:64,paper:128}}``: the entry of the root's ``budget.name``."""
    name = _root_.budget.name
    if name not in table:
        raise PrtError(f"budget={name} has no value here; choose from {', '.join(table)}")
    value = table[name]
    return OmegaConf.create(value) if isinstance(value, list | dict) else value


OmegaConf.register_new_resolver("by_budget", by_budget, replace=True)


def compose(overrides: Sequence[str], gpu: bool | None = None) -> DictConfig:
    """The resolved configuration of one run.

    Adds ``choice``, the name chosen in every group. Composing twice gives the same result.

    Args:
        gpu: whether the machine that will carry it out has a GPU; None if that is this one.

    Raises:
        PrtError: for a misspelt key, an unknown choice, a malformed override, an unknown budget.
    """
    overrides = with_companions(overrides)
    check_additions(overrides)
    with reported(overrides):
        cfg = raw_compose(overrides)
        return finish(cfg, gpu=gpu)


def with_companions(overrides: Sequence[str]) -> list[str]:
    """The overrides, before them the choices that the chosen task's YAML makes under ``_with_``.

    A task may need a lighting or a method of its own kind; the defaults of ``config.yaml`` are another's.
    """
    task = next((text.partition("=")[2] for text in reversed(overrides) if text.startswith("task=")), None)
    for folder in reversed(conf_folders()):
        path = folder / "task" / f"{task}.yaml"
        if task and path.is_file():
            found = OmegaConf.load(path).get("_with_") or {}
            given = {text.partition("=")[0] for text in overrides}
            added = [f"{group}={name}" for group, name in found.items() if group not in given]
            return [*added, *overrides]
    return list(overrides)


def raw_compose(overrides: Sequence[str]) -> DictConfig:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(conf_folder()), version_base="1.3", job_name="prt"):
        return hydra_compose("config", [*searchpath_override(), *overrides], return_hydra_config=True)


def finish(cfg: DictConfig, chosen: dict[str, Any] | None = None, gpu: bool | None = None) -> DictConfig:
    """Check, resolve and complete a configuration (with its ``hydra`` node, or with ``chosen`` given).

    The launcher's settings are left out: where a run is carried out is no part of it.
    """
    chosen = dict(chosen if chosen is not None else cfg.hydra.runtime.choices)
    names = {group: str(chosen[group]).replace("/", "_") for group in GROUPS if chosen.get(group)}
    missing = [key for key in (*GROUPS, "seed", "device", "run") if cfg.get(key) is None]
    if missing:
        raise PrtError(f"{missing[0]} is missing; do not delete it, choose one ({missing[0]}=...)")
    cfg = OmegaConf.create({key: cfg._get_node(key) for key in cfg if key not in ("hydra", "launcher")})
    with open_dict(cfg):
        cfg.task.pop("_with_", None)
        cfg.method.pop("_ladder_", None)
    resolve(cfg, names)
    with open_dict(cfg):
        cfg.choice = names
        cfg.device = device_kind(cfg.device, gpu)
    check_root(cfg)
    OmegaConf.set_struct(cfg, True)
    return cfg


def resolve(cfg: DictConfig, names: dict[str, str]) -> None:
    """Resolve in place; an error names the setting, which OmegaConf's own does not."""
    try:
        OmegaConf.resolve(cfg)
    except InterpolationResolutionError as error:
        reason = str(error).split("interpolation: ", 1)[-1].splitlines()[0]
        for key in all_keys(cfg):
            try:
                OmegaConf.select(cfg, key)
            except InterpolationResolutionError:
                missing = re.search(r"'task\.(\w+)' not found", reason)
                if missing:  # as a relighting task's environments with one that has none
                    group = key.partition(".")[0]
                    raise PrtError(
                        f"{group}={names.get(group)} does not go with task={names.get('task')}, which has no "
                        f"{missing[1]}; leave {group} out, and the task's own is taken"
                    ) from error
                raise PrtError(f"{key}: {reason}") from error
        raise PrtError(reason) from error


def device_kind(wanted: Any, gpu: bool | None = None) -> str:
    """``cpu`` or ``cuda`` for the setting ``device``; ``gpu`` as in :func:`compose`."""
    if wanted not in ("auto", "cpu", "cuda"):
        raise PrtError(f"device={wanted!r} is not one of auto, cpu, cuda")
    have = torch.cuda.is_available() if gpu is None else gpu
    if wanted == "cuda" and not have and gpu is not None:
        raise PrtError("device=cuda: the launcher gives a run no GPU; add launcher.gpus=1, or device=cpu")
    if wanted == "cuda" and not have:
        raise PrtError(
            "device=cuda: torch sees no CUDA device; use device=auto or device=cpu, see `prt doctor`"
        )
    return "cuda" if have and wanted == "auto" else str(wanted).replace("auto", "cpu")


def check_root(cfg: DictConfig) -> None:
    """The few settings the runner itself reads."""
    integer = isinstance(cfg.seed, int) and not isinstance(cfg.seed, bool)
    if not integer or cfg.seed < 0:
        raise PrtError(f"seed={cfg.seed!r} must be an integer of at least 0")
    seconds = cfg.run.checkpoint_seconds
    if not isinstance(seconds, int | float) or seconds < 0:
        raise PrtError(f"run.checkpoint_seconds={seconds!r} must be a number of seconds of at least 0")
    if not isinstance(cfg.run.repetitions, int) or cfg.run.repetitions < 30:
        raise PrtError(f"run.repetitions={cfg.run.repetitions!r} must be an integer of at least 30")
    for name in cfg.run.metrics:
        metric_of(name)
    for key in ("run.denoise", "run.images.save"):
        value = OmegaConf.select(cfg, key)
        if not isinstance(value, bool):
            raise PrtError(f"{key}={value!r} must be true or false")


def hashed_settings(cfg: DictConfig) -> dict[str, Any]:
    """What determines a run's results, as plain data: all but bookkeeping and descriptions."""
    plain: Any = OmegaConf.to_container(cfg, resolve=True)
    plain["run"] = {key: value for key, value in plain["run"].items() if key not in RUN_ONLY}
    plain["budget"] = plain["budget"]["name"]
    return plain


def check_additions(overrides: Sequence[str]) -> None:
    """``+key=value`` may only add constructor arguments: anywhere else it would be silently ignored."""
    for text in overrides:
        match = re.match(r"\+\+?([\w./@]+)=", text)
        key = match.group(1) if match else None
        if key is None or key.startswith(("hydra", "launcher.options.")) or key.split(".")[0] in BUILT:
            continue
        if text.startswith("++") and known_key(key):
            continue
        if any((folder / key).is_dir() for folder in conf_folders()):
            continue
        raise PrtError(f"+{key}: nothing reads this setting; new keys go only to {', '.join(BUILT)}")


def known_key(key: str) -> bool:
    return key in all_keys(raw_compose([]))


@contextlib.contextmanager
def reported(overrides: Sequence[str]):
    """Turn the errors of Hydra and OmegaConf into a PrtError of one line."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise translate(error, overrides) from error


def translate(error: BaseException, overrides: Sequence[str]) -> PrtError:
    """The one-line version of a Hydra or OmegaConf error, with near misses."""
    own = find_own(error)
    if own is not None:
        return own
    text = str(error)
    if match := re.search(r"Could not override '([^']+)'", text):
        key = match.group(1)
        return PrtError(f"unknown setting {key!r}{near(key, keys_without(key, overrides))}")
    if match := re.search(r"Could not (?:delete from config|find)[^']*'([^']+)'", text):
        group, _, name = match.group(1).rpartition("/")
        options = choices(group) or re.findall(r"^\t(\w+)$", text.split("Config search path")[0], re.M)
        if name and options:
            hint = near(name, options)
            return PrtError(f"{group}={name} does not exist{hint}; choose from {', '.join(options)}")
    if "Ambiguous value" in text:
        return PrtError(f"{text.splitlines()[0]}: several values are a sweep, add -m; a list is key=[a,b]")
    if isinstance(error, OverrideParseException):
        return PrtError(
            f"cannot read {error.override!r}: an override is key=value, as in seed=1 or scene=kitchen, "
            "a list is key=[1,2], odd characters need quotes"
        )
    return PrtError(" ".join(text.split()))


def find_own(error: BaseException | None) -> PrtError | None:
    """A PrtError among the causes of an error."""
    while error is not None:
        if isinstance(error, PrtError):
            return error
        error = error.__cause__
    return None


def near(word: str, options: Sequence[str]) -> str:
    """``; did you mean ...?``, or nothing."""
    found = difflib.get_close_matches(word, options, n=2, cutoff=0.6)
    if not found:  # the last part may be right and the prefix missing: `width` for `method.width`
        found = [option for option in options if option.rpartition(".")[2] == word.rpartition(".")[2]][:2]
    return f"; did you mean {' or '.join(found)}?" if found else ""


def keys_without(key: str, overrides: Sequence[str]) -> list[str]:
    """All settings of the configuration as it would be without the overrides that name ``key``."""
    rest = [text for text in overrides if not re.match(rf"[+~]*{re.escape(key)}(=|$)", text)]
    for attempt in (rest, [text for text in rest if text.partition("=")[0] in GROUPS], []):
        try:
            return all_keys(raw_compose(attempt))
        except (HydraException, OmegaConfBaseException):
            continue
    return []


def all_keys(cfg: DictConfig) -> list[str]:
    """Dotted names of all settings but hydra's own."""
    found: list[str] = []

    def visit(node: Any, prefix: str) -> None:
        for name, value in node.items() if isinstance(node, dict) else ():
            found.append(prefix + str(name))
            visit(value, prefix + str(name) + ".")

    visit({k: v for k, v in OmegaConf.to_container(cfg, resolve=False).items() if k != "hydra"}, "")
    return [key for key in found if not re.search(r"(^|\.)_\w+_$", key)]  # _target_, _with_, _ladder_

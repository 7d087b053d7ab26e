"""From configuration to objects: Hydra's ``_target_``, with every mistake in one line."""

import contextlib
import inspect
import re
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import get_class, instantiate
from omegaconf import DictConfig, OmegaConf

from prt.bench.compose import conf_folders, find_own, near
from prt.errors import PrtError


def build(cfg: DictConfig, group: str, **objects: Any) -> Any:
    """Instantiate the group's ``_target_`` with its settings, and with ``objects`` passed on untouched.

    Raises:
        PrtError: if the target cannot be imported or does not know a setting, naming it and what is allowed.
    """
    settings = cfg[group]
    target = settings.get("_target_")
    if not target:
        raise PrtError(f"conf/{group}/{cfg.choice[group]}.yaml has no _target_; name the class to build")
    try:
        # partial first: Hydra would copy the objects into a config node
        make = instantiate(settings, _partial_=True, _convert_="all")
    except InstantiationException as error:
        raise find_own(error) or PrtError(
            f"{group}._target_={target} cannot be built: {' '.join(str(error.__cause__ or error).split())}; "
            "check the name, and that its package is installed or in the current folder"
        ) from error
    try:
        inspect.signature(make.func).bind(**make.keywords, **objects)
    except TypeError as error:
        raise constructor_error(group, make.func, error) from error
    return make(**objects)


def constructor_error(group: str, func: Any, error: TypeError) -> PrtError:
    """A setting the constructor does not know, or misses, in one line."""
    takes = [name for name in inspect.signature(func).parameters if name not in ("scene", "lighting")]
    match = re.search(r"unexpected keyword argument '(\w+)'", str(error))
    if match:
        wrong = f"{group}.{match.group(1)} is not a setting of {func.__name__}{near(match.group(1), takes)}"
        return PrtError(f"{wrong}; it takes {', '.join(takes) or 'none'}")
    return PrtError(f"{group}: {func.__name__}: {error}; it takes {', '.join(takes) or 'none'}")


def target_class(group: str, name: str) -> type | None:
    """The class a YAML of a group names, None where it cannot be imported here."""
    for folder in reversed(conf_folders()):
        path = folder / group / f"{name}.yaml"
        if path.exists():
            with contextlib.suppress(Exception):
                return get_class(OmegaConf.load(path)["_target_"])
    return None

"""Capacity ladders: the sizes a method comes in, from the smallest to the largest.

A method's YAML lists them under ``_ladder_``, each rung the overrides that make it, in one text::

    _ladder_:
      - method.width=32 method.wavelets=16
      - method.width=128 method.wavelets=64

In a table's grid, ``wavelet_neural@ladder`` stands for the method in each of its rungs; ``prt select`` walks
them. No run knows of its ladder: it is no setting, and a change of it changes no run's name.
"""

from omegaconf import DictConfig, OmegaConf

from prt.bench import compose
from prt.errors import PrtError

#: what stands for all rungs, behind a method's name
MARK = "@ladder"


def rungs_of(cfg: DictConfig, method: str) -> list[str]:
    """The rungs in a configuration before it is finished; each a text of overrides.

    Raises:
        PrtError: for a method without a ladder, or one that is no list of overrides.
    """
    found = OmegaConf.select(cfg, "method._ladder_")
    if found is None:
        raise PrtError(
            f"conf/method/{method}.yaml has no _ladder_, its sizes; add one, or give the values of "
            "one setting, as over=method.width=32,64,128"
        )
    rungs = [str(rung) for rung in found] if OmegaConf.is_list(found) else []
    if not rungs or not all("=" in word for rung in rungs for word in rung.split()):
        raise PrtError(
            f"conf/method/{method}.yaml: _ladder_ must be a list of overrides, as [method.width=32]"
        )
    return rungs


def ladder_of(method: str, overrides: list[str]) -> list[str]:
    """The rungs of a method under these overrides (its YAML may make them depend on the budget)."""
    words = compose.with_companions([*overrides, f"method={method}"])
    with compose.reported(words):
        return rungs_of(compose.raw_compose(words), method)


def expand(values: list[str], overrides: list[str]) -> list[str]:
    """A grid's methods with ``name@ladder`` replaced by ``name`` in each of its rungs.

    Args:
        values: methods with their further overrides, as ``wavelet_neural@ladder method.seed=1``.
        overrides: of every run, as the budget.
    """
    found = []
    for value in values:
        first, *extra = value.split()
        if not first.endswith(MARK):
            found.append(value)
            continue
        name = first.removesuffix(MARK)
        found += [" ".join([name, rung, *extra]) for rung in ladder_of(name, overrides)]
    return found


def over(text: str) -> list[str]:
    """``task.order=1,2,3`` as the rungs of one setting.

    Raises:
        PrtError: for anything but a setting with its values.
    """
    key, equals, values = text.partition("=")
    listed = [value for value in values.split(",") if value]
    if not equals or not listed:
        raise PrtError(
            f"over={text!r}: give one setting and its values, smallest first, as over=task.order=1,2,3"
        )
    return [f"{key}={value}" for value in listed]

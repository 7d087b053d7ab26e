"""What tests of built-in scenes share: making one, and saying so where the data folder is missing."""

import os

import pytest
from hydra.errors import InstantiationException
from hydra.utils import instantiate

from prt.bench.compose import compose
from prt.errors import PrtError


def scene(name: str, *overrides: str):
    """A scene of ``conf/scene``; raises what its constructor raises."""
    try:
        return instantiate(compose([f"scene={name}", "budget=smoke", *overrides]).scene)
    except InstantiationException as error:
        raise error.__cause__ or error from None


def need_data() -> None:
    """Skip, saying so, where ``PRT_DATA`` is not set."""
    if not os.environ.get("PRT_DATA"):
        pytest.skip("PRT_DATA is not set: scenes made from its meshes are not tested")


def check_missing_data_is_named(name: str, folder, monkeypatch) -> None:
    """Loading without the data says in one line what is missing."""
    monkeypatch.setenv("PRT_DATA", str(folder))
    with pytest.raises(PrtError, match=f"{folder}/.*") as caught:
        scene(name).load()
    assert "\n" not in str(caught.value)
    monkeypatch.delenv("PRT_DATA")
    with pytest.raises(PrtError, match="PRT_DATA is not set"):
        scene(name).load()

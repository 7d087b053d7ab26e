"""Shared by all tests: this folder is importable (``tiny``), and a real task at a size that takes seconds."""

import os

import pytest
import tiny


@pytest.fixture(scope="session")
def maps(tmp_path_factory):
    """A folder of small environment maps."""
    return tiny.write_maps(tmp_path_factory.mktemp("maps"))


@pytest.fixture(scope="session")
def warm_cache(tmp_path_factory):
    """A cache of the session's own, shared by the tests that ask for it."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def module_lights(maps, tmp_path_factory):
    """Overrides that light with small maps; the cache is the module's own as long as this is in use."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PRT_CACHE", str(tmp_path_factory.mktemp("module_cache")))
        yield tiny.lights(maps)


@pytest.fixture
def own_cache(warm_cache, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(warm_cache))
    return warm_cache


@pytest.fixture(scope="session")
def tiny_task(maps, warm_cache):
    """``relight_indirect`` on ``cornell_glossy``, built as ``prt run`` builds it, its data made."""
    from prt.bench.compose import compose
    from prt.bench.run import build_task

    before = os.environ.get("PRT_CACHE")
    os.environ["PRT_CACHE"] = str(warm_cache)
    try:
        task = build_task(compose([*tiny.TASK, *tiny.lights(maps)]))
        task.training(), task.tests()
        yield task
    finally:
        os.environ.pop("PRT_CACHE", None)
        if before is not None:
            os.environ["PRT_CACHE"] = before

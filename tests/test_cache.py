import os
import stat
import subprocess
import sys
import warnings

import pytest
import torch

from prt.cache import cached, read_checked, settings_key, write_atomically, write_checked
from prt.errors import PrtError

SETTINGS = {"scene": "box", "size": [4, 4], "roughness": 0.1}


class Builder:
    """Counts its calls; what it builds differs from call to call, so a hit is seen in the content."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return {"weight": torch.arange(64.0).reshape(8, 8) + self.calls, "index": torch.arange(5)}


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def the_file(folder):
    (path,) = (folder / "kind").iterdir()  # and so no temporary file is left beside it
    return path


def test_second_call_comes_from_the_file(folder):
    build = Builder()
    first, second = (cached("kind", 1, SETTINGS, build) for _ in range(2))
    assert build.calls == 1
    assert first.keys() == second.keys()
    for name in first:
        assert torch.equal(first[name], second[name]) and first[name].dtype == second[name].dtype
    assert the_file(folder).suffix == ".safetensors"


def test_key_ignores_order_and_follows_content_and_version(folder):
    assert settings_key({"a": 1, "b": [1, 2]}) == settings_key({"b": [1, 2], "a": 1})
    assert settings_key({"a": 1, "b": [1, 2]}) != settings_key({"a": 1, "b": [2, 1]})
    build = Builder()
    cached("kind", 1, SETTINGS, build)
    cached("kind", 2, SETTINGS, build)
    cached("kind", 2, {**SETTINGS, "roughness": 0.2}, build)
    assert build.calls == 3


@pytest.mark.parametrize("keep", [0, 10, 31, 32, 100, -1])
def test_truncated_file_is_named_and_rebuilt(folder, keep):
    build = Builder()
    cached("kind", 1, SETTINGS, build)
    path = the_file(folder)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.warns(UserWarning, match=path.name):
        rebuilt = cached("kind", 1, SETTINGS, build)
    assert build.calls == 2
    assert torch.equal(rebuilt["weight"], torch.arange(64.0).reshape(8, 8) + 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.equal(cached("kind", 1, SETTINGS, build)["weight"], rebuilt["weight"])
    assert build.calls == 2


def test_any_flipped_bit_is_noticed(folder):
    build = Builder()
    cached("kind", 1, SETTINGS, build)
    path = the_file(folder)
    whole = path.read_bytes()
    places = torch.randperm(len(whole), generator=torch.Generator().manual_seed(0))[:40].tolist()
    for place in [0, 31, 32, len(whole) - 1, *places]:  # checksum, header and data
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        with pytest.warns(UserWarning, match="damaged"):
            assert read_checked(path) is None
    path.write_bytes(whole)
    assert read_checked(path) is not None


def test_tensors_that_share_memory_are_kept(folder):
    base = torch.arange(12.0).reshape(4, 3)
    content = {"whole": base, "row": base[1], "turned": base.T}
    cached("kind", 1, {}, lambda: content)
    found = cached("kind", 1, {}, lambda: pytest.fail("built again"))
    assert all(torch.equal(found[name], value) for name, value in content.items())


def test_a_build_that_fails_leaves_nothing(folder):
    def build():
        raise RuntimeError("no")

    with pytest.raises(RuntimeError):
        cached("kind", 1, SETTINGS, build)
    assert list((folder / "kind").iterdir()) == []


def test_a_write_that_fails_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "file.safetensors"
    write_checked(path, {"x": torch.ones(3)})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(PrtError, match="No space left on device"):
        write_checked(path, {"x": torch.zeros(3)})
    assert torch.equal(read_checked(path)["x"], torch.ones(3))
    assert list(tmp_path.iterdir()) == [path]


def test_folder_below_a_file_is_an_error_before_building(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "file"))
    build = Builder()
    with pytest.raises(PrtError) as caught:
        cached("kind", 1, SETTINGS, build)
    message = str(caught.value)
    assert build.calls == 0
    assert "\n" not in message and str(tmp_path / "file") in message and "PRT_CACHE" in message


def test_folder_that_even_root_cannot_write_is_an_error_before_building(monkeypatch):
    monkeypatch.setenv("PRT_CACHE", "/proc/prt-cache")
    build = Builder()
    with pytest.raises(PrtError, match="/proc/prt-cache"):
        cached("kind", 1, SETTINGS, build)
    assert build.calls == 0


def test_unreadable_entry_is_an_error(tmp_path):
    with pytest.raises(PrtError, match="cannot read"):
        read_checked(tmp_path)  # a folder where a file should be


def test_files_have_the_users_usual_permissions(tmp_path):
    usual = tmp_path / "usual"
    usual.write_bytes(b"")
    write_atomically(tmp_path / "ours", b"x")
    assert stat.S_IMODE((tmp_path / "ours").stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)


# Each process reads and writes the same three entries over and over; every entry's content follows from its
# key, so a half-written or mixed file shows. Half of the time the entry is removed, so that writes go on.
WORKER = """
import sys, random, warnings
from pathlib import Path
import torch
from prt.cache import cached, cache_folder
warnings.simplefilter("error")
draw = random.Random(int(sys.argv[1]))
for _ in range(120):
    n = draw.randrange(3)
    found = cached("shared", 1, {"n": n}, lambda: {"x": torch.full((20000,), float(n))})
    assert found["x"].shape == (20000,) and bool((found["x"] == n).all()), found
    if draw.random() < 0.5:
        for path in cache_folder().joinpath("shared").glob("*.safetensors"):
            path.unlink(missing_ok=True)
"""


def test_two_processes_share_one_cache(folder):
    workers = [
        subprocess.Popen([sys.executable, "-c", WORKER, str(seed)], stderr=subprocess.PIPE, text=True)
        for seed in range(2)
    ]
    for worker in workers:
        _, errors = worker.communicate(timeout=120)
        assert worker.returncode == 0, errors
    assert not [path for path in (folder / "shared").iterdir() if path.suffix != ".safetensors"]


# Builds slowly, and leaves a file for every time that it does.
BUILDER = """
import os, time
import torch
from prt.cache import cached, cache_folder
def build():
    time.sleep(1.0)
    cache_folder().joinpath(f"built_by_{os.getpid()}").touch()
    return {"x": torch.ones(3)}
assert cached("slow", 1, {}, build)["x"].sum() == 3
"""


def test_what_several_processes_want_is_built_once(folder):
    workers = [
        subprocess.Popen([sys.executable, "-c", BUILDER], stderr=subprocess.PIPE, text=True) for _ in range(3)
    ]
    for worker in workers:
        _, errors = worker.communicate(timeout=120)
        assert worker.returncode == 0, errors
    assert len(list(folder.glob("built_by_*"))) == 1
    assert [path.suffix for path in (folder / "slow").iterdir()] == [".safetensors"]


def test_a_builder_that_was_killed_holds_up_nobody(folder):
    code = BUILDER.replace("time.sleep(1.0)", "print('building', flush=True); time.sleep(60)")
    victim = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert victim.stdout.readline() == "building\n"
    victim.kill()
    victim.wait()
    assert cached("slow", 1, {}, lambda: {"x": torch.ones(3)})["x"].sum() == 3
    assert [path.suffix for path in (folder / "slow").iterdir()] == [".safetensors"]

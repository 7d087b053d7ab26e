import multiprocessing
import random
import time

import pandas as pd
import pytest
import torch
from fakes import CHOICE, run_child, write_conf

from prt.bench.compose import compose
from prt.bench.exr import read_exr
from prt.bench.fit_log import RunLog, pack, unpack
from prt.bench.run import folder_of
from prt.bench.run_folder import RunFolder
from prt.errors import PrtError

STEPS, ITEMS, SLEEP = 60, 8, 0.01
SETTINGS = [*CHOICE, f"method.steps={STEPS}", f"method.sleep={SLEEP}", f"task.items={ITEMS}",
            "run.checkpoint_seconds=0.08"]  # fmt: skip


def start(overrides, conf):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["prt.bench.run", "fakes", "OpenEXR", "torch._dynamo"])
    process = context.Process(target=run_child, args=(overrides, conf))
    process.start()
    return process


def progress(folder: RunFolder) -> int:
    """Steps fitted plus items judged."""
    steps = len(folder.log_file.read_text().splitlines()) - 1 if folder.log_file.exists() else 0
    return steps + len({row[:3] for row in folder.metric_rows()})


def without_seconds(folder: RunFolder) -> pd.DataFrame:
    return folder.log().drop(columns="seconds")


def test_a_run_killed_at_random_points_ends_with_the_same_numbers(tmp_path, monkeypatch):
    conf = str(write_conf(tmp_path / "conf"))
    monkeypatch.setenv("PRT_CONF_DIRS", conf)
    choices = {name: [*SETTINGS, f"run.folder={tmp_path / name}"] for name in ("whole", "killed")}
    whole, killed = (folder_of(compose(choices[name])) for name in ("whole", "killed"))
    process = start(choices["whole"], conf)
    process.join(120)
    assert process.exitcode == 0 and whole.done

    rng, points, kills = random.Random(5), [], 0
    points = sorted(rng.sample(range(1, STEPS), 5)) + sorted(rng.sample(range(STEPS + 1, STEPS + ITEMS), 2))
    for point in points:
        process = start(choices["killed"], conf)
        end = time.monotonic() + 60
        while process.is_alive() and progress(killed) < point and time.monotonic() < end:
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.02))
        kills += process.is_alive()
        process.kill()
        process.join()
    assert kills >= 4, "the runs ended before they could be killed: the test tests nothing"
    process = start(choices["killed"], conf)
    process.join(120)
    assert process.exitcode == 0 and killed.done

    assert killed.metric_rows() == whole.metric_rows()
    pd.testing.assert_frame_equal(without_seconds(killed), without_seconds(whole))
    assert killed.checkpoint.read_bytes() == whole.checkpoint.read_bytes()
    for path in sorted((whole.path / "images").rglob("*.exr")):
        assert torch.equal(read_exr(path), read_exr(killed.path / path.relative_to(whole.path)))
    assert STEPS * SLEEP <= killed.timing()["fit"] < 10 * whole.timing()["fit"]
    assert len(killed.provenance()["sessions"]) == len(points) + 1


def state_at(step: int) -> dict:
    parameter = torch.nn.Parameter(torch.full((3,), float(step)))
    optimiser = torch.optim.Adam([parameter], betas=(0.8, 0.9))
    parameter.sum().backward()
    optimiser.step()
    rng = torch.Generator().manual_seed(step).get_state()
    return {"net": {"a/b": parameter}, "optimiser": optimiser.state_dict(), "generator": rng,
            "note": "x", "rate": 0.1, "none": None, "flag": True, "1": 2, 1: 3}  # fmt: skip


def same(a, b) -> bool:
    if isinstance(a, torch.Tensor):
        return isinstance(b, torch.Tensor) and a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def test_a_state_comes_back_as_it_was_kept():
    state = state_at(3)
    assert same(unpack(pack(state)), state)
    with pytest.raises(TypeError, match="cannot keep a set"):
        pack({"bad": {1, 2}})


def fitted(folder: RunFolder, steps: int) -> None:
    with RunLog(folder, 0.0) as log:
        first, _ = log.resume() or (0, None)
        log.start(9, "test")
        for step in range(first + 1, steps + 1):
            log.step(step, loss=1.0 / step)
            log.save(step, state_at(step))


@pytest.mark.parametrize("damage", ["truncate", "flip", "empty", "gone"])
def test_a_damaged_state_falls_back_to_the_one_before(tmp_path, damage):
    folder = RunFolder(tmp_path)
    fitted(folder, 5)
    current = tmp_path / "state" / "current.safetensors"
    blob = current.read_bytes()
    if damage == "gone":  # killed between the two renames
        current.unlink()
    else:
        flipped = blob[:100] + bytes([blob[100] ^ 4]) + blob[101:]
        current.write_bytes({"truncate": blob[:-7], "flip": flipped, "empty": b""}[damage])
    with RunLog(folder, 0.0) as log:
        if damage == "gone":
            kept = log.resume()
        else:
            with pytest.warns(UserWarning, match="current.safetensors is damaged"):
                kept = log.resume()
    assert kept[0] == 4 and same(kept[1], state_at(4))
    assert list(folder.log().step) == [1, 2, 3, 4]


def test_rows_after_the_state_and_a_row_cut_short_are_dropped(tmp_path):
    folder = RunFolder(tmp_path)
    fitted(folder, 3)
    with folder.log_file.open("a") as file:
        file.write("4,0.1,0.25\n5,0.")
    fitted(folder, 6)
    assert list(folder.log().step) == [1, 2, 3, 4, 5, 6]
    assert list(folder.log().loss) == [1.0 / step for step in range(1, 7)]


def test_without_a_state_the_fit_starts_over(tmp_path):
    folder = RunFolder(tmp_path)
    folder.log_file.write_text("step,seconds,loss\n1,0.1,9.0\n")
    with RunLog(folder) as log:
        assert log.resume() is None
    assert len(folder.log()) == 0


def test_infinity_stops_the_fit(tmp_path):
    with RunLog(RunFolder(tmp_path)) as log:
        log.start(3, "test")
        with pytest.raises(PrtError, match="loss became infinite at step 2, last good checkpoint: none yet"):
            log.step(1, loss=1.0)
            log.step(2, loss=float("inf"))

"""What a launcher is asked to do, before and around its engine: settings, plans, waves, outcomes, cost."""

import json

import feigned_slurm
import pytest
from fakes import CHOICE, FakeMethod, write_conf
from hydra.plugins.launcher import Launcher

from prt.bench import compose, launch, launchers
from prt.bench.cost import Cost
from prt.bench.spec import load_spec


@pytest.fixture(autouse=True)
def own_conf(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRT_CONF_DIRS", str(write_conf(tmp_path / "conf")))


def settings_of(*words: str) -> launchers.Settings:
    return launchers.master([*CHOICE, *words])[2]


def test_a_launcher_is_no_part_of_a_run():
    words = ["launcher.threads=3"]
    assert compose.compose([*CHOICE, *words]) == compose.compose(CHOICE)
    assert "launcher" not in compose.compose(CHOICE)
    with_launcher = load_spec("quickstart", ["launcher=slurm", "launcher.gpus=1", "budget=smoke"])
    without = load_spec("quickstart", ["budget=smoke"])
    assert with_launcher.launcher == ["launcher=slurm", "launcher.gpus=1"]
    assert (with_launcher.report, with_launcher.common, with_launcher.command) == (
        without.report, without.common, without.command,
    )  # fmt: skip


def test_auto_shares_this_machines_cores(monkeypatch):
    monkeypatch.setattr(launchers, "cores", lambda: 8)
    assert settings_of().here and settings_of().gpu is None
    assert settings_of("launcher=local").workers == 8
    assert settings_of("launcher=local", "launcher.threads=3").workers == 2
    assert settings_of("launcher=local", "launcher.threads=16").workers == 1


def test_device_auto_means_that_of_the_workers(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(feigned_slurm.write(tmp_path / "bin")))
    words = [text for text in CHOICE if not text.startswith("device")]
    for gpus, device in ((0, "cpu"), (1, "cuda")):
        settings = settings_of("launcher=slurm", f"launcher.gpus={gpus}")
        planned = launch.plan([*words, "device=auto"], settings)
        assert planned.cfg.device == device and planned.words[-1] == f"device={device}"


def test_runs_that_share_a_fit_wait_for_the_first(monkeypatch):
    monkeypatch.setattr(FakeMethod, "rendering", frozenset({"shape"}), raising=False)
    overrides = [[f"seed={seed}", f"+method.shape={shape}"] for seed in (0, 1) for shape in (3, 2, 1)]
    plans = [launch.plan([*CHOICE, *words], settings_of()) for words in overrides]
    first, later = launch.waves_of(plans)
    assert first == [plans[0], plans[3]] and later == [p for p in plans if p not in first]
    monkeypatch.delattr(FakeMethod, "rendering")
    assert launch.waves_of(plans) == [plans]


class Fragile(Launcher):
    """A plug-in that no engine of ours knows: does the first run of a batch, then loses its pool."""

    def __init__(self, job):
        self.job = job

    def setup(self, **_):
        pass

    def launch(self, job_overrides, initial_job_idx):
        from prt.bench.run import run

        run(compose.compose(job_overrides[0]))
        raise RuntimeError("the pool broke")


def test_a_plug_in_that_loses_everything_is_judged_by_the_folders(capsys):
    settings = launchers.Settings("joblib", here=False, workers=2, threads=None, gpus=None)
    plans = [launch.plan([*CHOICE, f"seed={seed}"], settings) for seed in (0, 1, 1)]
    cost, told = Cost(), []
    found = launch.deliver(Fragile(None), settings, plans, cost, lambda plan, outcome: told.append(outcome))
    assert found[0].reason == "" and "the pool broke" in found[1].reason and found[1] == found[2]
    assert (cost.done, cost.failed, len(told)) == (1, 1, 2)


def test_cost_counts_this_call_alone(tmp_path):
    cost = Cost("ray", workers=4, before=2)
    cost.add({"fit": 60.0, "bake": 5.0, "evaluate": 15.0}, failed=False)
    cost.add({}, failed=True)
    cost.wall = 40.0
    assert cost.text() == (
        "cost: 1 done, 1 failed, 2 done before in 40 s; machine time 1 min 20 s (fits 1 min 00 s, data 5 s, "
        "the rest 15 s); speed-up 2 with 4 workers (launcher=ray)"
    )
    cost.keep(tmp_path / "cost.json")
    cost.keep(tmp_path / "cost.json")
    calls = json.loads((tmp_path / "cost.json").read_text())
    assert len(calls) == 2 and calls[0]["speedup"] == 2.0 and calls[0]["workers"] == 4

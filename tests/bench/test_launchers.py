"""Sweeps and tables on other engines: Ray, processes of submitit, a feigned Slurm; and workers that die."""

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import feigned_slurm
import pytest
import torch
from fakes import CHOICE, write_conf

from prt import cli
from prt.bench import launchers
from prt.bench.exr import read_exr
from prt.bench.run_folder import find_runs
from prt.bench.spec import load_spec

HERE = Path(__file__).parent
RAY = pytest.param("ray", marks=pytest.mark.skipif(
    not all(map(launchers.importable, launchers.RAY)), reason="Ray is missing: pip install 'prt[ray]'"
))  # fmt: skip
needs_submitit = pytest.mark.skipif(
    not all(map(launchers.importable, launchers.SUBMITIT)), reason="pip install 'prt[submitit]'"
)
ENGINES = [RAY, pytest.param("local", marks=needs_submitit)]
MORTAL = (
    "{_target_: fakes.MortalMethod, marker: '', dies_at: 25, steps: 40, width: 8, rate: 0.01, sleep: 0.0}"
)
TABLE = """
title: Two methods, one of them mortal
grid: {{scene: [fake], method: [mortal, fake]}}
common: {common}
settings: {{mortal: ["method.marker={marker}"]}}
columns: {{metrics: [psnr]}}
"""


@pytest.fixture(autouse=True)
def prt(monkeypatch, tmp_path, capsys):
    """``prt ...`` in this process and a folder of its own: exit status, output, complaints."""
    monkeypatch.chdir(tmp_path)
    conf = write_conf(tmp_path / "conf")
    (conf / "method" / "mortal.yaml").write_text(MORTAL)
    monkeypatch.setenv("PRT_CONF_DIRS", str(conf))
    monkeypatch.setenv("PYTHONPATH", str(HERE))  # workers find the fakes
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "scalar_rgb")  # and do not prepare a renderer for them
    before = signal.getsignal(signal.SIGTERM), warnings.showwarning, torch.get_num_threads()

    def call(*arguments):
        status = cli.main([str(a) for a in arguments])
        assert signal.getsignal(signal.SIGTERM) is cli.stop, "an engine kept its own handler"
        done = capsys.readouterr()
        return status, done.out, done.err

    yield call
    signal.signal(signal.SIGTERM, before[0])
    warnings.showwarning = before[1]
    torch.set_num_threads(before[2])


def contents(folder) -> list:
    """All that must be equal wherever runs are carried out: everything but times and machines."""
    return [
        (
            run.path.parts[-4:],
            run.metric_rows(),
            run.checkpoint.read_bytes(),
            run.log().drop(columns="seconds").to_csv(),
            [(p.name, read_exr(p).tolist()) for p in sorted(run.path.rglob("*.exr"))],
        )
        for run in find_runs(folder)
    ]


# ---- real engines


@pytest.mark.parametrize("launcher", ENGINES)
def test_runs_are_the_same_whatever_carries_them_out(prt, launcher):
    sweep = ["run", "-m", *CHOICE, "scene=fake,fake2", "launcher.threads=1"]
    assert prt(*sweep, "run.folder=here")[0] == 0
    away = [f"launcher={launcher}", "launcher.workers=2", "run.folder=away"]
    status, out, err = prt(*sweep, *away)
    assert status == 0, err
    assert contents("here") == contents("away") and len(contents("here")) == 2
    assert out.count("psnr indirect, far:") == 2
    assert "cost: 2 done in" in err and f"with 2 workers (launcher={launcher})" in err
    for run in find_runs("away"):
        assert run.timing()["threads"] == 1 and run.provenance()["command"] == sys.argv
    (kept,) = Path("away").glob(".sweeps/*/cost.json")
    (call,) = json.loads(kept.read_text())
    assert (call["done"], call["failed"], call["workers"], call["launcher"]) == (2, 0, 2, launcher)
    assert call["fit"] > 0 and call["wall"] > 0
    status, out, err = prt(*sweep, *away)  # nothing is left to do, and no engine is started for it
    assert status == 0 and err.count("done already") == 2 and "cost:" not in err


@pytest.mark.parametrize("launcher", ENGINES)
def test_a_killed_worker_costs_its_last_steps_and_nothing_else(prt, tmp_path, launcher):
    common = [text for text in CHOICE if not text.startswith(("scene", "method"))]
    common += ["run.checkpoint_seconds=0", f"run.folder={tmp_path / 'runs'}"]
    Path("experiments").mkdir()
    text = TABLE.format(common=json.dumps(common), marker=tmp_path / "was_killed")
    Path("experiments/mortal.yaml").write_text(text)
    table = ["table", "mortal", "launcher.threads=1"]

    status, _, err = prt(*table, f"launcher={launcher}", "launcher.workers=2")
    assert status == 1, err
    assert "fake mortal seed 0: failed: its worker died before the run ended" in err
    assert "the same command resumes it" in err and "fake fake seed 0: done" in err
    assert "cost: 1 done, 1 failed in" in err
    assert "its worker died" in Path("reports/mortal/report.md").read_text()
    alive, dead = find_runs("runs")
    assert (alive.state(), dead.state()) == ("done", "stopped")
    assert (dead.path / "state" / "current.safetensors").exists()

    status, out, err = prt(*table)
    assert status == 0 and "2 runs: 1 done already, 1 to run" in err and "resume: " in err, err
    assert len(dead.provenance()["sessions"]) == 2 and "cost: 1 done, 1 done before" in err
    calls = json.loads(Path("reports/mortal/cost.json").read_text())
    assert [call["launcher"] for call in calls] == [launcher, "basic"]
    # 24 of 40 steps were kept: the marker is there now, and the same fit goes through without a stop
    assert prt(*table, "run.folder=uninterrupted", "report=elsewhere")[0] == 0
    assert contents("runs") == contents("uninterrupted")
    assert load_spec("mortal", ["launcher=ray", "launcher.workers=2"]).command == "prt table mortal"


@needs_submitit
def test_an_interrupted_sweep_leaves_no_process_behind(tmp_path):
    overrides = [*CHOICE, "scene=fake,fake2", "method.steps=10000", "method.sleep=0.05"]
    command = [sys.executable, "-m", "prt.cli", "run", "-m", *overrides, "run.checkpoint_seconds=0.1",
               "launcher=local", "launcher.workers=2"]  # fmt: skip
    sweep = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while len(list(tmp_path.glob("runs/**/current.safetensors"))) < 2 and time.monotonic() < end:
        time.sleep(0.05)
    sweep.send_signal(signal.SIGTERM)
    _, err = sweep.communicate(timeout=60)
    assert sweep.returncode == 130 and "the same command resumes where it stopped" in err
    while [run.state() for run in find_runs("runs")] != ["stopped"] * 2 and time.monotonic() < end:
        time.sleep(0.05)
    assert [run.state() for run in find_runs("runs")] == ["stopped"] * 2


@needs_submitit
def test_slurm_gets_an_array_with_the_launchers_settings(prt, tmp_path, monkeypatch):
    commands = feigned_slurm.write(tmp_path / "bin")
    monkeypatch.setenv("PATH", f"{commands}{os.pathsep}{os.environ['PATH']}")
    settings = ["launcher=slurm", "launcher.partition=long", "launcher.threads=3", "launcher.minutes=90"]
    settings += ["launcher.workers=1", "launcher.memory_gb=7", "+launcher.options.mail-type=END"]
    sweep = ["run", "-m", *CHOICE, "scene=fake,fake2", *settings]
    status, _, err = prt(*sweep, "launcher.partition=nowhere")
    refusal = "prt: error: sbatch: error: invalid partition specified: nowhere"
    assert status == 2 and err.splitlines()[-1] == refusal
    status, _, err = prt(*sweep)
    assert status == 0, err + "".join(p.read_text() for p in commands.glob("*.log"))
    assert [run.state() for run in find_runs("runs")] == ["done", "done"]
    assert {run.timing()["threads"] for run in find_runs("runs")} == {3}
    script = (commands / "submitted.sh").read_text()
    for option in ("partition=long", "cpus-per-task=3", "time=90", "mem=7GB", "array=0-1%1", "mail-type=END"):
        assert f"#SBATCH --{option}" in script, script
    assert "gpus-per-node=0" not in script


def test_threads_are_kept_to_by_everything_that_computes():
    code = (
        "from prt.bench.launch import limit_threads; limit_threads(1); import torch, drjit, os;"
        "print(torch.get_num_threads(), drjit.thread_count(), os.environ['OMP_NUM_THREADS'])"
    )
    environment = {**os.environ, "PRT_MITSUBA_VARIANT": "auto", "OMP_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.split()[0::2] == ["1", "1"], done.stderr
    assert torch.cuda.is_available() or done.stdout.split()[1] == "1"


# ---- mistakes


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["launcher=rey"],
            "launcher=rey does not exist; did you mean ray?; choose from basic, local, ray, slurm",
        ),
        (["launcher.thread=2"], "unknown setting 'launcher.thread'; did you mean launcher.threads"),
        (["launcher.threads=0"], "launcher.threads=0 must be an integer of at least 1, or null"),
        (["+launcher.speed=2"], "+launcher.speed: nothing reads this setting"),
        (
            ["launcher=local", "launcher.workers=many"],
            "launcher.workers='many' must be an integer of at least 1",
        ),
        (["launcher=local", "launcher.gpus=-1"], "launcher.gpus=-1 must be a number of at least 0"),
        (["launcher=ray", "launcher.address=auto", "launcher.workers=2"], "workers=2 with a running cluster"),
        (["launcher=local", "launcher.gpus=0", "device=cuda"], "the launcher gives a run no GPU"),
        (
            ["launcher=slurm"],
            "there is no sbatch here; call prt where Slurm takes jobs, or take launcher=local",
        ),
    ],
)
def test_mistakes_are_one_line_before_anything_runs(prt, words, message):
    status, _, err = prt("run", "-m", *CHOICE, *words)
    assert status == 2 and message in err and err.startswith("prt: error: ") and err.count("\n") == 1, err
    assert find_runs("runs") == []


@pytest.mark.parametrize(
    ("launcher", "extra"), [("ray", "ray"), ("local", "submitit"), ("slurm", "submitit")]
)
@pytest.mark.parametrize("command", [["run", "-m"], ["table", "quickstart"]])
def test_a_missing_plug_in_names_what_to_install(prt, monkeypatch, launcher, extra, command):
    monkeypatch.setattr(launchers.importlib.util, "find_spec", lambda name: None)
    status, _, err = prt(*command, f"launcher={launcher}")
    assert status == 2 and f"pip install 'prt[{extra}]'" in err and err.count("\n") == 1
    assert f"launcher={launcher} needs hydra-{extra}-launcher, which is not installed" in err


def test_a_single_run_takes_no_launcher(prt):
    status, _, err = prt("run", *CHOICE, "launcher=ray")
    assert status == 2 and "launcher=ray: a launcher carries out sweeps; add -m" in err

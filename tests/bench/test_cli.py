import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fakes import CHOICE, write_conf

from prt import cli
from prt.bench.run_folder import find_runs

HERE = Path(__file__).parent


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Arguments that choose the fakes, in a conf folder of the user's own."""
    monkeypatch.delenv("PRT_CONF_DIRS", raising=False)
    yield ["--conf-dir", str(write_conf(tmp_path / "conf")), *CHOICE, f"run.folder={tmp_path / 'runs'}"]
    os.environ.pop("PRT_CONF_DIRS", None)


@pytest.fixture(autouse=True)
def handlers():
    """The command replaces signal and warning handlers of its process."""
    import warnings

    before = signal.getsignal(signal.SIGTERM), warnings.showwarning
    yield
    signal.signal(signal.SIGTERM, before[0])
    warnings.showwarning = before[1]


def test_help_reads_well(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["prt", "run", "--help"])
    with pytest.raises(SystemExit) as caught:
        cli.main(["run", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "budget=   gpu, laptop, paper, smoke" in text and "examples:" in text
    for command in ("table", "status", "score", "doctor"):
        with pytest.raises(SystemExit):
            cli.main([command, "--help"])
        assert "examples:" in capsys.readouterr().out
    assert cli.main([]) == 0
    assert "prt doctor" in capsys.readouterr().out


def test_run_prints_its_folder_and_numbers(own, capsys, tmp_path):
    assert cli.main(["run", *own]) == 0
    out = capsys.readouterr().out
    assert str(tmp_path / "runs" / "fake" / "fake" / "fake") in out
    assert "psnr indirect, far:" in out
    assert cli.main(["status", "--folder", str(tmp_path / "runs")]) == 0
    assert "1 done" in capsys.readouterr().out
    assert cli.main(["score", str(tmp_path / "runs")]) == 0


def test_show_prints_the_configuration_and_runs_nothing(own, capsys, tmp_path):
    assert cli.main(["run", "--show", *own]) == 0
    out = capsys.readouterr().out
    assert "_target_: fakes.FakeMethod" in out and "# run folder:" in out
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "method.widht=3"], "did you mean method.width"),
        (["run", "--bla"], "unknown option '--bla'"),
        (["runn"], "invalid choice: 'runn'"),
        (["status", "--folder", "nowhere"], "nowhere does not exist"),
        (["score", "nowhere"], "no runs in nowhere"),
    ],
)
def test_mistakes_are_one_line_and_status_2(own, capsys, arguments, message):
    extra = own if arguments[0] == "run" else []
    assert cli.main([arguments[0], *extra, *arguments[1:]]) == 2
    error = capsys.readouterr().err
    assert error.startswith("prt: error: ") and message in error and error.count("\n") == 1


def test_a_bug_is_one_line_and_status_1(own, capsys):
    assert cli.main(["run", *own, "method.fail=out of luck"]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("prt: error: RuntimeError: out of luck; this is a bug")


def test_a_sweep_runs_every_combination_and_goes_on_after_a_failure(own, tmp_path):
    command = [
        sys.executable,
        "-m",
        "prt.cli",
        "run",
        "-m",
        *own,
        "scene=fake,fake2",
        "method.fail=no luck,''",
    ]
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env=environment, cwd=tmp_path
    )
    states = sorted((run.path.parts[-3], run.state()) for run in find_runs(tmp_path / "runs"))
    assert states == [("fake", "done"), ("fake", "failed"), ("fake2", "done"), ("fake2", "failed")], (
        result.stderr
    )
    assert result.returncode == 2
    assert "no luck" in result.stderr and "some runs of the sweep failed" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_misspelt_key_stops_a_sweep_before_anything_runs(own, capsys, tmp_path):
    assert cli.main(["run", "-m", *own, "scene=fake,fake2", "method.widht=1,2"]) == 2
    assert "unknown setting 'method.widht'" in capsys.readouterr().err
    assert find_runs(tmp_path / "runs") == []


def test_an_interruption_says_how_to_resume(own, tmp_path):
    command = [sys.executable, "-m", "prt.cli", "run", *own, "method.sleep=0.05", "method.steps=1000"]
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path,
        # where the tests run in the background the signal is ignored, and a child inherits that
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    end = time.monotonic() + 60
    while not list(tmp_path.glob("runs/**/log.csv")) and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command resumes where it stopped: prt run" in error
    (run,) = find_runs(tmp_path / "runs")
    assert run.state() == "stopped"


def test_a_schedulers_request_to_end_is_an_interruption(own, monkeypatch, capsys):
    def killed(options):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)

    monkeypatch.setitem(cli.COMMANDS, "run", killed)
    assert cli.main(["run", *own]) == 130
    assert "the same command resumes" in capsys.readouterr().err

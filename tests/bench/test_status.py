from omegaconf import OmegaConf

from prt.bench import status
from prt.bench.run_folder import RunFolder, locked


def make(root, method, *files, log=None):
    folder = RunFolder(root / "fake" / "fake" / method / "0123456789")
    folder.path.mkdir(parents=True)
    choice = {"task": "fake", "scene": "fake", "method": method, "budget": "smoke"}
    OmegaConf.save({"choice": choice}, folder.path / "config.yaml")
    for name in files:
        (folder.path / name).write_text("the disk was full\n")
    if log:
        folder.log_file.write_text(log)
    return folder


def test_states_are_read_from_the_files(tmp_path, capsys):
    make(tmp_path, "a", "DONE", log="step,seconds,loss\n40,1.0,0.5\n")
    make(tmp_path, "b", "FAILED")
    make(tmp_path, "c", log="step,seconds,loss\n12,1.0,0.5\n")
    running = make(tmp_path, "d", "checkpoint.safetensors")
    with running.lock():
        assert locked(running.path / "lock")
        assert status.main(tmp_path) == 0
    assert not locked(running.path / "lock")
    out = capsys.readouterr().out.splitlines()
    assert "1 running, 1 failed, 1 stopped, 1 done" in out
    lines = {line.split()[0]: line for line in out[1:5]}
    assert lines["done"].split()[3] == "a" and " 40 " in lines["done"]
    assert "the disk was full" in lines["failed"]
    assert " 12 " in lines["stopped"] and "fitting" in lines["stopped"]
    assert "fitted, 0 test images judged" in lines["running"]
    assert running.state() == "stopped"


def test_a_folder_further_down_and_an_empty_one(tmp_path, capsys):
    make(tmp_path, "a", "DONE")
    assert status.main(tmp_path / "fake" / "fake") == 0
    assert "1 done" in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert status.main(tmp_path / "empty") == 0
    assert "no runs in" in capsys.readouterr().out

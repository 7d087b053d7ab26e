import dataclasses
import json
import subprocess

import fakes
import pandas as pd
import pytest
import torch
from fakes import CHOICE, write_conf

from prt.bench import provenance, score
from prt.bench.compose import compose
from prt.bench.run import build_task, fitted, folder_of, run
from prt.bench.run_folder import METRIC_COLUMNS, RunFolder, find_runs
from prt.errors import PrtError

#: what the fake task's error split reports, under its own names
SPLIT = ("psnr/truncation", "negative/share")


@pytest.fixture
def choice(tmp_path, monkeypatch):
    """Overrides that choose the fakes and a run folder of this test."""
    monkeypatch.setenv("PRT_CONF_DIRS", str(write_conf(tmp_path / "conf")))
    return [*CHOICE, f"run.folder={tmp_path / 'runs'}"]


def test_a_run_leaves_every_file(choice, tmp_path):
    folder = run(compose(choice))
    assert folder.path.parent == tmp_path / "runs" / "fake" / "fake" / "fake"
    assert folder.state() == "done"
    names = {path.name for path in folder.path.iterdir()}
    assert names == {
        "config.yaml", "provenance.json", "log.csv", "checkpoint.safetensors", "checkpoint.sha256", "images",
        "metrics.csv", "timing.json", "DONE",
    }  # fmt: skip
    metrics = folder.metrics()
    assert tuple(metrics.columns) == METRIC_COLUMNS
    assert len(metrics[metrics.metric == "psnr"]) == 4 * 2  # items times components
    assert set(metrics.metric) == {"psnr", "mae", "bad_pixels", "noise_floor", *SPLIT}
    assert len(folder.log()) == 40
    timing = folder.timing()
    assert timing["bytes"] == (8 + 8 + 8 + 1) * 4
    assert timing["shade"]["repetitions"] >= 30
    assert folder.provenance()["seed"] == 0
    assert folder.config().choice.method == "fake"


def test_a_finished_run_is_skipped_and_not_touched(choice, capsys):
    folder = run(compose(choice))
    before = {path: path.stat().st_mtime_ns for path in folder.path.rglob("*")}
    assert run(compose(choice)).path == folder.path
    assert "done already" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in folder.path.rglob("*")} == before


def test_the_hash_follows_results_not_storage(choice):
    place = folder_of(compose(choice)).path.name
    assert (
        folder_of(compose([*choice, "run.checkpoint_seconds=1", "run.images.save=false"])).path.name == place
    )
    for change in ("seed=1", "method.width=9", "budget=laptop", "run.denoise=true"):
        assert folder_of(compose([*choice, change])).path.name != place


def test_a_failure_is_kept_with_its_reason_and_tried_again(choice):
    cfg = compose([*choice, "method.fail=out of luck"])
    with pytest.raises(RuntimeError):
        run(cfg)
    folder = folder_of(cfg)
    assert folder.state() == "failed"
    assert folder.failure() == "RuntimeError: out of luck"
    assert "Traceback" in (folder.path / "traceback.txt").read_text()
    assert not (folder.path / "lock").exists()
    with pytest.raises(RuntimeError):
        run(cfg)


def test_nan_stops_the_run_and_keeps_the_last_good_state(choice):
    cfg = compose([*choice, "method.nan_at=25", "run.checkpoint_seconds=0"])
    with pytest.raises(PrtError, match="loss became NaN at step 25, last good checkpoint: step 24"):
        run(cfg)
    folder = folder_of(cfg)
    assert "NaN at step 25" in folder.failure()
    assert (folder.path / "state" / "current.safetensors").exists()
    assert list(folder.log().step) == list(range(1, 25))
    with pytest.raises(PrtError, match="NaN at step 25"):  # tried again, from step 24
        run(cfg)


def test_data_preparation_is_not_fitting_time(choice):
    folder = run(compose([*choice, "task.bake_seconds=0.5"]))
    timing = folder.timing()
    assert timing["bake"] >= 0.5
    assert timing["fit"] < 0.4


def timed(choice, monkeypatch, parts, **attributes):
    """timing.json of a run of a method with parts that are timed by themselves."""
    monkeypatch.setattr(fakes.FakeMethod, "timed_parts", parts, raising=False)
    for name, value in attributes.items():
        monkeypatch.setattr(fakes.FakeTask, name, value, raising=False)
    return run(compose(choice)).timing()


def test_a_methods_parts_are_timed_in_its_own_order(choice, monkeypatch):
    seen = []

    def parts(self, lighting, gbuffer):
        seen.append((float(lighting.mean()), len(gbuffer)))
        return {"measure": lambda: self.light(lighting), "blend": lambda: self.shade(gbuffer, 0.5)}

    # the item that the task chooses is the one timed: its last
    timing = timed(choice, monkeypatch, parts, timed_item=lambda self: self.tests()[-1])
    assert timing["parts"] == ["measure", "blend"] and timing["blend"]["repetitions"] >= 30
    last = fakes.FakeTask(None, None, 2).tests()[-1]
    assert seen == [(float(last.lighting.mean()), len(last.gbuffer))]


def test_a_part_cannot_take_a_name_that_means_something_else(choice, monkeypatch):
    with pytest.raises(PrtError, match="timed_parts names fit, which means something else"):
        timed(choice, monkeypatch, lambda self, lighting, gbuffer: {"fit": lambda: None})


def test_items_without_a_view_have_no_gbuffer_time(choice, monkeypatch):
    def item(self):
        found = self.tests()[0]
        image, found.gbuffer = found.gbuffer.image, dataclasses.replace(found.gbuffer, view=None)
        monkeypatch.setattr(type(found.gbuffer), "image", lambda gbuffer, values: image(values))
        return found

    timing = timed(choice, monkeypatch, lambda *_: {}, timed_item=item, mitsuba_scene="a scene")
    assert "gbuffer" not in timing and "parts" not in timing and timing["shade"]["median"] > 0


def test_a_figure_nobody_defines_is_refused(choice, monkeypatch):
    monkeypatch.setattr(fakes.FakeTask, "error_split", lambda *_: {"truncation": 30.0})
    with pytest.raises(PrtError, match="unknown metric 'truncation'"):
        run(compose(choice))


def test_a_method_for_another_task_is_refused_and_leaves_nothing(choice, tmp_path):
    with pytest.raises(PrtError, match="method=other cannot do task=fake.*methods that can: fake$"):
        run(compose([*choice, "method=other"]))
    assert find_runs(tmp_path / "runs") == []


def test_wrong_shape_is_an_error_naming_it(choice):
    with pytest.raises(PrtError, match=r"shade returned shape \(59, 2\) for 59 points"):
        run(compose([*choice, "+method.shape=2"]))


def test_missing_data_leaves_no_folder(choice, tmp_path):
    with pytest.raises(PrtError, match="data file not found: expected x.xml"):
        run(compose([*choice, "scene.missing=x.xml"]))
    assert not (tmp_path / "runs").exists()


def test_two_processes_cannot_share_a_run(choice):
    cfg = compose(choice)
    with folder_of(cfg).lock():
        with pytest.raises(PrtError, match="is in use by process"):
            run(cfg)
    assert run(cfg).done


def test_a_lock_left_by_a_dead_process_is_taken_over(choice):
    cfg = compose(choice)
    folder = folder_of(cfg)
    folder.path.mkdir(parents=True)
    (folder.path / "lock").write_text(json.dumps({"pid": 999999999, "host": "gone", "time": 0}))
    assert run(cfg).done


def test_a_folder_that_cannot_be_written_is_one_line(choice, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PrtError, match="cannot write the run folder .*run.folder="):
        run(compose([*choice, f"run.folder={tmp_path / 'file'}"]))


def test_score_recomputes_the_same_numbers_from_the_images(choice):
    folder = run(compose(choice))
    before = folder.metrics()
    columns = list(METRIC_COLUMNS[:6])
    folder.write_metrics([row if row[5] != "psnr" else (*row[:6], "0.0") for row in folder.metric_rows()])
    assert score.main([folder.path]) == 0
    pd.testing.assert_frame_equal(
        folder.metrics().sort_values(columns, ignore_index=True),
        before.sort_values(columns, ignore_index=True),
    )
    score.main([folder.path.parent], ["rmse"])  # further metrics join those there are
    assert set(folder.metrics().metric) == {
        "psnr",
        "mae",
        "rmse",
        "bad_pixels",
        "noise_floor",
        *SPLIT,
    }


def test_a_finished_run_gets_the_metrics_that_it_lacks(choice, capsys):
    folder = run(compose(choice))
    before = folder.metrics()
    again = run(compose([*choice, "run.metrics=[psnr,rmse]"]))
    assert again.path == folder.path and "rmse of" in capsys.readouterr().err
    found = folder.metrics()
    assert set(found.metric) == {*before.metric, "rmse"} and len(found) > len(before)
    assert (found[found.metric == "rmse"].value > 0).all()
    without = run(compose([*choice, "run.images.save=false", "seed=7"]))
    run(compose([*choice, "run.images.save=false", "seed=7", "run.metrics=[rmse]"]))
    assert "not possible" in capsys.readouterr().err and "rmse" not in set(without.metrics().metric)


def test_rows_of_images_that_are_no_test_any_more_are_kept(choice):
    folder = run(compose(choice))
    rows = folder.metric_rows()
    folder.write_metrics([*rows, ("far", "gone", "dusk", *rows[0][3:])])
    score.main([folder.path])
    assert ("far", "gone", "dusk") in {row[:3] for row in folder.metric_rows()}
    assert len(folder.metric_rows()) == len(rows) + 1


def test_score_without_images_says_what_to_do(choice):
    folder = run(compose([*choice, "run.images.save=false"]))
    with pytest.raises(PrtError, match="run.images.save=true"):
        score.main([folder.path])


def test_a_damaged_model_is_fitted_again(choice):
    cfg = compose(choice)
    folder = run(cfg)
    wanted = folder.checkpoint.read_bytes()
    (folder.path / "DONE").unlink()
    folder.checkpoint.write_bytes(wanted[:-3] + b"abc")
    with pytest.warns(UserWarning, match="damaged and will be fitted again"):
        run(cfg)
    assert folder.checkpoint.read_bytes() == wanted


def test_reading_a_folder_that_is_no_run(tmp_path):
    with pytest.raises(PrtError, match="no run folder"):
        RunFolder(tmp_path).config()
    assert RunFolder(tmp_path).state() == "absent"


def test_runs_that_differ_in_rendering_alone_share_a_fit(choice, monkeypatch, capsys):
    monkeypatch.setattr(fakes.FakeMethod, "rendering", frozenset({"sleep"}), raising=False)
    first = run(compose(choice))
    capsys.readouterr()
    second = run(compose([*choice, "method.sleep=0.001"]))
    assert "fitted already" in capsys.readouterr().err
    assert second.checkpoint.read_bytes() == first.checkpoint.read_bytes()
    assert second.provenance()["fitted_by"] == first.path.name
    assert second.timing()["fit"] == first.timing()["fit"]
    assert len(second.log()) == len(first.log())
    run(compose([*choice, "method.sleep=0.001", "method.rate=0.02"]))
    assert "fitted already" not in capsys.readouterr().err


def test_a_damaged_fit_is_not_taken_over(choice, monkeypatch, capsys):
    monkeypatch.setattr(fakes.FakeMethod, "rendering", frozenset({"sleep"}), raising=False)
    first = run(compose(choice))
    first.checkpoint.write_bytes(first.checkpoint.read_bytes()[:-1] + b"x")
    capsys.readouterr()
    run(compose([*choice, "method.sleep=0.001"]))
    assert "fitted already" not in capsys.readouterr().err


def test_a_benchmarks_model_is_fitted_once(choice, capsys):
    cfg = compose(choice)
    task = build_task(cfg)
    one, two = fitted(cfg, task), fitted(cfg, task)
    assert folder_of(cfg).state() == "stopped"  # fitted, not judged
    x = torch.linspace(0, 1, 5)[:, None]
    assert torch.equal(one.net(x), two.net(x))
    run(cfg)
    assert len(folder_of(cfg).log()) == 40


def test_a_benchmarks_model_may_be_another_runs_and_be_taken_over_in_turn(choice, monkeypatch):
    """A folder that took over a fit is a run's like any other: it says what it is of."""
    monkeypatch.setattr(fakes.FakeMethod, "rendering", frozenset({"sleep"}), raising=False)
    run(compose(choice))
    cfg = compose([*choice, "method.sleep=0.001"])
    fitted(cfg, build_task(cfg))
    assert folder_of(cfg).config().method.sleep == 0.001
    assert folder_of(cfg).provenance()["fitted_by"]
    assert run(compose([*choice, "method.sleep=0.002"])).state() == "done"


def test_a_new_report_is_no_change_of_the_code(tmp_path):
    def git(*words):
        subprocess.run(
            ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a", *words], check=True
        )

    for name in ("prt", "reports"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("before")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "all")
    (tmp_path / "reports" / "file").write_text("after")
    assert provenance.git_state(tmp_path / "prt")[1] is False
    (tmp_path / "prt" / "file").write_text("after")
    commit, dirty = provenance.git_state(tmp_path / "prt")
    assert dirty is True and commit is not None and len(commit) == 40

"""Tables that measure: the recorder's benchmark through ``prt table`` at a tiny size, and a made-up one."""

import csv
from pathlib import Path

import pandas as pd
import pytest
import tiny

from prt import cli
from prt.bench import benchmark, table
from prt.bench.results import COLUMNS, read_results
from prt.errors import PrtError

ROOT = Path(__file__).resolve().parents[2]
YAML = """
title: A made-up benchmark
benchmark: {_target_: test_benchmark.made_up, size: 4}
grid: {scene: [cornell_glossy, mirror_room]}
common: [budget=smoke]
claims:
  - record[mode=a] > 0.7 on ratio/paths/full, every scene
  - record[mode=b] > 0.7 on ratio/paths/full, every scene
  - record[mode=c] > 0.7 on ratio/paths/full, every scene
"""
CALLS = []


def made_up(scene, lighting, size, fail=""):
    """Three modes whose intervals lie above, across and below 0.7."""
    CALLS.append((scene.name, lighting.resolution, size))
    if fail == scene.name:
        raise PrtError("out of luck")
    rows = []
    for mode, value in {"a": 0.9, "b": 0.7, "c": 0.5}.items():
        figures = {"metric": "ratio/paths", "value": value, "lo": value - 0.05, "hi": value + 0.05, "n": 9}
        rows.append(
            {"method": "record", "device": "a CPU", "variant": f"mode={mode}", "component": "full", **figures}
        )
    return rows


@pytest.fixture
def made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "made.yaml").write_text(YAML)
    CALLS.clear()
    return tmp_path / "reports" / "made"


def test_a_benchmark_makes_a_whole_report(made, capsys):
    assert cli.main(["table", "made"]) == 0
    assert [call[0] for call in CALLS] == ["cornell_glossy", "mirror_room"] and CALLS[0][2] == 4
    assert {path.name for path in made.iterdir()} == {
        "results.csv", "table.md", "table.tex", "claims.csv", "report.md"
    }  # fmt: skip
    assert next(csv.reader((made / "results.csv").read_text().splitlines())) == COLUMNS
    results = read_results(made / "results.csv")
    assert len(results) == 6 and set(results.device) == {"a CPU"} and set(results.budget) == {"smoke"}
    verdicts = list(csv.DictReader((made / "claims.csv").read_text().splitlines()))
    overall = [row["verdict"] for row in verdicts if row["scene"] == "every scene"]
    assert overall == ["holds", "undecided", "fails"]
    assert (verdicts[0]["difference"], verdicts[0]["lo"]) == ("0.2", "0.15")
    assert "| cornell_glossy | record | mode=a | full | 0.9 [0.85, 0.95] |" in (made / "table.md").read_text()
    report = (made / "report.md").read_text()
    assert "prt table made" in report and "size 4" in report and "Nothing." in report
    out = capsys.readouterr().out
    assert "holds: record" in out and str(made / "report.md").removeprefix(str(made.parents[1]) + "/") in out


def test_settings_can_be_changed_and_are_checked(made, capsys):
    changed = made.with_name("made_benchmark.size-8")
    assert cli.main(["table", "made", "benchmark.size=8", "scene=mirror_room", f"report={changed}"]) == 0
    assert CALLS == [("mirror_room", 8, 8)] and changed.is_dir() and not made.exists()
    assert cli.main(["table", "made", "benchmark.siez=8"]) == 2
    assert "benchmark.siez is not a setting of made_up; did you mean size" in capsys.readouterr().err
    # changed settings never overwrite the table's own report
    assert table.load_spec("made", ["benchmark.size=8"]).report != Path("reports/made")


def test_a_scene_that_fails_does_not_cost_the_others(made, capsys):
    assert cli.main(["table", "made", "benchmark.fail=mirror_room", f"report={made}"]) == 1
    assert set(read_results(made / "results.csv").scene) == {"cornell_glossy"}
    assert "- mirror_room: out of luck" in (made / "report.md").read_text()
    verdicts = list(csv.DictReader((made / "claims.csv").read_text().splitlines()))
    assert [row["verdict"] for row in verdicts[:3]] == ["holds", "undecided", "undecided"]
    # with nothing measured there is no report
    assert cli.main(["table", "made", "scene=mirror_room", "benchmark.fail=mirror_room"]) == 2
    assert "out of luck" in capsys.readouterr().err


def drawing(scene, lighting, size, folder, draws="all"):
    """As :func:`made_up` over sizes, with a picture of its own for every scene."""
    if draws in ("all", scene.name):
        (folder / f"{scene.name}.png").write_bytes(b"a picture")
    rows = []
    for n in (4, 16):
        place = {"method": "record", "device": "a CPU", "variant": f"mode=a,size={n}", "component": "full"}
        for metric in ("condition/matrix", "rmse"):
            rows.append({**place, "metric": metric, "value": 1 / n, "lo": 0.9 / n, "hi": 1.1 / n, "n": 9})
    return rows


DRAWING = """
title: A benchmark that draws
benchmark: {_target_: test_benchmark.drawing, size: 4}
grid: {scene: [cornell_glossy, mirror_room]}
common: [budget=smoke]
claims:
  - record[mode=a,size=16] > record[mode=a,size=4] on condition/matrix/full, every scene
  - record[mode=a,size=16] > record[mode=a,size=4] on rmse/full, every scene
curves:
  - {file: error, x: size, y: [rmse/full, condition/matrix/full], group: scene, log: [x]}
pictures:
  - {file: cornell_glossy.png, caption: What it looks like}
  - {file: mirror_room.png}
"""


def test_a_benchmark_draws_its_own_pictures_and_curves(made, capsys):
    (made.parents[1] / "experiments" / "made.yaml").write_text(DRAWING)
    assert cli.main(["table", "made"]) == 0
    names = {path.name for path in made.iterdir()}
    assert {"error.svg", "error.png", "cornell_glossy.png", "mirror_room.png"} <= names
    report = (made / "report.md").read_text()
    assert "![What it looks like](cornell_glossy.png)\n\n*What it looks like*" in report
    assert "![mirror_room.png](mirror_room.png)" in report and "![error](error.svg)" in report
    # figures of a benchmark need no split, whatever their metric
    assert report.count("✔ holds | holds on 2") == 2
    # one that is not drawn again does not stay
    assert cli.main(["table", "made", "benchmark.draws=mirror_room", f"report={made}"]) == 0
    assert not (made / "cornell_glossy.png").exists() and (made / "mirror_room.png").exists()
    report = (made / "report.md").read_text()
    assert "no picture cornell_glossy.png: it was not written" in report
    assert "](cornell_glossy.png)" not in report
    # a dry run removes nothing
    assert cli.main(["table", "made", "--dry-run", f"report={made}"]) == 0
    assert (made / "mirror_room.png").exists()
    assert cli.main(["table", "made", "benchmark.folder=x"]) == 2
    assert "folder" in capsys.readouterr().err


def test_a_picture_cannot_have_a_charts_name(made, capsys):
    text = DRAWING.replace("mirror_room.png", "chart_size.png")
    text += "charts: [{file: size, x: bytes/model, y: rmse/full}]\n"
    (made.parents[1] / "experiments" / "made.yaml").write_text(text)
    assert cli.main(["table", "made"]) == 2
    assert "'chart_size.png' is another picture's name" in capsys.readouterr().err


def test_rows_of_a_benchmark_may_have_splits():
    spec = table.load_spec(str(ROOT / "experiments" / "performance" / "record.yaml"))
    rows = [{"scene": "box", "method": "m", "variant": "", "component": "full", "metric": "rmse", "value": v,
             "split": s} for s, v in (("same", 1.0), ("points", 2.0))]  # fmt: skip
    found = benchmark.sheet(spec, pd.DataFrame(rows, columns=COLUMNS))
    assert [lead[-1] for lead, _ in found.rows] == ["same", "points"]


def test_figures_of_the_whole_method_stand_in_all_its_rows():
    spec = table.load_spec(str(ROOT / "experiments" / "performance" / "record.yaml"))
    given = [
        ("a", "full", "same", "rmse", 1.0), ("a", "full", "points", "rmse", 2.0),
        ("a", "", "", "bytes/model", 8.0), ("b", "", "", "bytes/model", 9.0),
    ]  # fmt: skip
    rows = [
        {"scene": "box", "method": "m", "variant": v, "component": c, "split": s, "metric": m, "value": x}
        for v, c, s, m, x in given
    ]
    found = benchmark.sheet(spec, pd.DataFrame(rows, columns=COLUMNS))
    cells = {tuple(lead[2:]): [entry.parts[0] for entry in row] for lead, row in found.rows}
    assert cells == {
        ("a", "full", "same"): ["1", "8"], ("a", "full", "points"): ["2", "8"], ("b", "", ""): ["–", "9"],
    }  # fmt: skip


def test_dry_run_measures_nothing(made, capsys):
    assert cli.main(["table", "made", "--dry-run"]) == 0
    assert "2 measurements" in capsys.readouterr().out and not CALLS and not made.exists()


def test_without_data_a_benchmark_takes_what_needs_none(monkeypatch, tmp_path):
    path = str(ROOT / "experiments" / "performance" / "record.yaml")
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    spec = table.load_spec(path)
    assert spec.grid["scene"] == ["cornell_glossy", "kitchen"] and "lighting=hdri" in spec.common
    monkeypatch.delenv("PRT_DATA")
    spec = table.load_spec(path)
    assert spec.grid["scene"] == ["cornell_glossy"] and "lighting=procedural" in spec.common
    assert {claim.metric for claim in spec.claims} == {"ratio/paths", "ratio/cost"}


def test_the_recorders_own_benchmark_runs(made, own_cache, maps, monkeypatch):
    """``experiments/performance/record.yaml`` as it stands, with everything tiny."""
    monkeypatch.delenv("PRT_DATA", raising=False)
    small = dict(size=4, spp=2, lights=2, repetitions=3, variance_spp=2, variance_seeds=3)
    lights = [*tiny.lights(maps), f"task.resolution={tiny.RESOLUTION}"]
    spec = table.load_spec(
        str(ROOT / "experiments" / "performance" / "record.yaml"),
        [f"report={made}", "budget=smoke", *(f"benchmark.{k}={v}" for k, v in small.items())],
    )
    spec.common = ["budget=smoke", *lights]  # in place of procedural rooms, which take a minute
    assert benchmark.main(spec) == 0
    results = read_results(made / "results.csv")
    assert set(results.method) == {"record"} and (results.value > 0).all()
    assert set(results.metric) == {
        "ratio/paths", "ratio/cost", "ratio/variance", "paths/record", "paths/render"
    }  # fmt: skip
    assert {"mode=bsdf,map=indoor", "mode=nee,map=outdoor"} <= set(results.variant)
    verdicts = list(csv.DictReader((made / "claims.csv").read_text().splitlines()))
    assert len(verdicts) == 8 and not any(row["note"].startswith("record") for row in verdicts)

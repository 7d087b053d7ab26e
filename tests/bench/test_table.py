"""``prt table``: the YAML, the grid, running what is missing, and a report made from finished runs."""

import csv
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from synthetic_runs import fake_references, make_run

from prt.bench import report, table
from prt.bench.results import COLUMNS, read_published, read_results
from prt.bench.spec import has_matrix
from prt.errors import PrtError

ROOT = Path(__file__).resolve().parents[2]
YAML = """
title: A small table
about: Two methods in a box.
grid:
  scene: [box, den]
  method: [wavelet_neural, neural_prt]
common: [lighting=hdri, budget=laptop]
published: paper.csv
claims: ["wavelet_neural > neural_prt on psnr/indirect, far, every scene"]
figure: {component: indirect, rows: [{scene: box}]}
"""
PAPER = ",".join(COLUMNS) + "\nbox,wavelet_neural,denoised,paper,GPU,far,full,psnr,,,,,,12.34\n"


@pytest.fixture
def spec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "small.yaml").write_text(YAML)
    (tmp_path / "experiments" / "paper.csv").write_text(PAPER)
    return table.load_spec("small")


def quiet() -> Console:
    import io

    return Console(file=io.StringIO(), width=160)


def write(spec, cells, failed=None) -> dict[str, bytes]:
    report.write_report(spec, table.layout_of(spec, cells), cells, failed, fake_references, quiet())
    return {path.name: path.read_bytes() for path in spec.report.iterdir()}


def test_report_has_every_file_and_regenerates_identically(spec, tmp_path):
    cells = [
        make_run(tmp_path / "runs", scene, method, images=True)
        for scene in spec.grid["scene"]
        for method in spec.grid["method"]
    ]
    files = write(spec, cells)
    assert set(files) == {
        "results.csv", "table.md", "table.tex", "claims.csv", "chart.svg", "chart.png", "figure.png",
        "figure.json", "report.md",
    }  # fmt: skip
    assert write(spec, cells) == files
    assert list(csv.reader(files["results.csv"].decode().splitlines()))[0] == COLUMNS
    results = read_results(spec.report / "results.csv")
    beside = results[results["published"].notna()]
    assert list(beside["published"]) == [12.34] and (results["value"] != 12.34).all()
    text = files["report.md"].decode()
    assert "commit 0123456789ab" in text and "Test CPU, 2 threads" in text and "budget laptop" in text
    assert "prt table small" in text and "✔ holds" in text and "truncation" in text and "60.0" in text
    assert b"12.34" not in files["table.md"].split(b"## Published")[0] and b"12.34" in files["table.md"]


def test_curves_pictures_and_views_of_a_report(spec, tmp_path):
    text = YAML.replace("method: [wavelet_neural, neural_prt]", "method: [neural_prt]\n  basis: [4, 16]")
    text = (
        text.replace("published: paper.csv\n", "").split("claims:")[0]
        + """
columns: {views: [lightmap, elsewhere], as_is: neural_prt}
claims: ["neural_prt[basis=16] > neural_prt[basis=4] on psnr/indirect, same, every scene"]
curves: [{file: error, x: basis, y: psnr/indirect, log: [x]}]
charts: [{file: size, x: bytes/model, y: psnr/indirect, split: same}]
enough: {x: time/shade, y: psnr/indirect, within: 20, split: same}
pictures: [{file: parts.png, caption: Its parts}, {file: gone.png}]
"""
    )
    (tmp_path / "experiments" / "small.yaml").write_text(text)
    spec = table.load_spec("small")
    cells = [
        make_run(tmp_path / "runs", scene, "neural_prt", variant=f"basis={n}", psnr=20.0 + n, denoise=False,
                 shade=n / 100, splits=("same", "points"), views=("lightmap", "frame00"))
        for scene in spec.grid["scene"] for n in (4, 16)
    ]  # fmt: skip
    spec.report.mkdir(parents=True)
    (spec.report / "parts.png").write_bytes(b"drawn by somebody")
    files = write(spec, cells)
    drawn = {"error.svg", "error.png", "parts.png", "chart_size.svg", "chart_size.png"}
    assert drawn <= set(files) and write(spec, cells) == files
    assert b"model size" in files["chart_size.svg"] or b"MB" in files["chart_size.svg"]
    results = read_results(spec.report / "results.csv")
    assert set(results["split"]) == {"same", "points", ""} and set(
        results.loc[results.metric == "psnr", "n"]
    ) == {2}
    text = files["report.md"].decode()
    # splits that were measured, without being asked for
    assert "Box, same lights" in text and "Box, point lights" in text and "far views" not in text
    assert "Box, same lights: neural prt (basis=4), 40 of time to shade a frame (ms), has" in text
    assert "(chart_size.svg)" in text and "![error](error.svg)" in text and "![Its parts](parts.png)" in text
    assert "no finished run has a view 'elsewhere'; there are lightmap, frame00" in text
    assert "no picture gone.png: it was not written" in text and "Only test items with these views" in text
    assert text.count("✔ holds") == 3


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("enough: {x: bytes/model, y: psnr/indirect}", "enough: within is missing"),
        (
            "enough: {x: bytes/model, y: psnr/indirect, within: 0}",
            "enough: within=0 must be a number above 0",
        ),
        ("enough: {x: bytes/model, y: sharp/indirect, within: 1}", "is not an axis"),
        ("charts: [{file: a/b, x: bytes/model, y: psnr/indirect}]", "must be a plain word"),
    ],
)
def test_mistakes_in_what_is_enough_and_in_charts(spec, line, words):
    spec.path.write_text(YAML + line + "\n")
    with pytest.raises(PrtError, match=words):
        table.load_spec("small")


def test_a_failed_run_shows_as_failed_with_its_reason(spec, tmp_path):
    cells = [
        make_run(
            tmp_path / "runs",
            scene,
            method,
            images=True,
            state="failed" if (scene, method) == ("den", "neural_prt") else "done",
        )
        for scene in spec.grid["scene"]
        for method in spec.grid["method"]
    ]
    files = write(spec, cells)
    assert b"| failed |" in files["table.md"] and b"loss became NaN at step 12" in files["report.md"]
    claims = list(csv.DictReader(files["claims.csv"].decode().splitlines()))
    assert [row["verdict"] for row in claims] == ["holds", "undecided", "undecided"]
    assert "loss became NaN" in claims[1]["note"]


def test_a_report_without_any_run_says_so(spec, tmp_path):
    cells = [make_run(tmp_path / "runs", scene, "neural_prt", state="absent") for scene in spec.grid["scene"]]
    files = write(spec, cells)
    assert "chart.png" not in files and b"not run" in files["report.md"] and b"no chart" in files["report.md"]


def test_unavailable_lpips_is_explained(spec, tmp_path, monkeypatch):
    monkeypatch.setattr("prt.metrics.lpips.lpips_unavailable", lambda network="alex": "weights not found")
    cells = [
        make_run(tmp_path / "runs", scene, method, lpips=None, images=True)
        for scene in spec.grid["scene"]
        for method in spec.grid["method"]
    ]
    files = write(spec, cells)
    assert b"n/a / n/a" in files["table.md"] and b"(weights not found)" in files["report.md"]


def test_runs_what_is_missing_and_goes_on_after_a_failure(tmp_path, capsys):
    done = make_run(tmp_path, "box", "wavelet_neural")
    others = [make_run(tmp_path, "box", name, state="absent") for name in ("neural_prt", "path_traced")]
    called = []

    def carry_out(cfg):
        called.append(cfg.number)
        if cfg.number == 1:
            raise PrtError("no data for this scene")

    cells = [
        (cell, SimpleNamespace(number=i, run=SimpleNamespace(metrics=["psnr"])))
        for i, cell in enumerate([done, *others])
    ]
    failed = table.run_missing(cells, carry_out)
    assert called == [1, 2] and failed == {others[0]: "no data for this scene"}
    said = capsys.readouterr().err
    assert "[1/2] box neural_prt" in said and "[2/2] box path_traced" in said and "left" in said


def test_overrides_replace_axes_and_settings(spec):
    changed = table.load_spec("small", ["budget=smoke", "scene=box", "run.folder=elsewhere"])
    runs = table.grid_overrides(changed)
    assert [r[0] for r in runs] == [
        ["lighting=hdri", "budget=smoke", "run.folder=elsewhere", "scene=box", f"method={method}", "seed=0"]
        for method in ("wavelet_neural", "neural_prt")
    ]
    # results of another budget never overwrite the table's own report
    assert changed.report == Path("reports/small_budget-smoke_scene-box")
    assert spec.report == Path("reports/small")
    assert table.load_spec("small", ["budget=laptop"]).report == spec.report
    assert table.load_spec("small", ["budget=smoke", "report=here"]).report == Path("here")


def test_further_axes_and_overrides_make_the_variant(spec, tmp_path):
    axes = "  method: [wavelet_neural, neural_prt +a.b=0.5]\n  method.wavelets: [16, 64]\n  seed: [0, 1]"
    text = YAML.replace("  method: [wavelet_neural, neural_prt]", axes)
    (tmp_path / "experiments" / "axes.yaml").write_text(text)
    runs = table.grid_overrides(table.load_spec("axes"))
    assert len(runs) == 2 * 2 * 2 * 2
    assert {variant for _, variant in runs} == {
        "wavelets=16", "wavelets=64", "wavelets=16,b=0.5", "wavelets=64,b=0.5",
    }  # fmt: skip
    assert "+a.b=0.5" in runs[2][0] and "method.wavelets=16" in runs[2][0]


def test_settings_of_a_method_on_one_scene(spec, tmp_path):
    text = (
        YAML
        + "settings: {neural_prt: [a=5], box/neural_prt: [a=7], den: [b=1], bathroom/neural_prt: [a=9]}\n"
    )
    text = (
        text.replace("[box, den]", "[kitchen, bathroom]")
        .replace("box/", "kitchen/")
        .replace("den:", "kitchen:")
    )
    text = text.replace("{scene: box}", "{scene: kitchen}").replace(
        "[kitchen, bathroom]", "[kitchen, alcove]"
    )
    (tmp_path / "experiments" / "set.yaml").write_text(text)
    spec = table.load_spec("set")
    assert list(spec.settings) == ["neural_prt", "kitchen/neural_prt", "kitchen"], (
        "the bathroom is not in the grid"
    )
    found = {tuple(words[-3:-1]): words for words, _ in table.grid_overrides(spec)}
    mine = found["scene=kitchen", "method=neural_prt"]
    assert mine.index("a=7") > mine.index("a=5") and "b=1" in mine, "the closest wins"
    assert "a=7" not in found["scene=alcove", "method=neural_prt"]
    assert "a=7" not in found["scene=kitchen", "method=wavelet_neural"]


def test_settings_of_one_method_are_no_variant_and_yield_to_the_command_line(spec, tmp_path):
    text = YAML + "settings: {neural_prt: [method.training.steps=5]}\n"
    (tmp_path / "experiments" / "set.yaml").write_text(text)
    runs = table.grid_overrides(table.load_spec("set", ["scene=box"]))
    assert {variant for _, variant in runs} == {""}
    assert ["method.training.steps=5" in overrides for overrides, _ in runs] == [False, True]
    changed = table.load_spec("set", ["scene=four_shapes", "method.training.steps=7"])
    steps = [cfg.method.training.steps for _, cfg in table.resolve(changed)]
    assert steps == [7, 7]
    assert table.load_spec("set", ["method=wavelet_neural"]).settings == {}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            ("common:", "settings: {neural_prd: [a=1]}\ncommon:"),
            "neural_prd', which is no method, scene or scene/method; did you mean neural_prt",
        ),
        (("grid:", "gird:"), "unknown key 'gird'; did you mean grid"),
        (("claims:", "claims: [nonsense]\nclaim:"), "unknown key 'claim'"),
        (("psnr/indirect, far", "psnr/indirect"), "near or far"),
        (
            ("figure: {component", "figure: {componend"),
            "unknown key 'figure.componend'; did you mean component",
        ),
        (("  method: [wavelet_neural, neural_prt]\n", ""), "at least one scene and one method"),
        (("published: paper.csv", "columns: [1"), "YAML"),
        (
            ("rows: [{scene: box}]", "rows: [{scene: box, lable: a}]"),
            "figure.rows.lable'; did you mean label",
        ),
        (("rows: [{scene: box}]", "rows: box"), "figure.rows must be a list of entries"),
        (("published: paper.csv", "curves: [{file: a, x: b, y: c}]"), "bad.yaml: curves, file 'a': y: 'c'"),
        (("published: paper.csv", "curves: {file: a}"), "curves must be a list of entries"),
        (
            ("published: paper.csv", "pictures: [{file: ../a.png}]"),
            "'../a.png' must be a name ending in .png",
        ),
        (("published: paper.csv", "pictures: [{file: a.png}, {file: a.png}]"), "another picture's name"),
        (("published: paper.csv", "pictures: [{file: chart.png}]"), "another picture's name"),
        (("published: paper.csv", "chart: {where: 3}"), "where=3 must be pairs"),
    ],
)
def test_mistakes_in_the_yaml_are_one_line(spec, tmp_path, change, says):
    (tmp_path / "experiments" / "bad.yaml").write_text(YAML.replace(*change))
    with pytest.raises(PrtError, match=says) as error:
        table.load_spec("bad")
    assert "\n" not in str(error.value)


def test_a_method_the_figure_cannot_show_is_found_before_any_run(spec, tmp_path):
    spec.figure["columns"] = ["neural_prd"]
    cells = [make_run(tmp_path, "box", "neural_prt", state="absent")]
    with pytest.raises(PrtError, match="figure.columns: no method 'neural_prd' .* choose from neural_prt"):
        table.layout_of(spec, cells)


def test_a_label_of_a_row_that_the_table_lacks_is_an_error_unless_rows_were_left_out(spec, tmp_path):
    spec.labels["neural_prt[size=3]"] = "Small"
    cells = [make_run(tmp_path, "box", "neural_prt", state="absent")]
    with pytest.raises(PrtError, match=r"labels: no method 'neural_prt\[size=3\]' .* choose from neural_prt"):
        table.layout_of(spec, cells)
    spec.overrides.append("method=neural_prt")
    assert table.layout_of(spec, cells).method_label("neural_prt", "size=3").endswith("(Small)")


def test_unknown_table_names_those_there_are(spec):
    with pytest.raises(PrtError, match="no table 'smal'; did you mean small"):
        table.load_spec("smal")
    with pytest.raises(PrtError, match="key=value"):
        table.load_spec("small", ["budget"])


def test_a_report_that_cannot_be_written_is_found_before_any_run(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PrtError, match="cannot write"):
        table.check_writable(tmp_path / "file" / "report")


def test_the_projects_own_tables_are_well_formed():
    for path in sorted((ROOT / "experiments").rglob("*.yaml")):
        if has_matrix(path):  # tests/bench/test_matrix.py
            continue
        spec = table.load_spec(str(path))
        assert (spec.grid.get("method") or spec.benchmark) and table.grid_overrides(spec)
        if spec.published:
            assert len(read_published(spec.published))


def test_published_table1_is_complete():
    paper = read_published(ROOT / "experiments" / "raghavan2023" / "published" / "table1.csv")
    assert len(paper) == 4 * 2 * 2 * 2 * 2 * 3 and not paper.duplicated(COLUMNS[:8]).any()
    cell = paper.set_index(["scene", "method", "variant", "split", "component", "metric"])["published"]
    # corners of the printed table
    assert cell["four_animals", "neural_prt", "", "far", "full", "psnr"] == 28.08
    assert cell["diffuse_kitchen", "neural_prt", "", "near", "indirect", "psnr"] == 40.10
    assert cell["four_animals", "wavelet_neural", "denoised", "far", "full", "lpips"] == 0.0489
    assert cell["diffuse_kitchen", "wavelet_neural", "denoised", "near", "indirect", "lpips"] == 0.0277
    # the caption's claim holds in the paper's own numbers
    for key, value in cell.items():
        if key[1] == "wavelet_neural" and key[2] == "denoised":
            other = cell[(key[0], "neural_prt", *key[2:])]
            assert value < other if key[-1] == "lpips" else value > other

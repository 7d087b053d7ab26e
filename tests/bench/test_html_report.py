"""``prt report``: what the page holds, that nothing in a report can act, and how its mistakes are told."""

import json
import re
import shutil
from pathlib import Path

import pytest
from html_page import NAMES
from synthetic_reports import ATTACK, PIXEL, hostile_report

from prt import cli
from prt.bench.html import measured, page, pictures, svg
from prt.bench.html.content import read_report, summary
from prt.errors import PrtError


def read(reports: Path, name: str) -> dict:
    return read_report(name, reports / name)


def embedded(text: str) -> dict[str, dict]:
    """The data of a page, by the ids of its elements."""
    found = re.findall(r'<script type="application/json" id="([\w-]+)">(.*?)</script>', text, re.DOTALL)
    return {name: json.loads(content) for name, content in found}


def test_a_report_is_read_whole(reports):
    report = read(reports, "nobody2024/table1")
    assert report["title"] == "Table 1 of Nobody 2024" and report["command"] == "prt table nobody2024/table1"
    assert report["about"] == [{"kind": "p", "spans": ["Two methods in a box and a den."]}]
    assert report["facts"]["commit"] == "0123456789ab" and report["facts"]["device"] == "Test CPU, 2 threads"
    assert [claim["verdict"] for claim in report["claims"]] == ["holds", "fails", "undecided"]
    assert [row["scene"] for row in report["claims"][0]["scenes"]] == ["box", "den"]
    assert report["claims"][0]["scenes"][0]["lo"] > 0
    titles = [sheet["title"] for sheet in report["sheets"]]
    assert titles[0].startswith("Measured by this project") and "Time and size" in titles
    assert [chart["file"] for chart in report["charts"]] == ["chart.svg"] and report["charts"][0]["points"]
    assert {"How it was run", "What is missing", "How figures are defined"} <= {
        p["title"] for p in report["prose"]
    }
    assert not {"Claims", "Time and size"} & {part["title"] for part in report["prose"]}
    line = summary(report)
    assert line["paper"] == "nobody2024" and line["verdicts"] == {"holds": 1, "fails": 1, "undecided": 1}
    assert line["figures"] == len(report["results"]["value"]) and line["pictures"] == 1


def test_published_figures_stay_apart_from_measured_ones(reports):
    report = read(reports, "nobody2024/table1")
    results = report["results"]
    assert [v for v in results["published"] if v is not None] == [12.34, 56.78]
    assert not {12.34, 56.78} & {*results["value"], *results["lo"], *results["hi"]}
    assert results["value"][-1] is None and results["n"][-1] is None  # only the paper has it
    for sheet in report["sheets"]:
        assert ("12.34" in json.dumps(sheet["rows"])) == sheet["published"]
    assert any(sheet["published"] for sheet in report["sheets"])


def test_rows_of_results_are_those_of_the_file(reports):
    table = measured.read(reports / "nobody2024/table1/results.csv", "nobody2024/table1")
    columns = measured.columns(table)
    for row in (0, 7, len(table) - 1):
        for name in ("scene", "method", "variant", "split", "component", "metric"):
            assert columns["words"][name][columns["at"][name][row]] == table[name].iloc[row]
    assert columns["value"][0] == pytest.approx(table["value"].iloc[0], rel=1e-5)
    assert None in columns["lo"]  # of a time


def test_metrics_say_their_way_unit_and_form():
    found = measured.metrics(
        ["psnr", "ssim", "rmse", "time/shade", "bytes/model", "no_such_metric", "noise_floor"]
    )
    assert (found["psnr"]["label"], found["psnr"]["unit"], found["psnr"]["better"]) == (
        "PSNR",
        "dB",
        "higher",
    )
    forms = [metric["form"] for metric in found.values()]
    assert forms == ["2", "4", "digits", "time", "bytes", "digits", "2"]
    assert found["no_such_metric"] == {"label": "no_such_metric", "unit": "", "better": "", "form": "digits"}


def test_infinite_and_missing_figures_are_json():
    assert [measured.number(v) for v in (float("inf"), float("-inf"), float("nan"), 1 / 3)] == [
        "∞", "-∞", None, 0.333333,
    ]  # fmt: skip


# ---- one file, nothing from elsewhere, nothing that acts
def test_one_file_with_everything_in_it(here, capsys):
    assert cli.main(["report"]) == 0
    assert capsys.readouterr().out.startswith("report.html: 3 tables, ")
    text = (here / "report.html").read_text()
    data = embedded(text)
    assert [entry["name"] for entry in data["index"]] == NAMES and len(data) == 4
    png = data["report-2"]["figure"]["png"]
    assert text.count(png[:400]) == 1  # every picture once
    assert set(re.findall(r"""https?://[^\s"'\\<>)]+""", text)) <= {
        # the name of a language, and what the hostile report says in words
        "http://www.w3.org/2000/svg",
    } | {"https://example.org/far.svg"}
    assert not re.search(r"<(?:link|script|img|iframe)[^>]+(?:src|href)=(?!\"data:,\")", text)
    assert "{{" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    before = text
    assert cli.main(["report"]) == 0 and (here / "report.html").read_text() == before


def test_the_policy_runs_only_the_pages_own_script(reports):
    import base64
    import hashlib

    text = page.build([read(reports, name) for name in NAMES])
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy and "default-src 'none'" in policy
    assert "http" not in policy and "connect-src" not in policy


def test_no_text_of_a_report_becomes_markup(reports):
    text = page.build([read(reports, name) for name in NAMES])
    assert "<script>window.hacked" not in text and "<img src=x" not in text
    hostile = embedded(text)["report-0"]
    assert hostile["title"] == ATTACK.format("title")  # whole, as a text
    assert hostile["results"]["words"]["scene"] == [ATTACK.format("scene")]
    assert text.count("<script") == text.count("</script>") == 1 + 4
    for name in page.SCRIPTS:
        script = page.asset(name)
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function", script
        )


def test_a_chart_is_made_harmless(reports):
    (chart,) = read(reports, "hostile2024/table2")["charts"]
    assert "kept" in chart["svg"] and "var(--paper" not in chart["svg"]  # its style went, for what it loads
    for word in (
        "script",
        "onload",
        "onclick",
        "example.org",
        "javascript",
        "foreignObject",
        "<style",
        "<a ",
    ):
        assert word not in chart["svg"]
    assert 'clip-path="url(#c0-clip)"' in chart["svg"]
    with pytest.raises(ValueError, match="no SVG"):
        svg.prepare("<html/>", "a-")
    with pytest.raises(ValueError, match="no SVG"):
        svg.prepare("<svg", "a-")


def test_charts_follow_the_pages_colours_and_keep_the_datas(reports):
    (chart,) = read(reports, "nobody2024/table1")["charts"]
    assert "var(--paper, #ffffff)" in chart["svg"] and "#d55e00" in chart["svg"]
    ids = re.findall(r'id="([^"]+)"', chart["svg"])
    assert ids and all(name.startswith("c0-") for name in ids)
    used = re.findall(r'href="#([^"]+)"', chart["svg"])
    assert used and set(used) <= set(ids)


def test_the_scripts_and_styles_are_packaged():
    package = Path(page.__file__).parent
    assert {path.name for path in (package / "assets").iterdir()} == {
        *page.SCRIPTS,
        *page.STYLES,
        "page.html",
    }
    settings = (package.parents[2] / "pyproject.toml").read_text()
    assert re.search(r'package-data\]\nprt = \[.*"bench/html/assets/\*"', settings)


# ---- the figure's boxes
def test_a_figure_without_boxes_says_so(reports, tmp_path):
    whole = read(reports, "nobody2024/table1")
    assert [len(row["columns"]) for row in whole["figure"]["rows"]] == [4, 4] and whole["figure"][
        "note"
    ] == ""
    assert whole["figure"]["rows"][0]["columns"][1]["label"] == "Ours"
    assert whole["figure"]["rows"][0]["columns"][0]["error"] is None
    assert whole["figure"]["rows"][1]["facts"]["view"] == "view1"
    shutil.copy(reports / "nobody2024/table1/figure.png", tmp_path)
    old = pictures.figure(tmp_path, "prt table x")
    assert old is not None and old["rows"] == [] and "no figure.json; `prt table x`" in old["note"]
    other = read(reports, "hostile2024/table2")["figure"]
    assert other["rows"] == [] and "figure.json is of another figure.png" in other["note"]


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", '{"width": 1, "height": 1, "rows": [{}], "panels": [{"row": 3}]}',
     '{"width": 1, "height": 1, "rows": [{}], "panels": [{"row": 0, "column": "a", "kind": "picture", "x": 0,'
     ' "y": 0, "width": 2, "height": 1}]}'],
)  # fmt: skip
def test_damaged_boxes_leave_the_whole_figure(tmp_path, content):
    (tmp_path / "figure.png").write_bytes(PIXEL)
    (tmp_path / "figure.json").write_text(content)
    found = pictures.figure(tmp_path, "prt table x")
    assert found is not None and found["rows"] == [] and "cannot be laid over" in found["note"]
    assert "\n" not in found["note"]
    (tmp_path / "figure.png").write_bytes(b"no picture")
    assert pictures.figure(tmp_path, "prt table x") is None


@pytest.mark.parametrize(
    ("file", "content"),
    [("results.csv", ""), ("results.csv", "a,b\n1,2\n"), ("claims.csv", "claim,scene\nx,y\n"),
     ("results.csv", "\xff")],
)  # fmt: skip
def test_a_damaged_report_is_named(tmp_path, file, content):
    hostile_report(tmp_path / "x")
    (tmp_path / "x" / file).write_bytes(content.encode("latin-1"))
    with pytest.raises(
        PrtError, match=rf"cannot read .*{file} .*; write it again with `prt table x`"
    ) as error:
        read_report("x", tmp_path / "x")
    assert "\n" not in str(error.value)


def test_a_report_of_results_alone_is_shown(tmp_path):
    hostile_report(tmp_path / "x")
    for path in (tmp_path / "x").iterdir():
        if path.name != "results.csv":
            path.unlink()
    report = read_report("x", tmp_path / "x")
    assert (report["title"], report["command"]) == ("x", "prt table x")
    assert report["claims"] == report["sheets"] == report["charts"] == [] and report["figure"] is None
    assert "report-0" in embedded(page.build([report]))

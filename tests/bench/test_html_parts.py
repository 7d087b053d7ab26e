"""``prt report``: which reports are meant, its mistakes in one line, and Markdown as plain data."""

import pytest
from html_page import NAMES

from prt import cli
from prt.bench.html import folders, markdown


def test_names_choose_reports_and_papers(reports):
    assert folders.choose([], reports) == NAMES
    assert folders.choose(["nobody2024"], reports) == NAMES[1:]
    assert folders.choose(["nobody2024/table1", "hostile2024/", "nobody2024/table1"], reports) == NAMES[::2]


def test_a_path_of_a_report_is_a_name(here):
    assert folders.choose(["reports/nobody2024/table1/"]) == ["nobody2024/table1"]
    assert folders.choose(["reports/"]) == NAMES


def test_order_is_by_paper_and_number(tmp_path):
    for name in (
        "quickstart",
        "performance/a",
        "b2020/figure10",
        "b2020/figure9",
        "a2021/seams",
        "a2021/table1",
    ):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "results.csv").touch()
    assert folders.find(tmp_path) == [
        "a2021/seams", "a2021/table1", "b2020/figure9", "b2020/figure10", "performance/a", "quickstart",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody2024/tabel1"], "no report 'nobody2024/tabel1'; did you mean nobody2024/table1"),
        (["nobody"], "choose from hostile2024, nobody2024, hostile2024/table2, "),
        (["--output", "reports"], "--output reports is a folder; name a file"),
        (["--output", "reports/nobody2024/table1/report.md/x.html"], "cannot write"),
        (["--outptu=x"], "unknown option '--outptu=x'"),
    ],
)
def test_mistakes_are_one_line(here, capsys, arguments, message):
    assert cli.main(["report", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("prt: error: ") and message in error and error.count("\n") == 1


def test_without_reports_it_says_how_to_get_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["report"]) == 2
    assert "no reports in reports/; write one with `prt table quickstart`" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_links_to_reports_stay_and_others_are_words():
    text = "[x 4](../../su2024/stability/report.md) and [here](results.csv), [there](http://a.b/c/report.md)"
    assert markdown.spans(text) == [
        ["link", "x 4", "su2024/stability"], " and ", "here", ", ", "there",
    ]  # fmt: skip
    assert markdown.plain(markdown.spans(text)) == "x 4 and here, there"


def test_markdown_becomes_blocks_of_spans():
    found = markdown.blocks(
        "# T\n\nOne `a|b` and **c** *d* x*y*z\nline two [words](file.md).\n\n"
        "- item\n  goes on\n- **other**\n\n"
        "## S\n| a | b |\n|---|---:|\n| `x \\| y` | **1** / 2 |\n\n![A chart](chart.svg)\n"
    )
    assert markdown.title(found) == "T"
    assert found[1]["spans"] == [
        "One ", ["code", "a|b"], " and ", ["b", "c"], " ", ["i", "d"], " x*y*z line two ", "words", ".",
    ]  # fmt: skip
    assert found[2]["items"] == [["item goes on"], [["b", "other"]]]
    (_, _), (title, (table, image)) = markdown.sections(found)
    assert title == "S" and table["figures"] == [False, True]
    assert table["rows"] == [[[["code", "x | y"]], [["b", "1"], " / 2"]]]
    assert image == {"kind": "image", "file": "chart.svg", "caption": "A chart"}
    assert markdown.plain(found[1]["spans"]) == "One a|b and c d x*y*z line two words."
    assert markdown.blocks("") == [] and markdown.title([]) == ""

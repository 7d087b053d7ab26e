"""The matrix of failures: figures found in reports, graded, never invented."""

import math
import re

import pandas as pd
import pytest
import yaml
from synthetic_runs import make_run

from prt.bench import matrix_report
from prt.bench.matrix import read_matrix
from prt.bench.results import COLUMNS, read_images, read_results, summarise
from prt.cli import main
from prt.errors import PrtError

CELL = {
    "row": "ours", "column": "light", "report": "paper/fails",
    "at": {"scene": "box", "variant": "lights=odd", "metric": "error/relative"}, "good": 1.5, "bad": 3.0,
    "says": "error under odd lights", "because": "three times is plain to see",
}  # fmt: skip
ROWS = [
    ("box", "ours", "lights=odd", "error/relative", 0.4),
    ("box", "ours", "lights=same", "error/relative", 0.1),
    ("box", "ours", "seed=0", "psnr", 30.0),
    ("den", "ours", "lights=odd", "error/relative", 0.2),
    ("den", "ours", "lights=odd", "error/other", math.nan),
]


@pytest.fixture
def reports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "reports" / "paper" / "fails"
    folder.mkdir(parents=True)
    rows = [dict(zip(("scene", "method", "variant", "metric", "value"), row, strict=True)) for row in ROWS]
    pd.DataFrame(rows, columns=COLUMNS).to_csv(folder / "results.csv", index=False)
    return tmp_path / "reports"


def cells(reports, *changes):
    given = {"rows": {"ours": "Ours"}, "columns": {"light": "Light", "view": "View"},
             "cells": [CELL | change for change in changes]}  # fmt: skip
    return read_matrix(reports / "m.yaml", given, reports).cells


def test_the_worst_of_a_place_is_the_furthest_past_its_threshold(reports):
    given = {"rows": {"ours": "Ours"}, "columns": {"light": "Light"}, "cells": [
        CELL | {"good": 0.1, "bad": 0.3, "says": "a third past"},
        CELL | {"against": {"variant": "lights=same"}, "good": 1.0, "bad": 2.0, "says": "twice past"},
        CELL | {"good": 0.3, "bad": 0.6, "says": "on the way"},
    ]}  # fmt: skip
    matrix = read_matrix(reports / "m.yaml", given, reports)
    assert [cell.note for cell in matrix.at("ours", "light")] == ["twice past", "a third past", "on the way"]


@pytest.mark.parametrize(
    ("change", "value", "grade"),
    [
        ({}, 0.4, "holds"),
        ({"against": {"variant": "lights=same"}}, 4.0, "fails"),
        ({"against": {"variant": "lights=same"}, "bad": 5.0}, 4.0, "degrades"),
        ({"against": {"scene": "den"}, "by": "difference", "good": 0.1, "bad": 0.3}, 0.2, "degrades"),
        ({"good": 0.5, "bad": 0.4}, 0.4, "fails"),  # lower is worse
        ({"at": CELL["at"] | {"scene": "hall"}}, math.nan, "missing"),
        ({"at": CELL["at"] | {"scene": "den", "metric": "error/other"}}, math.nan, "missing"),
        ({"against": {"variant": "lights=none"}}, math.nan, "missing"),
        ({"report": "paper/never"}, math.nan, "missing"),
    ],
)
def test_a_figure_and_its_grade(reports, change, value, grade):
    (found,) = cells(reports, change)
    assert found.value == pytest.approx(value, nan_ok=True) and found.grade == grade


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"row": "our"}, "unknown row 'our'; did you mean ours"),
        ({"god": 1}, "unknown key 'god'; did you mean good"),
        ({"bad": 1.5}, "good and bad are both 1.5"),
        ({"by": "sum"}, "by='sum' is not one of ratio, difference"),
        ({"at": {"variant": "lights=odd", "metric": "error/relative"}}, "2 rows of .* are meant; name scene"),
        ({"at": {"scenes": "box"}}, "unknown key 'scenes'"),
    ],
)
def test_mistakes(reports, change, words):
    with pytest.raises(PrtError, match=words):
        cells(reports, change)


def test_a_cell_without_a_reason_is_a_mistake(reports):
    bare = {key: value for key, value in CELL.items() if key != "because"}
    given = {"rows": {"ours": "Ours"}, "columns": {"light": "Light"}, "cells": [bare]}
    with pytest.raises(PrtError, match="ours/light has no because"):
        read_matrix(reports / "m.yaml", given, reports)


def test_the_report(reports, tmp_path, capsys):
    content = {
        "title": "Where things fail",
        "matrix": {
            "rows": {"ours": "Ours"},
            "columns": {"light": "Light", "view": "View", "state": "State", "seeds": "Seeds"},
            "cells": [
                CELL,
                CELL | {"against": {"variant": "lights=same"}},
                CELL | {"column": "view", "report": "paper/never"},
                {"row": "ours", "column": "state", "not": "nothing moves"},
            ],
        },
    }
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "fails.yaml").write_text(yaml.safe_dump(content))
    assert main(["table", "fails"]) == 0
    assert "Ours: 1 fails, 1 not measured" in capsys.readouterr().out
    folder = reports / "fails"
    text = (folder / "report.md").read_text()
    assert "| Ours | [✘ 4](../paper/fails/report.md) | ? | – | ? |" in text, (
        "the worst cell of a place is shown"
    )
    assert "no report paper/never" in text and "not measured: Seeds" in text and "nothing moves" in text
    assert list(read_results(folder / "results.csv")["value"]) == [0.4, 4.0]
    drawn = (folder / "matrix.svg").read_text()
    assert "✘ 4 error under odd lights (holds up to 1.5, fails from 3)" in drawn
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert main(["table", "fails"]) == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == files
    elsewhere = tmp_path / "far" / "off"
    assert main(["table", "fails", f"report={elsewhere}"]) == 0
    written = (elsewhere / "report.md").read_text()
    target = re.search(r"\[✘ 4\]\((.*?)\)", written)
    assert target and (elsewhere / target[1]).resolve().parent == (reports / "paper" / "fails").resolve()
    assert main(["table", "fails", "scene=box"]) == 2
    assert "takes only report=<folder>" in capsys.readouterr().err


def test_the_projects_own_matrix_reads(tmp_path):
    """Every cell is well-formed, and a report that is there has its figure."""
    from omegaconf import OmegaConf

    from prt.bench.spec import find

    path = find("stability/all")
    root = path.parents[2] / "reports"
    matrix = read_matrix(path, OmegaConf.to_container(OmegaConf.load(path))["matrix"], root)
    for cell in matrix.cells:
        assert cell.grade != "missing" or not (root / cell.report / "results.csv").exists(), cell
    assert sum(cell.grade == "none" for cell in matrix.cells) > 5
    assert set(matrix_report.SIGNS) == set(matrix_report.COLOURS) == set(matrix_report.MARKS)


def test_spread_over_seeds(tmp_path):
    cells = [make_run(tmp_path, "box", "neural_prt", seed=k, psnr=26 + k, spread=0.0) for k in range(3)]
    table = summarise(cells, read_images(cells))
    rows = table[(table.metric == "spread/psnr") & (table.split == "far") & (table.component == "indirect")]
    assert rows[rows.variant == ""]["value"].tolist() == [pytest.approx(1.0)] and (rows["seeds"] == 3).all()
    alone = summarise(cells[:1], read_images(cells[:1]))
    assert not alone["metric"].str.startswith("spread/").any()

"""The advice of ``prt needs`` against full sweeps whose right size is known."""

from pathlib import Path

import pandas as pd
import pytest
import sized

from prt.bench import needs
from prt.bench.advised import nearest_rung
from prt.bench.compose import compose
from prt.bench.results import Cell
from prt.bench.run import folder_of
from prt.cli import main
from prt.errors import PrtError
from prt.methods import advice
from prt.methods.advice import Advice

TABLE = """title: All sizes
grid: {scene: [fake], method: [sized@ladder, fake]}
common: [task=fake, lighting=fake, budget=smoke, device=cpu, run.denoise=false, "run.metrics=[psnr]"]
columns: {metrics: [psnr], components: [indirect]}
enough: {x: bytes/model, y: psnr/indirect, within: 0.5}
advice: {}
"""


@pytest.fixture
def judged(tmp_path, monkeypatch):
    """Calls ``prt table`` with this advice; returns the line of advice.csv and the report's text."""
    sized.use(tmp_path, monkeypatch)
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "all.yaml").write_text(TABLE)

    def call(*overrides: str) -> tuple[pd.Series, str]:
        given = [Advice("task=fake", "so"), *(Advice(word, "so") for word in overrides)]
        monkeypatch.setattr(needs, "measured", lambda cfg: [])
        monkeypatch.setattr(advice, "advise", lambda task, found: given)
        assert main(["table", "all"]) == 0
        report = tmp_path / "reports" / "all"
        return pd.read_csv(report / "advice.csv").iloc[0], (report / "report.md").read_text()

    return call


def test_advice_on_the_knee(judged):
    row, text = judged("method=sized", "method.width=8")
    assert (row["variant"], row["knee"], row["steps"], row["enough"]) == ("width=8", "width=8", 0, True)
    assert row["rival"] == "sized" and row["rival_variant"] == "width=8"
    assert "on the knee" in text and "On the knee in 1 of 1 scenes, large enough in 1" in text
    assert "`method.width=8`" in text


@pytest.mark.parametrize(
    ("width", "rung", "steps", "enough", "says"),
    [
        (2, "width=2", -2, False, "-2 sizes, 0.25 times, 20 worse"),
        (50, "width=64", 3, True, "+3 sizes, 8 times"),
    ],
)
def test_how_far_off(judged, width, rung, steps, enough, says):
    row, text = judged("method=sized", f"method.width={width}")
    assert (row["variant"], row["steps"], row["enough"]) == (rung, steps, enough)
    assert says in text and "On the knee in 0 of 1 scenes" in text


def test_advice_that_the_sweep_lacks_is_said(judged):
    row, text = judged("method=wavelet_neural", "method.wavelets=64")
    assert pd.isna(row["variant"]) and pd.isna(row["steps"])
    assert "not in this sweep" in text and "in 0 of 0 scenes" in text


def test_sizes_are_compared_in_powers_of_two_and_logarithms_as_numbers(tmp_path, monkeypatch):
    common = [
        "task=relight_indirect",
        "budget=smoke",
        "lighting=procedural",
        "scene=four_shapes",
        "method=wavelet_neural",
    ]

    def cells(*rungs: str):
        for rung in rungs:
            words = [*common, *rung.split()]
            cfg = compose(words)
            yield Cell("four_shapes", "wavelet_neural", rung, 0, "smoke", folder_of(cfg), tuple(words)), cfg

    found = list(cells("method.wavelets=8", "method.wavelets=32", "method.wavelets=128"))
    assert nearest_rung(found, ["method.wavelets=60"]) == "method.wavelets=32"
    assert nearest_rung(found, ["method.wavelets=70"]) == "method.wavelets=128"
    assert nearest_rung(found[:1], ["method.wavelets=8"]) is None, "one size is no sweep"
    tables = list(
        cells("method.wavelets=16 method.grid.log2_table=10", "method.wavelets=32 method.grid.log2_table=14")
    )
    # four doublings of the table weigh more than one of the wavelets
    assert nearest_rung(tables, ["method.wavelets=16", "method.grid.log2_table=14"]) == tables[1][0].variant


def test_advice_needs_what_is_enough_and_scenes_of_the_table(judged, tmp_path, capsys):
    path = Path("experiments/all.yaml")
    path.write_text(TABLE.replace("enough: ", "chart: ").replace(", within: 0.5", ""))
    assert main(["table", "all"]) != 0
    assert "advice is judged against what is enough" in capsys.readouterr().err
    path.write_text(TABLE.replace("advice: {}", "advice: {scenes: [other]}"))
    assert main(["table", "all"]) != 0
    assert "no scene 'other'; choose from fake" in capsys.readouterr().err


def test_a_scene_that_cannot_be_measured_costs_no_report(judged, monkeypatch, capsys):
    def failing(cfg):
        raise PrtError("no lights")

    monkeypatch.setattr(needs, "measured", failing)
    assert main(["table", "all"]) == 0
    assert "fake: no advice to judge: no lights" in capsys.readouterr().err
    assert "advises" not in Path("reports/all/report.md").read_text()

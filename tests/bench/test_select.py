"""``prt select`` and capacity ladders, on methods and scenes whose answer is known."""

import re
from pathlib import Path

import pytest
import sized
import tiny
import torch
from fakes import CHOICE

from prt.bench import ladder, select, table
from prt.bench.compose import compose
from prt.bench.exr import write_exr
from prt.bench.results import read_results
from prt.bench.run import folder_of
from prt.bench.run_folder import find_runs
from prt.bench.target import Target
from prt.cli import main
from prt.errors import PrtError


@pytest.fixture
def words(tmp_path, monkeypatch):
    """Overrides that choose the sized method and keep all in a folder of this test."""
    sized.use(tmp_path, monkeypatch)
    return [*(word for word in CHOICE if not word.startswith("method=")), "method=sized"]


def test_the_smallest_that_meets_the_target_and_no_larger_one_is_run(words, capsys):
    assert select.main([*words, "target=psnr/indirect>=31"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"width=4 .*<- chosen", out) and "width=8" not in out
    assert re.search(r"^prt run .*method=sized method.width=4", out, re.M)
    assert len(find_runs(Path("runs"))) == 3
    report = Path("reports/select/fake_fake_sized")
    text = (report / "report.md").read_text()
    assert "width=4: the smallest that meets" in text and '"target=psnr/indirect>=31"' in text
    assert "prt select" in text and b"target" in (report / "chart.svg").read_bytes()
    assert set(read_results(report / "results.csv").variant) >= {"width=1", "width=2", "width=4"}


def test_a_walk_goes_on_where_it_was_and_reads_what_is_done(words, capsys):
    select.main([*words, "target=psnr/indirect>=15"])
    before = {run.path for run in find_runs(Path("runs"))}
    select.main([*words, "target=psnr/indirect>=31"])
    assert "done already" in capsys.readouterr().err
    assert before < {run.path for run in find_runs(Path("runs"))}
    assert folder_of(compose([*words, "method.width=4"])).done, "a rung is a run as any other"


def test_a_walk_ends_where_rungs_bring_nothing_more(words, capsys):
    assert select.main([*words, "target=psnr/indirect>=60"]) == 1
    out = capsys.readouterr().out
    assert "no rung meets psnr/indirect>=60" in out and "width=32" in out and "width=64" not in out


def test_the_best_that_a_size_allows_is_the_smallest_as_good(words, capsys):
    assert select.main([*words, "target=bytes/model<=40000"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"width=8 .*<- chosen", out) and "width=64" in out, "the first that is too large is seen"
    assert select.main([*words, "target=bytes/model<=10"]) == 1
    assert "the smallest rung costs more" in capsys.readouterr().out


def test_a_scene_whose_transport_has_rank_three_needs_three_terms(words, capsys):
    words = [word for word in words if not word.startswith(("method=", "task="))]
    assert select.main([*words, "task=ranked", "method=ranked", "target=psnr/indirect>=90"]) == 0
    assert re.search(rf"terms={sized.RANK} .*<- chosen", capsys.readouterr().out)


def test_a_diffuse_convex_object_needs_nine_coefficients(tmp_path, monkeypatch, capsys):
    """Ramamoorthi and Hanrahan 2001: irradiance has nearly all its energy below degree 3."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "round_thing.py").write_text("def distance(p):\n    return p.norm(dim=-1) - 1.0\n")
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "cache"))
    sun = torch.full((8, 16, 3), 0.2)
    sun[1:3, 4:6] = 8.0
    write_exr(tmp_path / "sun.exr", sun)
    done = select.main([
        "task=relight_direct", "scene=sdf", "scene.function=round_thing:distance", "method=cast_prt",
        "budget=smoke", "device=cpu", *tiny.lights(tiny.write_maps(tmp_path / "maps"), tmp_path / "sun.exr"),
        "over=task.order=1,2,3,4", "task.materials=[diffuse]", "task.reference=truth", "task.views=4",
        "task.size=16", "task.directions=256", "task.truth_samples=1024", "task.split_views=0",
        "run.denoise=false", "run.metrics=[psnr]", "target=psnr/direct>=35",
    ])  # fmt: skip
    out = capsys.readouterr().out
    assert done == 0 and re.search(r"order=3 .*<- chosen", out), out


def test_a_ladder_in_a_grid(words, tmp_path):
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "all.yaml").write_text(
        "title: All sizes\ngrid: {scene: [fake], method: [sized@ladder, fake]}\n"
        "common: [task=fake, lighting=fake, budget=smoke]\n"
    )
    spec = table.load_spec("all")
    assert spec.grid["method"] == [*(f"sized method.width={k}" for k in sized.ERROR), "fake"]
    cells = table.resolve(spec)
    assert [cell.variant for cell, _ in cells][:2] == ["width=1", "width=2"]


def test_a_ladder_is_no_setting(words):
    assert "_ladder_" not in compose(words).method
    with pytest.raises(PrtError, match="unknown setting 'method.ladder'"):
        compose([*words, "method.ladder=1"])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "no target"),
        (["target=psnr/indirect"], "in quotes"),
        (["target=psnr/indirect<=30"], "better when it is higher; write >="),
        (["target=sharpness/indirect>=3"], "no figure of a run"),
        (["target=psnr/indirect>=3", "method=fake"], "method/fake.yaml has no _ladder_"),
        (["target=psnr/indirect>=3", "method=odd"], "must be a list of overrides"),
        (["target=psnr/indirect>=3", "over=method.width"], "one setting and its values"),
        (["target=psnr/indirect>=3", "over=method.wdth=1,2"], "unknown setting 'method.wdth'"),
        (["target=psnr/indirect>=3", "split=elsewhere"], "splits with it: far, near"),
        (["target=ssim/indirect>=0.5"], "has no ssim/indirect"),
    ],
)
def test_mistakes_in_one_line(words, more, said, capsys):
    assert main(["select", *words, *more]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert said in error and error.startswith("prt: error: ")


def test_a_target_is_met_within_one_standard_error():
    quality, cost = Target.parse("psnr/indirect>=35"), Target.parse("time/shade <= 0.01")
    assert quality.met(34.9, 0.2) and not quality.met(34.9, 0.05) and not quality.of_cost
    assert cost.met(0.009) and not cost.met(0.011) and cost.of_cost and str(cost) == "time/shade<=0.01"


def test_every_ladder_composes():
    """The rungs in conf/ are real settings of their methods, smallest first."""
    tasks = {"svd_transfer": "local_lights", "sh_vertex": "local_lights", "dynamic_radiosity": "animate"}
    direct = ("learnt_sh", "texture_prt", "irradiance_volume")
    found = 0
    for path in sorted(Path(ladder.compose.conf_folder() / "method").glob("*.yaml")):
        if "_ladder_" in path.read_text():
            task = tasks.get(path.stem, "relight_direct" if path.stem in direct else "relight_indirect")
            values = ladder.expand([f"{path.stem}@ladder"], [f"task={task}"])
            for value in values:
                name, *overrides = value.split()
                compose([f"task={task}", f"method={name}", *overrides])
            found += 1
    assert found >= 8

"""The speed-accuracy chart: directions from the metric, a true Pareto front, reproducible files."""

import xml.etree.ElementTree as ET

import matplotlib.image
import numpy as np
import pytest
from synthetic_runs import make_run

from prt.bench import chart
from prt.bench.chart import Axis, Point, draw, pareto, points
from prt.bench.layout import Layout
from prt.bench.results import read_images, summarise
from prt.errors import PrtError

METHODS = ("wavelet_neural", "neural_prt", "path_traced")
PLAN = Layout(["box", "den"], [(m, "") for m in METHODS], as_is=["path_traced"])


@pytest.fixture
def results(tmp_path):
    cells = [make_run(tmp_path, scene, method) for scene in ("box", "den") for method in METHODS]
    return summarise(cells, read_images(cells))


def point(x: float, y: float) -> Point:
    return Point("s", f"{x}/{y}", "", False, x, y, x, y, y)


def test_pareto_front_follows_both_directions():
    cloud = [point(1, 20), point(2, 30), point(3, 25), point(4, 31), point(2, 28)]
    assert [(p.x, p.y) for p in pareto(cloud, "lower", "higher")] == [(1, 20), (2, 30), (4, 31)]
    assert [(p.x, p.y) for p in pareto(cloud, "lower", "lower")] == [(1, 20)]
    assert [(p.x, p.y) for p in pareto(cloud, "higher", "higher")] == [(4, 31)]


def test_points_carry_their_figures(results):
    found = points(results, PLAN, Axis.parse("time/frame"), Axis.parse("psnr/indirect"), "far")
    assert len(found) == 2 * (2 + 2 + 1)  # as it renders and denoised; path_traced only as it renders
    plain, denoised = (p for p in found if p.scene == "box" and p.method == "wavelet_neural")
    assert (plain.x, plain.x_hi) == (pytest.approx(0.083), pytest.approx(0.0996))
    assert denoised.x == pytest.approx(0.093) and denoised.y == pytest.approx(plain.y + 0.8)
    assert plain.y_lo < plain.y < plain.y_hi


def arrow(figure) -> np.ndarray:
    """From the arrow's tail to its tip, in axes fractions."""
    note = next(t for t in figure.axes[0].texts if getattr(t, "arrow_patch", None) is not None)
    return np.subtract(note.xy, note.xyann)


def test_better_arrow_follows_the_metric(results):
    assert (np.sign(arrow(draw(results, PLAN, {"x": "time/frame", "y": "psnr/indirect"}))) == [-1, 1]).all()
    assert (np.sign(arrow(draw(results, PLAN, {"x": "time/frame", "y": "lpips/indirect"}))) == [-1, -1]).all()
    assert (np.sign(arrow(draw(results, PLAN, {"x": "ssim/full", "y": "psnr/full"}))) == [1, 1]).all()


def test_one_panel_a_scene_one_look_a_method(results):
    figure = draw(results, PLAN, {}, "Times on a test CPU.")
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["Box", "Den"]
    assert all(axis.get_xscale() == "log" for axis in figure.axes)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:3] == ["wavelet neural", "neural prt", "path traced"] and "Pareto front" in labels
    assert any("test CPU" in text.get_text() for text in figure.texts)


def test_files_are_whole_and_the_same_again(results, tmp_path):
    files = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        chart.write(draw(results, PLAN, {}), folder)
        files.append([(folder / f).read_bytes() for f in ("chart.svg", "chart.png")])
    assert files[0] == files[1]
    assert ET.fromstring(files[0][0]).tag.endswith("svg")
    pixels = matplotlib.image.imread(tmp_path / "one" / "chart.png")
    assert min(pixels.shape[:2]) > 300 and pixels[..., :3].std() > 0.02


def test_points_of_the_svg_say_what_they_are(results, tmp_path):
    figure = draw(results, PLAN, {})
    chart.write(figure, tmp_path)
    text = (tmp_path / "chart.svg").read_text()
    circles = ET.fromstring(text).findall(".//{*}circle")
    found = points(results, PLAN, Axis.parse("time/frame"), Axis.parse("psnr/indirect"), "far")
    assert len(circles) == len(found) == 10 and len({c.get("id") for c in circles}) == 10
    titles = [circle.findtext("{*}title") for circle in circles]
    first = found[0]
    assert titles[0].splitlines() == [
        "wavelet neural, Box",
        f"PSNR, indirect (dB): {first.y:.4g} [{first.y_lo:.4g}, {first.y_hi:.4g}]",
        f"time per frame (ms): {first.x * 1e3:.4g}, 95th percentile {first.x_hi * 1e3:.4g}",
    ]
    assert titles[1].startswith("wavelet neural (denoised), Box\n")
    # each lies on its marker: a shape of the point's colour is drawn right there
    drawn = [u for u in ET.fromstring(text).iter("{http://www.w3.org/2000/svg}use") if u.get("x")]
    places = np.array([[float(u.get("x")), float(u.get("y"))] for u in drawn])
    for circle in circles:
        at = [float(circle.get("cx")), float(circle.get("cy"))]
        assert np.abs(places - at).max(axis=1).min() < 0.01
        assert "fill: none" in circle.get("style")  # nothing of it is seen


@pytest.fixture
def ladder(tmp_path):
    """One method at three sizes, the larger the slower and the better, and a method without variants."""
    sizes = {"basis=4": 24.0, "basis=16": 30.0, "basis=64": 33.0}
    cells = [
        make_run(tmp_path, "box", "svd", variant=v, psnr=psnr, shade=0.01 * (i + 1), denoise=False)
        for i, (v, psnr) in enumerate(sizes.items())
    ]
    cells.append(make_run(tmp_path, "box", "neural_prt", denoise=False))
    plan = Layout(["box"], [(c.method, c.variant) for c in reversed(cells)], labels={"svd": "SVD"})
    return summarise(cells, read_images(cells)), plan


def test_variants_of_one_method_are_one_ladder(ladder):
    results, plan = ladder
    found = points(results, plan, Axis.parse("time/frame"), Axis.parse("psnr/indirect"), "far")
    ((key, rungs),) = chart.ladders(found).items()
    assert key == ("box", "svd", False)
    assert [p.variant for p in rungs] == ["basis=4", "basis=16", "basis=64"]  # not in the grid's order
    figure = draw(results, plan, {})
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[:2] == ["neural prt", "SVD (basis)"]
    (axis,) = figure.axes
    assert {"4", "16", "64"} <= {text.get_text() for text in axis.texts}
    joined = [line for line in axis.lines if len(line.get_xdata()) == 3 and line.get_alpha() == 0.7]
    assert len(joined) == 1 and np.all(np.diff(joined[0].get_xdata()) > 0)
    assert joined[0].get_color() == chart.COLOURS[1]


def test_variants_are_named_by_what_changes():
    assert chart.varying(["basis=4,lambda=0.1", "basis=8,lambda=0.1"]) == ["basis"]
    assert chart.varying(["", "wavelets=16"]) == ["wavelets"] and chart.varying(["basis=4"]) == []
    assert chart.rung_name("basis=4,lambda=0.1", ["basis"]) == "4"
    assert chart.rung_name("", ["wavelets"]) == "–"


def test_costs_stand_on_either_axis_in_their_own_unit(results):
    figure = draw(results, PLAN, {"x": "bytes/model", "y": "time/shade"})
    assert figure.axes[0].get_xlabel() == "model size (MB)"
    assert figure.axes[0].get_ylabel().startswith("time to shade a frame (ms)")
    low, high = figure.axes[0].get_ylim()
    assert low < 20 and 80 < high < 200
    assert Axis.parse("time/measure").label == "time to measure (ms)"
    assert Axis.parse("rmse/bound/indirect").label == "RMSE bound, indirect (radiance)"


def test_nothing_to_draw_and_wrong_axes(results):
    assert draw(results[results["metric"] != "time/frame"], PLAN, {}) is None
    with pytest.raises(PrtError, match="psnr/everything"):
        draw(results, PLAN, {"y": "psnr/everything"})


def test_a_chart_of_some_variants_and_a_long_legend_that_leaves_the_panel_its_width(tmp_path):
    cells = [
        make_run(tmp_path, "box", "svd", variant=variant, shade=0.01 * n)
        for n, variant in enumerate(("basis=4,rays=1", "basis=16,rays=1", "basis=4,rays=2"), start=1)
    ]
    long = "A method whose name is much longer than anybody would ever wish it to be"
    plan = Layout(["box"], [(c.method, c.variant) for c in cells], labels={"svd": long}, as_is=["svd"])
    results = summarise(cells, read_images(cells))
    whole, some = (chart.draw(results, plan, {"where": where}) for where in ({}, {"rays": 1}))
    assert len(whole.titles) == 3 and len(some.titles) == 2
    assert all("rays=1" in title for *_, title in some.titles)
    whole.canvas.draw()
    assert whole.axes[0].get_window_extent().width / whole.dpi > 2.2
    assert chart.draw(results, plan, {"where": {"rays": 3}}) is None

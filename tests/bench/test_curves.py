"""Line charts over a setting: which figures make which line, how they are told apart, equal files."""

import xml.etree.ElementTree as ET

import matplotlib.image
import pandas as pd
import pytest

from prt.bench import curve_charts
from prt.bench.curves import lines, parse_curves
from prt.bench.layout import Layout
from prt.bench.results import COLUMNS
from prt.errors import PrtError

NONE = float("nan")
BASIS = (4, 16, 64)
SCENES = ("box", "den")
BASE = {"file": "error", "x": "basis", "y": ["rmse/indirect", "rmse/bound/indirect"], "split": "same"}


def row(scene, variant, metric, value, split="same", component="indirect", method="svd", **more):
    keys = (scene, method, variant, "laptop", "a CPU", split, component, metric)
    figures = {"value": value, "lo": 0.9 * value, "hi": 1.1 * value, "n": 9, "seeds": 1, "published": NONE}
    return dict(zip(COLUMNS, keys, strict=False)) | figures | more


@pytest.fixture
def results() -> pd.DataFrame:
    """RMSE 1 / basis and its bound, half of it; slower with the basis; two lambdas, of which 1 is worse."""
    rows = []
    for scene in SCENES:
        for lam in ("0.01", "1"):
            for n in reversed(BASIS):
                variant = f"basis={n},lambda={lam}"
                for split, worse in (("same", 1), ("points", 3)):
                    error = worse * (2 if lam == "1" else 1) / n
                    rows += [row(scene, variant, "rmse", error, split),
                             row(scene, variant, "rmse/bound", error / 2, split)]  # fmt: skip
                rows.append(row(scene, variant, "time/shade", 0.001 * n, "", "", lo=NONE))
                rows.append(row(scene, variant + ",denoised", "rmse", 9.0))
    rows.append(row("box", "basis=16,lambda=0.01", "rmse", NONE, published=0.05))
    rows.append(row("box", "", "rmse", 0.3, method="nprt"))
    return pd.DataFrame(rows, columns=COLUMNS)


def plan(results: pd.DataFrame) -> Layout:
    pairs = zip(results["method"], results["variant"].str.removesuffix(",denoised"), strict=True)
    return Layout(list(SCENES), list(dict.fromkeys(pairs)), labels={"svd": "SVD"}, splits=["same", "points"])


def curve(**settings):
    return parse_curves([BASE | settings])[0]


def test_a_line_holds_its_own_figures_in_the_order_of_x(results):
    found = lines(results, plan(results), curve(where={"lambda": 0.01}), "same")
    assert [(o.place["scene"], o.style) for o in found] == [("box", 0), ("box", 1), ("den", 0), ("den", 1)]
    first = found[0]
    assert [p[0] for p in first.measured] == list(BASIS)
    assert [p[1] for p in first.measured] == pytest.approx([1 / n for n in BASIS])
    assert first.measured[1][2:] == pytest.approx((0.9 / 16, 1.1 / 16))
    assert [p[1] for p in found[1].measured] == pytest.approx([0.5 / n for n in BASIS])
    assert first.published == [(16.0, 0.05)] and found[2].published == []


def test_split_where_and_denoised_choose(results):
    layout = plan(results)
    other = lines(results, layout, curve(split="points", where={"lambda": "1e-2"}), "same")
    assert other[0].measured[0][1] == pytest.approx(3 / 4)
    default = lines(results, layout, curve(split=None, where={"lambda": 1, "scene": "den"}), "points")
    assert len(default) == 2 and default[0].measured[0][1] == pytest.approx(6 / 4)
    both = lines(results, layout, curve(where={"lambda": [0.01, 1], "scene": "box"}), "same")
    assert len(both) == 4
    filtered = lines(results, layout, curve(where={"denoised": True, "scene": "box"}), "same")
    assert {p[1] for line in filtered for p in line.measured} == {9.0}


def test_costs_have_no_split_and_their_own_unit(results):
    (line,) = lines(
        results, plan(results), curve(y="time/shade", where={"lambda": 1, "scene": "box"}), "same"
    )
    assert [p[1] for p in line.measured] == pytest.approx(list(BASIS))  # milliseconds
    figure = curve_charts.draw(results, plan(results), curve(y="time/shade"), "same")
    assert figure.axes[0].get_ylabel() == "time to shade a frame (ms)"


def texts(figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_colour_a_scene_and_a_dash_a_metric(results):
    wanted = curve(group="scene", where={"lambda": 0.01}, log=["x", "y"], title="Figure 14",
                   labels={"rmse/bound/indirect": "projected", "x": "basis vectors"})  # fmt: skip
    figure = curve_charts.draw(results, plan(results), wanted, "same")
    (axis,) = figure.axes
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")
    assert axis.get_xlabel() == "basis vectors" and "same lights" in axis.get_ylabel()
    assert [t for t in axis.get_xticks()] == list(BASIS) and figure.get_suptitle() == "Figure 14"
    drawn = [line for line in axis.lines if len(line.get_xdata()) == 3]
    assert [line.get_linestyle() for line in drawn] == ["-", "--", "-", "--"]
    assert drawn[0].get_color() == drawn[1].get_color() != drawn[2].get_color()
    assert texts(figure) == ["Box", "Den", "RMSE, indirect (radiance)", "projected", "published"]
    assert len(axis.collections) >= 4  # bands


def test_what_is_left_of_the_variant_is_in_the_label(results):
    figure = curve_charts.draw(results, plan(results), curve(y="rmse/indirect", group="scene"), "same")
    assert texts(figure) == [
        "Box, lambda=0.01",
        "Box, lambda=1",
        "Den, lambda=0.01",
        "Den, lambda=1",
        "published",
    ]
    by_token = curve_charts.draw(results, plan(results), curve(y="rmse/indirect", group="lambda"), "same")
    assert [axis.get_title(loc="left") for axis in by_token.axes] == ["Box", "Den"]  # panels by default
    assert texts(by_token)[:2] == ["lambda=0.01", "lambda=1"]


def test_many_groups_never_look_alike():
    scenes = [f"s{i:02d}" for i in range(20)]
    rows = [row(scene, f"basis={n}", "rmse", 1 / n) for scene in scenes for n in BASIS]
    layout = Layout(scenes, [("svd", f"basis={n}") for n in BASIS])
    table = pd.DataFrame(rows, columns=COLUMNS)
    wanted = curve(group="scene", y="rmse/indirect")
    looks = curve_charts.Looks(lines(table, layout, wanted, "same"), layout, wanted)
    assert len({looks.of(line) for line in looks.found}) == 20


def test_points_of_the_svg_say_what_they_are(results, tmp_path):
    wanted = curve(where={"lambda": 0.01, "scene": "box"}, labels={"rmse/bound/indirect": "a < b"})
    curve_charts.write_all([wanted], results, plan(results), tmp_path, "same")
    titles = [node.text for node in ET.parse(tmp_path / "error.svg").findall(".//{*}circle/{*}title")]
    assert len(titles) == 2 * 3 + 1 and len(set(titles)) == 7
    assert titles[0].splitlines() == [
        "SVD, Box",
        "RMSE, indirect (radiance): 0.25 [0.225, 0.275]",
        "basis: 4",
    ]
    assert "SVD, Box, published\nRMSE, indirect (radiance): 0.05\nbasis: 16" in titles
    assert "SVD, Box\na < b: 0.125 [0.1125, 0.1375]\nbasis: 4" in titles


def test_files_are_whole_equal_and_removed_when_no_longer_listed(results, tmp_path):
    layout = plan(results)
    one, two = curve(group="scene"), curve(file="slow", y="time/shade")
    (tmp_path / "chart.svg").write_text("<svg>another's</svg>")
    assert curve_charts.write_all([one, two], results, layout, tmp_path, "same") == []
    names = {"error.svg", "error.png", "slow.svg", "slow.png", "chart.svg"}
    assert {path.name for path in tmp_path.iterdir()} == names
    before = {name: (tmp_path / name).read_bytes() for name in names}
    curve_charts.write_all([one, two], results, layout, tmp_path, "same")
    assert {name: (tmp_path / name).read_bytes() for name in names} == before
    assert ET.fromstring(before["error.svg"]).tag.endswith("svg")
    pixels = matplotlib.image.imread(tmp_path / "error.png")
    assert min(pixels.shape[:2]) > 300 and pixels[..., :3].std() > 0.02
    assert curve_charts.markdown([one, two], tmp_path) == ["![error](error.svg)", "![slow](slow.svg)"]
    # a curve without figures is said to be missing, and its old files go; so do those no longer listed
    notes = curve_charts.write_all([curve(y="psnr/full")], results, layout, tmp_path, "same")
    assert notes == ["no curves error: no results have basis=... and psnr/full"]
    assert {path.name for path in tmp_path.iterdir()} == {"chart.svg"}
    assert curve_charts.markdown([one], tmp_path) == []


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"file": "a/b"}, "plain name"),
        ({"file": "chart"}, "plain name"),
        ({"x": None}, "x .* and y .* must be given"),
        ({"y": "psnr/everything"}, "'psnr/everything' is not an axis"),
        ({"y": ["psnr/full"] * 4}, "at most 3"),
        ({"log": "z"}, "may hold x and y"),
        ({"panels": "method"}, "'method' is not one of none, scene"),
        ({"were": 1}, "unknown key 'were'"),
        ({"where": "lambda=1"}, "where must be pairs"),
    ],
)
def test_mistakes_are_one_line(settings, says):
    with pytest.raises(PrtError, match=says) as error:
        curve(**settings)
    assert "\n" not in str(error.value)


def test_two_curves_cannot_share_a_file_nor_x_be_no_number(results):
    with pytest.raises(PrtError, match="two are written to file 'error'"):
        parse_curves([BASE, BASE])
    results["variant"] = results["variant"].str.replace("basis=64", "basis=all")
    with pytest.raises(PrtError, match="basis=all is no number"):
        lines(results, plan(results), curve(), "same")


def test_labels_on_a_logarithmic_axis_stand_apart():
    assert curve_charts.readable([4, 16, 64])
    assert not curve_charts.readable([0.0023, 0.0031, 0.0034, 0.0088, 0.0089])
    assert not curve_charts.readable([0.0, 1.0]) and not curve_charts.readable([])


@pytest.mark.parametrize(("low", "high", "most"), [(0.05, 200.0, 6), (2.0, 30.0, 8), (20.0, 40.0, 8)])
def test_plain_numbers_on_a_logarithmic_axis(low, high, most):
    from matplotlib.figure import Figure

    from prt.bench.chart import label_log

    axis = Figure().subplots()
    axis.set_xscale("log")
    axis.set_xlim(low, high)
    label_log(axis.xaxis)
    shown = [x for x in axis.xaxis.get_majorticklocs() if low <= x <= high]
    assert 2 <= len(shown) <= most
    assert axis.xaxis.get_major_formatter()(shown[0], 0) == f"{shown[0]:g}"

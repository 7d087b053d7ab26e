"""The figure of images with error maps."""

import dataclasses
import json

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from synthetic_runs import fake_references, make_run, reference

from prt.bench import figure
from prt.bench.layout import Layout
from prt.bench.results import read_images
from prt.errors import PrtError
from prt.metrics.tonemap import exposure_of, to_srgb

METHODS = [("wavelet_neural", ""), ("neural_prt", ""), ("path_traced", "")]
PLAN = Layout(["box"], METHODS, as_is=["path_traced"])


@pytest.fixture
def cells(tmp_path):
    return [make_run(tmp_path, "box", method, images=True) for method, _ in PLAN.methods]


def test_rows_show_what_the_metrics_saw(cells):
    images = read_images(cells)
    settings = {"component": "indirect", "rows": [{"scene": "box", "view": "view1", "lighting": 1}]}
    rows, notes = figure.gather(cells, images, PLAN, settings, fake_references)
    assert notes == [] and len(rows) == 1
    row = rows[0]
    assert (row.split, row.view, row.lighting) == ("far", "view1", "forest")
    assert row.exposure == exposure_of(reference())
    np.testing.assert_allclose(row.reference, to_srgb(reference(), row.exposure))
    assert list(row.pictures) == ["wavelet neural", "neural prt", "path traced"]
    for method, variant in (("wavelet_neural", "denoised"), ("path_traced", "")):
        own = images[
            (images.method == method)
            & (images.variant == variant)
            & (images.view == "view1")
            & (images.lighting == "forest")
            & (images.split == "far")
            & (images.component == "indirect")
            & (images.metric == "psnr")
        ]
        assert row.psnr[method.replace("_", " ")] == own["value"].item()
    errors = {label: np.abs(picture - row.reference).mean() for label, picture in row.pictures.items()}
    assert errors["wavelet neural"] < errors["neural prt"] < errors["path traced"]


def test_columns_that_were_judged_otherwise_do_not_stand_together(cells):
    """A signed distance field in two sizes looks like one scene and is two."""

    def references(cell, split, view, lighting):
        brighter = 1.5 if cell.method == "neural_prt" else 1.0
        return {
            name: brighter * image for name, image in fake_references(cell, split, view, lighting).items()
        }

    rows, notes = figure.gather(cells, read_images(cells), PLAN, {"rows": [{"scene": "box"}]}, references)
    assert rows == [] and len(notes) == 1
    assert "neural prt has another reference" in notes[0] and "a row of its own" in notes[0]


def test_drawn_with_labels_and_the_best_in_bold(cells, tmp_path):
    settings = {"rows": [{"scene": "box", "crops": [[0.1, 0.1, 0.3, 0.3], [0.5, 0.5, 0.3, 0.3]]}]}
    rows, _ = figure.gather(cells, read_images(cells), PLAN, settings, fake_references)
    drawn = figure.draw(rows, PLAN)
    titles = [axis.get_title() for axis in drawn.axes]
    assert "Reference (indirect)" in titles and "neural prt" in titles
    below = {axis.get_xlabel(): axis.xaxis.label.get_fontweight() for axis in drawn.axes if axis.get_xlabel()}
    assert len(below) == 3 and all(text.endswith(" dB") for text in below)
    best = max(below, key=lambda text: float(text.split()[0]))
    assert [text for text, weight in below.items() if weight == "bold"] == [best]
    figure.write(drawn, tmp_path)
    first = (tmp_path / "figure.png").read_bytes()
    assert matplotlib.image.imread(tmp_path / "figure.png").std() > 0.1
    figure.write(figure.draw(rows, PLAN), tmp_path)
    assert (tmp_path / "figure.png").read_bytes() == first


def test_boxes_hold_the_pictures_and_nothing_around_them(tmp_path):
    """Each panel cut out of figure.png by figure.json is the picture itself, enlarged pixel by pixel."""
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 0.8, (12, 16, 3))
    shown = {"a": np.clip(truth + 0.05, 0, 1), "b": np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1)}
    crops = [[0.1, 0.1, 0.4, 0.4]]
    rows = [
        figure.Row("box", "far", "view0", "sky", "full", 2.0, truth, pictures, {"a": 26.0, "b": nan}, crops)
        for pictures, nan in ((shown, float("nan")), ({"b": shown["b"]}, 20.0))
    ]
    plan = Layout(["box"], [("a", ""), ("b", "")])
    rows[1] = dataclasses.replace(rows[1], crops=[])  # crops are framed in the pictures themselves
    figure.write(figure.draw(rows[1:] + rows[1:], plan), tmp_path)
    boxes = json.loads((tmp_path / "figure.json").read_text())
    pixels = matplotlib.image.imread(tmp_path / "figure.png")[..., :3]
    assert (boxes["height"], boxes["width"]) == pixels.shape[:2] and boxes["error_end"] == figure.ERROR_END
    assert [(p["row"], p["column"], p["kind"]) for p in boxes["panels"]] == [
        (row, *panel)
        for row in (0, 1)
        for panel in (("Reference", "picture"), ("b", "picture"), ("b", "error"))
    ]
    error = matplotlib.colormaps["magma"](np.abs(shown["b"] - truth).mean(-1) / figure.ERROR_END)[..., :3]
    for panel, wanted in zip(boxes["panels"], [truth, shown["b"], error] * 2, strict=True):
        x, y, w, h = (panel[name] for name in ("x", "y", "width", "height"))
        cut = pixels[y : y + h, x : x + w]
        down, across = np.meshgrid(
            (np.arange(h) + 0.5) * 12 / h, (np.arange(w) + 0.5) * 16 / w, indexing="ij"
        )
        inside = np.minimum(down % 1, across % 1).clip(max=1) > 0.15  # a pixel's rim may be its neighbour's
        inside &= np.maximum(down % 1, across % 1) < 0.85
        assert np.abs(cut - wanted[down.astype(int), across.astype(int)])[inside].max() < 0.01
        for rim in (cut[0], cut[-1], cut[:, 0], cut[:, -1]):  # no white page, no frame
            assert np.abs(rim[:, None] - wanted.reshape(-1, 3)).max(-1).min(-1).max() < 0.02
    figure.write(figure.draw(rows, plan), tmp_path)
    boxes = json.loads((tmp_path / "figure.json").read_text())
    assert boxes["rows"][0]["psnr"] == {"a": 26.0} and boxes["rows"][1]["psnr"] == {"a": 26.0, "b": 20.0}
    facts = {"scene": "box", "split": "far", "view": "view0", "lighting": "sky", "component": "full"}
    assert boxes["rows"][0].items() >= facts.items() and boxes["rows"][0]["exposure"] == 2.0


def test_rows_of_other_splits_views_and_components_with_labels_of_their_own(tmp_path):
    views = ("lightmap", "frame00")
    cells = [make_run(tmp_path, "box", m, images=True, splits=("same", "points"), views=views)
             for m, _ in PLAN.methods]  # fmt: skip
    entries = [
        {
            "scene": "box",
            "split": "same",
            "view": "lightmap",
            "lighting": "forest",
            "label": "In texture space",
        },
        {"scene": "box", "split": "points", "view": "frame00", "component": "full"},
    ]
    settings = {"component": "indirect", "rows": entries, "columns": ["path_traced", "wavelet neural"]}
    rows, notes = figure.gather(cells, read_images(cells), PLAN, settings, fake_references)
    assert notes == [] and [(r.split, r.view, r.component) for r in rows] == [
        ("same", "lightmap", "indirect"), ("points", "frame00", "full")
    ]  # fmt: skip
    assert list(rows[0].pictures) == ["path traced", "wavelet neural"]
    drawn = figure.draw(rows, PLAN, settings)
    titles = [axis.get_title() for axis in drawn.axes if axis.get_title() not in ("", "error")]
    assert titles == ["Reference", "path traced", "wavelet neural"]  # the rows show different components
    assert {axis.get_ylabel() for axis in drawn.axes} - {""} == {"In texture space", "Box"}
    facts = [text.get_text() for axis in drawn.axes for text in axis.texts]
    assert "view: frame00 (points)" in facts and "component: full" in facts


def test_columns_and_components_that_are_not_there(cells):
    images = read_images(cells)
    with pytest.raises(PrtError, match="figure.columns: no method 'nprt'"):
        figure.gather(cells, images, PLAN, {"columns": ["nprt"]}, fake_references)
    for cell in cells:
        for path in cell.run.path.rglob("indirect*.exr"):
            path.with_name(path.name.replace("indirect", "direct")).write_bytes(path.read_bytes())
    _, notes = figure.gather(cells, images, PLAN, {"component": "direct"}, fake_references)
    assert "has no component 'direct'; choose from full, indirect" in notes[0]


def test_a_figure_without_psnr_shows_a_dash(cells):
    images = read_images(cells)
    rows, _ = figure.gather(cells, images[images["metric"] != "psnr"], PLAN, {}, fake_references)
    below = [axis.get_xlabel() for axis in figure.draw(rows, PLAN).axes if axis.get_xlabel()]
    assert below == ["–"] * 3


def test_what_cannot_be_shown_is_said(cells, tmp_path):
    images = read_images(cells)
    plan = Layout(["box", "den"], PLAN.methods)
    rows, notes = figure.gather(cells, images, plan, {}, fake_references)
    assert len(rows) == 1 and notes == ["no picture of Den: no finished run has far views of it"]
    settings = {"rows": [{"scene": "box", "view": "view9"}]}
    _, notes = figure.gather(cells, images, plan, settings, fake_references)
    assert "'view9' is not among view0, view1, view2" in notes[0]
    cells[0].run.image_file("far", "view0", "studio", "indirect", True).unlink()
    cells[0].run.image_file("far", "view0", "studio", "indirect", False).unlink()
    rows, notes = figure.gather(cells, images, PLAN, {}, fake_references)
    assert rows == [] and "image not found" in notes[0]
    assert figure.draw([], PLAN) is None


@pytest.mark.parametrize("columns", [1, 3])
def test_the_caption_stays_within_the_picture(cells, columns):
    plan = Layout(["box"], METHODS[:columns])
    rows, _ = figure.gather(cells[:columns], read_images(cells), plan, {}, fake_references)
    drawn = figure.draw(rows, plan)
    (caption,) = drawn.texts
    renderer = FigureCanvasAgg(drawn).get_renderer()
    box = caption.get_window_extent(renderer)
    assert 0 <= box.x0 and box.x1 <= drawn.bbox.width
    pictures = min(axis.get_tightbbox(renderer).y0 for axis in drawn.axes if axis.get_xlabel())
    assert 0 <= box.y0 and box.y1 <= pictures

"""Differences to a table's first row: paired image by image, coloured by what is sure."""

import itertools

import pandas as pd
import pytest

from prt.bench import differences
from prt.bench.layout import Layout
from prt.errors import PrtError
from prt.metrics.intervals import better

PLAN = Layout(
    ["box"], [("ours", ""), ("ours", "size=2"), ("ours", "loss=plain"), ("theirs", "")], splits=["far"]
)
SETTINGS = {"y": "psnr/indirect", "split": "far"}


def figures(offsets):
    """Images of four views and two lights; values differ much from view to view, little from row to row."""
    rows = []
    for (method, variant), offset in offsets.items():
        for view, light in itertools.product(range(4), range(2)):
            value = 20 + 5 * view + light + offset(view)
            place = {"split": "far", "component": "indirect", "metric": "psnr", "seed": 0}
            image = {"view": f"v{view}", "lighting": f"l{light}", "value": value}
            rows.append(place | image | {"scene": "box", "method": method, "variant": variant})
    return pd.DataFrame(rows)


OFFSETS = {
    ("ours", ""): lambda view: 0.0,
    ("ours", "size=2"): lambda view: 1.0 + 0.1 * view,
    ("ours", "loss=plain"): lambda view: -1.0 - 0.1 * view,
    ("theirs", ""): lambda view: 0.5 * (-1) ** view,
}


def test_pairs_are_told_apart_where_means_are_not():
    rows = dict(differences.measured(figures(OFFSETS), PLAN, SETTINGS)["box"])
    assert list(rows) == ["size=2", "loss=plain", "theirs"]
    assert rows["size=2"].mean == pytest.approx(1.15)
    found = {name: better(interval, "higher") for name, interval in rows.items()}
    assert found == {"size=2": "holds", "loss=plain": "fails", "theirs": "undecided"}
    assert better(rows["size=2"], "lower") == "fails"


def test_other_images_are_not_compared():
    images = figures(OFFSETS)
    images = images[~((images["variant"] == "size=2") & (images["view"] == "v3"))]
    assert [name for name, _ in differences.measured(images, PLAN, SETTINGS)["box"]] == [
        "loss=plain",
        "theirs",
    ]
    assert differences.draw(images[images["method"] == "none"], PLAN, SETTINGS) is None


def test_the_picture_says_its_numbers(tmp_path):
    from prt.bench import chart

    drawn = differences.draw(figures(OFFSETS), PLAN, SETTINGS)
    assert drawn is not None
    chart.write(drawn, tmp_path, "differences")
    assert "size=2: +1.15 [" in (tmp_path / "differences.svg").read_text()


def test_an_axis_is_needed():
    with pytest.raises(PrtError, match="y is missing"):
        differences.check({"split": "far"})

"""Trajectories: where they lie, that they never jump, and which settings they refuse."""

import math

import pytest
from omegaconf import OmegaConf

from prt.errors import PrtError
from prt.scene.cameras import circular_sweep, figure_eight, helix, spherical_sweep
from prt.scene.scene import Scene

CENTER = (1.0, 0.5, -2.0)
PLACES = [i / 400 for i in range(400)]

BUILDERS = {
    "sphere all round": lambda: spherical_sweep(CENTER, 3.0, (5, 60), (0, 360), 6.3),
    "sphere in front": lambda: spherical_sweep(CENTER, 3.0, (5, 60), (-40, 40), 6.3),
    "helix all round": lambda: helix(CENTER, 3.0, (0.2, 2.0), (0, 360), 3),
    "helix in front": lambda: helix(CENTER, 3.0, (0.2, 2.0), (-40, 40), 3),
    "circle": lambda: circular_sweep(CENTER, 3.0, 30.0),
    "arc": lambda: circular_sweep(CENTER, 3.0, 30.0, (-40, 40)),
    "eight": lambda: figure_eight(CENTER, 3.0),
}


def angles(view):
    x, y, z = (a - b for a, b in zip(view.origin, CENTER, strict=True))
    return math.degrees(math.atan2(x, z)), math.degrees(math.asin(y / math.dist(view.origin, CENTER)))


@pytest.mark.parametrize("kind", BUILDERS)
def test_path_is_continuous_and_looks_at_center(kind):
    views = BUILDERS[kind]()(PLACES)
    assert len(views) == len(PLACES)
    steps = [math.dist(a.origin, b.origin) for a, b in zip(views, views[1:], strict=False)]
    # the longest path runs 6.3 rounds of 2 pi 3 units in 400 steps: 0.3 a step
    assert 0.0 < max(steps) < 0.35
    assert all(view.target == CENTER for view in views)


@pytest.mark.parametrize("kind", [kind for kind in BUILDERS if "helix" not in kind])
def test_spherical_paths_keep_their_distance(kind):
    for view in BUILDERS[kind]()(PLACES):
        assert math.dist(view.origin, CENTER) == pytest.approx(3.0)


def test_azimuth_zero_is_in_front_and_ninety_on_the_right():
    front, right = (circular_sweep((0, 0, 0), 2.0, 0.0, (a, a))([0.0])[0] for a in (0.0, 90.0))
    assert front.origin == pytest.approx((0.0, 0.0, 2.0))
    assert right.origin == pytest.approx((2.0, 0.0, 0.0))


def test_spherical_sweep_fills_its_ranges_and_no_more():
    found = [angles(view) for view in BUILDERS["sphere in front"]()(PLACES)]
    for axis, (low, high) in enumerate([(-40, 40), (5, 60)]):
        values = [pair[axis] for pair in found]
        assert low - 1e-6 <= min(values) < low + 2 and high - 2 < max(values) <= high + 1e-6


def test_whole_turns_wind_and_rise():
    spiral = [
        angles(view) for view in spherical_sweep(CENTER, 3.0, (0, 60), (0, 360), 2)([0.0, 0.125, 0.25, 0.5])
    ]
    assert spiral[0] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert spiral[1] == pytest.approx((90.0, 7.5))
    assert abs(spiral[2][0]) == pytest.approx(180.0)
    assert spiral[3] == pytest.approx((0.0, 30.0), abs=1e-9)


def test_helix_keeps_its_distance_from_the_axis_and_changes_radius_where_told():
    for view in helix(CENTER, 3.0, (0.2, 2.0))(PLACES):
        assert math.hypot(view.origin[0] - CENTER[0], view.origin[2] - CENTER[2]) == pytest.approx(3.0)
    first, middle = helix(CENTER, (2.0, 4.0), (0.2, 2.0), turns=1)([0.0, 0.5])
    assert first.origin == pytest.approx((1.0, 0.7, 0.0))
    assert middle.origin == pytest.approx((1.0, 0.5 + 1.1, -2.0 - 3.0))


def test_figure_eight_crosses_itself_in_the_middle():
    eight = figure_eight(CENTER, 3.0, (20, 40), (-60, 60))
    crossing = [angles(view) for view in eight([0.0, 0.5])]
    assert crossing[0] == pytest.approx((0.0, 30.0)) and crossing[1] == pytest.approx((0.0, 30.0))
    assert [round(angles(view)[0]) for view in eight([0.25, 0.75])] == [60, -60]


def test_settings_may_come_from_a_config():
    config = OmegaConf.create({"center": [0, 1, 0], "radius": 2, "elevation": [10, 20], "azimuth": [-30, 30]})
    assert len(spherical_sweep(**config)([0.1, 0.2])) == 2


@pytest.mark.parametrize(
    "build, named",
    [
        (lambda: spherical_sweep((0, 0), 2.0), "center"),
        (lambda: spherical_sweep(CENTER, -2.0), "radius"),
        (lambda: spherical_sweep(CENTER, float("nan")), "radius"),
        (lambda: spherical_sweep(CENTER, 2.0, (0, 95)), "elevation"),
        (lambda: spherical_sweep(CENTER, 2.0, turns=0), "turns"),
        (lambda: helix(CENTER, 2.0, "high"), "height"),
        (lambda: circular_sweep(CENTER, 2.0, fov=180), "fov"),
        (lambda: circular_sweep(CENTER, 2.0, azimuth=(0, 90, 180)), "azimuth"),
        (lambda: figure_eight(CENTER, 2.0, azimuth=(0, 360)), "azimuth"),
        (lambda: circular_sweep(CENTER, 2.0, 0.0, target=(1, 9, 0))([0.0]), "up direction"),
    ],
)
def test_wrong_settings_are_named_in_one_line(build, named):
    with pytest.raises(PrtError, match=named) as error:
        build()
    assert "\n" not in str(error.value)


def test_a_scene_needs_trajectories_for_both_splits():
    with pytest.raises(PrtError, match="far"):
        Scene("empty", {"train": [circular_sweep(CENTER, 2.0)]})


def test_near_views_are_none_of_the_training_views():
    paths = [spherical_sweep(CENTER, 3.0, turns=6.37), helix(CENTER, 3.0, (0, 2))]
    scene = Scene("two", {"train": paths, "far": paths[:1]})
    train = scene.views("train", 11, 8)
    near = scene.views("near", 4, 8, train_count=11)
    assert len(train) == 11 and len(near) == 4
    assert min(math.dist(a.origin, b.origin) for a in near for b in train) > 0.05
    assert len({view.origin for view in near}) == 4

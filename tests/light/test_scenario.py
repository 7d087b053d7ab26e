"""Lighting scenarios: what is drawn, from which ranges, and how the YAML files compose."""

import itertools
import math

import numpy as np
import pytest
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light.local import LightRig
from prt.light.scenario import Scenario

CENTRE, HALF = np.array([1.0, 2.0, -3.0]), np.array([0.5, 1.0, 2.0])
RADIUS = float(np.linalg.norm(HALF))
KINDS_AND_PLACES = list(itertools.product(("point", "spot", "directional"), ("around", "inside")))


class Maps:
    """An environment set of three training and two test maps, each of one colour."""

    def train(self):
        return list("abc"), torch.stack([torch.full((6, 2, 2, 3), float(k)) for k in (1, 2, 3)])

    def test(self):
        return list("de"), torch.stack([torch.full((6, 2, 2, 3), float(k)) for k in (100, 200)])


def scenario(**settings) -> Scenario:
    return Scenario(**{"kinds": {"point": 1, "spot": 1, "directional": 1}, "count": (1, 3), **settings})


def rigs(found: Scenario, split: str = "train", count: int = 200, poses: int = 1) -> list[LightRig]:
    return found.rigs(split, count, CENTRE, RADIUS, HALF, poses)[1]


def lights(found: Scenario, split: str = "train", count: int = 200, kind: str | None = None):
    every = [light for rig in rigs(found, split, count) for light in rig.lights]
    return [light for light in every if kind is None or light.kind == kind]


def angle(a, b) -> float:
    return math.degrees(math.acos(float(np.clip(np.dot(a, b), -1, 1))))


def spans(values, low: float, high: float, share: float = 0.8) -> None:
    """All within the range, and over most of it."""
    values, width = np.asarray(values), high - low
    assert (values >= low - 1e-6 * width - 1e-9).all() and (values <= high + 1e-6 * width + 1e-9).all()
    assert np.ptp(values) >= share * width


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_lights_around_lie_on_their_shells(kind):
    found = scenario(distance=(1.5, 2.5), elevation=(-10.0, 60.0), azimuth=(-30.0, 100.0))
    away = np.array([light.position for light in lights(found, kind=kind)]) - CENTRE
    distance = np.linalg.norm(away, axis=1)
    spans(distance / RADIUS, 1.5, 2.5)
    spans(np.degrees(np.arcsin(away[:, 1] / distance)), -10, 60)
    spans(np.degrees(np.arctan2(away[:, 0], away[:, 2])), -30, 100)


def test_lights_around_are_even_over_the_sphere():
    found = scenario(kinds={"point": 1}, count=(1, 1), elevation=(-90.0, 90.0))
    away = np.array([light.position for light in lights(found, count=3000)]) - CENTRE
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    assert np.abs(away.mean(0)).max() < 0.04 and np.abs((away**2).mean(0) - 1 / 3).max() < 0.03


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_lights_inside_lie_in_their_box(kind):
    found = scenario(place="inside", box=((-0.8, 0.2, -0.5), (0.7, 0.9, 0.1)))
    share = (np.array([light.position for light in lights(found, kind=kind)]) - CENTRE) / HALF
    for axis, (low, high) in enumerate(((-0.8, 0.7), (0.2, 0.9), (-0.5, 0.1))):
        spans(share[:, axis], low, high)


@pytest.mark.parametrize("place", ["around", "inside"])
def test_spots_are_turned_to_the_asset(place):
    found = scenario(kinds={"spot": 1}, place=place, aim=0.0, cutoff=(20.0, 35.0), beam=0.6)
    every = lights(found)
    for light in every:
        to_centre = CENTRE - light.position
        assert angle(light.direction, to_centre / np.linalg.norm(to_centre)) < 0.1
        assert math.isclose(light.beam, 0.6 * light.cutoff)
    spans([light.cutoff for light in every], 20, 35)

    # a target somewhere in the box of aim: the line through the light meets that box
    for light in lights(scenario(kinds={"spot": 1}, place=place, aim=0.5)):
        low, high = CENTRE - 0.5 * HALF, CENTRE + 0.5 * HALF
        d = np.array(light.direction)
        first, last = (low - light.position) / d, (high - light.position) / d
        assert np.minimum(first, last).max() <= np.maximum(first, last).min() + 1e-6
    wide = [light.direction for light in lights(scenario(kinds={"spot": 1}, place=place, aim=0.5))]
    assert not np.allclose(wide[: len(every)], [light.direction for light in every], atol=0.05)


@pytest.mark.parametrize("place", ["around", "inside"])
def test_directional_light_comes_from_its_elevations(place):
    found = scenario(place=place, elevation=(10.0, 60.0), azimuth=(-30.0, 100.0))
    back = -np.array([light.direction for light in lights(found, kind="directional")])
    assert np.allclose(np.linalg.norm(back, axis=1), 1)
    spans(np.degrees(np.arcsin(back[:, 1])), 10, 60)
    spans(np.degrees(np.arctan2(back[:, 0], back[:, 2])), -30, 100)


@pytest.mark.parametrize("kind, place", KINDS_AND_PLACES)
def test_colours_and_intensities(kind, place):
    found = scenario(kinds={kind: 1}, place=place, intensity=(0.5, 8.0), saturation=(0.2, 0.6))
    colors = np.array([light.color for light in lights(found, count=400)])
    unit = {"directional": 1.0, "around": (2.0 * RADIUS) ** 2, "inside": (0.5 * RADIUS) ** 2}
    brightest = colors.max(1) / unit["directional" if kind == "directional" else place]
    spans(brightest, 0.5, 8.0)
    assert abs(np.median(brightest) - 2.0) < 0.5  # even in the logarithm: the geometric mean
    spans(1 - colors.min(1) / colors.max(1), 0.2, 0.6)
    assert np.bincount(colors.argmax(1), minlength=3).min() > 200  # every hue


def test_an_intensity_of_one_is_unit_irradiance_at_the_centre():
    found = scenario(kinds={"point": 1}, count=(1, 1), distance=(2.0, 2.0), intensity=(1.0, 1.0))
    (light,) = lights(found, count=1)
    irradiance = light.incident(torch.tensor(CENTRE, dtype=torch.float32)[None])[2]
    assert math.isclose(float(irradiance.max()), 1.0, rel_tol=1e-5)


def test_counts_kinds_and_poses():
    found = scenario(kinds={"point": 3, "spot": 1}, count=(2, 5))
    every = rigs(found, count=400, poses=4)
    assert {len(rig.lights) for rig in every} == {2, 3, 4, 5}
    assert {rig.pose for rig in every} == {0, 1, 2, 3} and {rig.pose for rig in rigs(found)} == {0}
    kinds = [light.kind for rig in every for light in rig.lights]
    assert abs(kinds.count("point") / len(kinds) - 0.75) < 0.05 and "directional" not in kinds


def test_environments_come_from_their_own_split():
    found = scenario(kinds={"environment": 1}, intensity=(0.5, 2.0), environments=Maps(), count=(1, 1))
    train = [float(rig.environment.mean()) for rig in rigs(found)]
    assert min(train) >= 0.5 and max(train) <= 6.0 and np.ptp(train) > 4
    for i, rig in enumerate(rigs(found, "same", 20)):
        value = float(rig.environment[0, 0, 0, 0])
        assert rig.lights == () and bool((rig.environment == value).all())
        which = (100, 200)[i % 2]  # in turn
        assert 0.5 * which <= value <= 2.0 * which
    mixed = scenario(kinds={"environment": 1, "point": 1}, environments=Maps(), count=(3, 3))
    assert any(rig.environment is not None and rig.lights for rig in rigs(mixed))


@pytest.mark.parametrize("split", ["train", "same", "path", "near"])
def test_the_first_ones_are_the_same_for_every_count(split):
    found = scenario(others={"near": {"distance": (0.9, 1.0)}})
    names, few = found.rigs(split, 5, CENTRE, RADIUS, HALF, 3)
    more_names, more = found.rigs(split, 9, CENTRE, RADIUS, HALF, 3)
    assert few == more[:5] and names == more_names[:5] == [f"{split}0{i}" for i in range(5)]
    assert few == rigs(scenario(others={"near": {"distance": (0.9, 1.0)}}), split, 5, 3)
    assert few != rigs(scenario(others={"near": {"distance": (0.9, 1.0)}}, seed=1), split, 5, 3)
    assert len(set(few)) == 5


def test_no_light_is_in_two_splits():
    found = scenario(others={"first": {}, "second": {}})
    sets = [set(lights(found, split)) for split in ("train", "same", "path", "first", "second")]
    for a, b in itertools.combinations(sets, 2):
        assert a and b and not a & b


def test_others_differ_in_what_they_say_and_in_nothing_else():
    found = scenario(kinds={"spot": 1}, cutoff=(20.0, 35.0), others={"near": {"distance": (0.9, 1.0)},
                     "points": {"kinds": {"point": 1}}})  # fmt: skip
    near = lights(found, "near")
    spans([np.linalg.norm(light.position - CENTRE) / RADIUS for light in near], 0.9, 1.0)
    assert {light.kind for light in near} == {"spot"} and {
        len(rig.lights) for rig in rigs(found, "near")
    } == {1, 2, 3}
    spans([light.cutoff for light in near], 20, 35)
    assert {light.kind for light in lights(found, "points")} == {"point"}
    assert {light.kind for light in lights(found)} == {"spot"}


@pytest.mark.parametrize("place", ["around", "inside"])
def test_a_path_moves_slowly(place):
    found = scenario(kinds={"spot": 1}, place=place)
    steps = rigs(found, "path", 30)
    assert all(len(rig.lights) == 1 and rig.environment is None and rig.pose == 0 for rig in steps)
    position = np.array([rig.lights[0].position for rig in steps])
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert (moved > 1e-4 * RADIUS).all() and (moved < 0.06 * RADIUS).all()
    direction = [rig.lights[0].direction for rig in steps]
    assert max(angle(a, b) for a, b in itertools.pairwise(direction)) < 5
    assert angle(direction[0], direction[-1]) > 1
    assert len({(rig.lights[0].color, rig.lights[0].cutoff) for rig in steps}) == 1
    with pytest.raises(PrtError, match="needs point, spot or directional"):
        rigs(scenario(kinds={"environment": 1}, environments=Maps()), "path", 2)


@pytest.mark.parametrize(
    "settings, message",
    [
        (dict(kinds={"area": 1}), "lighting.kinds=.*point, spot, directional, environment"),
        (dict(kinds={}), "lighting.kinds="),
        (dict(kinds={"spot": 0}), "lighting.kinds=.*not all 0"),
        (dict(kinds={"spot": -1, "point": 2}), "lighting.kinds="),
        (dict(kinds={"spot": math.nan}), "lighting.kinds="),
        (dict(kinds={"spot": "much"}), "lighting.kinds="),
        (dict(kinds="spot"), "lighting.kinds=spot"),
        (dict(kinds={"environment": 1}), "lighting.environments is null"),
        (dict(place="above"), "lighting.place='above' is not one of around, inside"),
        (dict(count=(0, 1)), "lighting.count=.*between 1 and 64"),
        (dict(count=(1, 65)), "lighting.count=.*between 1 and 64"),
        (dict(count=(1.5, 2)), "lighting.count=.*whole"),
        (dict(count=2), "lighting.count=2 must be a range"),
        (dict(distance=(2.0, 1.0)), "lighting.distance=.*range"),
        (dict(distance=(0.0, 1.0)), "lighting.distance="),
        (dict(distance=(1.0, math.nan)), "lighting.distance="),
        (dict(distance=("near", "far")), "lighting.distance="),
        (dict(elevation=(10.0, 100.0)), "lighting.elevation=.*between -90 and 90"),
        (dict(azimuth=(-400.0, 0.0)), "lighting.azimuth="),
        (dict(cutoff=(10.0, 90.0)), "lighting.cutoff=.*89.9"),
        (dict(intensity=(0.0, 1.0)), "lighting.intensity="),
        (dict(intensity=(1.0, 2.0, 3.0)), "lighting.intensity="),
        (dict(saturation=(0.0, 1.1)), "lighting.saturation="),
        (dict(beam=0.0), "lighting.beam=0.0"),
        (dict(beam=1.1), "lighting.beam=1.1"),
        (dict(aim=-1.0), "lighting.aim=-1.0"),
        (dict(box=((0, 0, 0),)), "lighting.box="),
        (dict(box=((0, 0, 0), (1, 1))), "lighting.box="),
        (dict(box=((0, 0, 1), (1, 1, 0))), "lighting.box=.*low one first"),
        (dict(others={"train": {}}), "'train' has a meaning of its own"),
        (
            dict(others={"far": {"distanse": (1, 2)}}),
            "lighting.others.far.distanse is not a setting.*distance",
        ),
        (dict(others={"far": {"distance": (2, 1)}}), "lighting.distance="),
        (dict(others={"far": None}), "lighting.others.far=None"),
    ],
)
def test_mistakes_are_one_line(settings, message):
    with pytest.raises(PrtError, match=message) as caught:
        scenario(**settings)
    assert "\n" not in str(caught.value)


def test_an_unknown_split_names_those_that_exist():
    with pytest.raises(PrtError, match="unknown split 'far'.*train, same, path, near"):
        rigs(scenario(others={"near": {}}), "far", 1)


# ---- conf/lighting

FILES = {
    "spots": ("spot", ["points", "directional", "closer", "brighter", "coloured"]),
    "spots_front": ("spot", ["points", "directional", "closer", "brighter", "coloured"]),
    "spots_inside": ("spot", ["points", "closer", "brighter", "coloured"]),
    "points": ("point", ["spots", "directional", "closer", "brighter", "coloured"]),
    "directional": ("directional", ["spots", "points", "coloured"]),
    "environments": ("environment", ["spots", "directional"]),
}


def composed(name: str, *overrides: str):
    return compose(
        ["task=local_lights", "scene=cornell_box", f"lighting={name}", "method=svd_transfer", *overrides]
    )


@pytest.mark.parametrize("name", FILES)
def test_every_file_is_of_its_own_kind_and_no_other(name):
    found = build(composed(name), "lighting")
    kind, others = FILES[name]
    assert [k for k, weight in found.kinds.items() if weight] == [kind]
    assert list(found.others) == others
    for other in found.others.values():
        assert sum(weight > 0 for weight in other.kinds.values()) == 1
    if name != "environments":
        assert {light.kind for light in lights(found, count=20)} == {kind}


def test_directional_light_has_no_way_into_a_closed_room():
    found = build(composed("spots_inside"), "lighting")
    for split in ("train", "same", *found.others):
        for light in lights(found, split, 20):
            assert light.kind != "directional"
            assert (np.abs(light.position - CENTRE) < HALF).all()


def test_environments_compose_with_either_set():
    procedural = build(
        composed("environments", "lighting.environments.train_rooms=3"), "lighting"
    ).environments
    assert type(procedural).__name__ == "ProceduralEnvironments" and procedural.resolution == 16
    hdri = build(composed("environments", "lighting/environments=hdri"), "lighting").environments
    assert type(hdri).__name__ == "HdriFolders" and hdri.resolution == 16


def test_environments_can_be_drawn(own_cache):
    small = [
        f"lighting.environments.{part}=1"
        for part in ("train_rooms", "train_skies", "test_rooms", "test_skies")
    ]
    small += [
        "lighting.environments.resolution=4",
        "lighting.environments.lamps=0",
        "lighting.environments.spp=1",
    ]
    found = build(composed("environments", *small), "lighting")
    train, same = (rigs(found, split, 2) for split in ("train", "same"))
    for rig in train + same:
        assert rig.environment is not None and rig.environment.shape == (6, 4, 4, 3)
        assert bool(rig.environment.isfinite().all()) and float(rig.environment.mean()) > 0
    assert not any(torch.equal(a.environment, b.environment) for a in train for b in same)

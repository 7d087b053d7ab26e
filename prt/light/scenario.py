"""Lighting scenarios (Belcour 2022, section 4.1): random light configurations drawn from stated ranges.

Lengths are in radii of the asset's bounding sphere and places in half extents of its box, so that one
scenario fits assets of any size; intensity 1 gives a unit irradiance at the asset's centre from the middle of
the scenario's distances.
"""

import colorsys
import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from prt.errors import PrtError
from prt.light.local import KINDS, LightRig, LocalLight

ENVIRONMENT = "environment"
#: a fixed number per split: no configuration is drawn twice
SPLIT_SEEDS = {"train": 0, "same": 1, "path": 2}


class Scenario:
    """Random lights around or inside an asset; settings as in ``conf/lighting/spots.yaml``.

    Args:
        kinds: weight of each kind of light: point, spot, directional, environment.
        count: fewest and most lights of one configuration.
        place: ``around`` the asset, on shells about its centre, or ``inside`` its bounding box.
        distance: of lights around, in radii of the bounding sphere.
        elevation, azimuth: degrees; of lights around, and where directional light comes from.
        box: two corners of the region of lights inside, in half extents of the box about its centre.
        aim: spots are turned to a point drawn this far about the centre (in half extents, around and inside).
        cutoff: half angle of spots, degrees; ``beam`` is the share of it that has full intensity.
        intensity: factor on the intensity; drawn evenly in its logarithm.
        saturation: of the colour; the hue is drawn evenly, the brightest channel is 1.
        environments: an environment set that environments are taken from, needed for kind ``environment``.
        others: further scenarios to test on: name to the settings in which it differs from this one.
        seed: of all draws.
    """

    def __init__(
        self,
        kinds: Mapping[str, float],
        count: Sequence[int] = (1, 1),
        place: str = "around",
        distance: Sequence[float] = (1.5, 2.5),
        elevation: Sequence[float] = (-10.0, 80.0),
        azimuth: Sequence[float] = (-180.0, 180.0),
        box: Sequence[Sequence[float]] = ((-0.7, -0.7, -0.7), (0.7, 0.7, 0.7)),
        aim: float = 0.4,
        cutoff: Sequence[float] = (20.0, 35.0),
        beam: float = 0.75,
        intensity: Sequence[float] = (0.5, 2.0),
        saturation: Sequence[float] = (0.0, 0.3),
        environments: Any = None,
        others: Mapping[str, Mapping[str, Any]] | None = None,
        seed: int = 0,
    ):
        if not _weights(kinds):
            raise PrtError(
                f"lighting.kinds={kinds} must give weights of at least 0, not all 0, to some of "
                f"{', '.join((*KINDS, ENVIRONMENT))}"
            )
        if place not in ("around", "inside"):
            raise PrtError(f"lighting.place={place!r} is not one of around, inside")
        ranges = dict(count=count, distance=distance, elevation=elevation, azimuth=azimuth, cutoff=cutoff,
                      intensity=intensity, saturation=saturation)  # fmt: skip
        for name, value in ranges.items():
            if not _numbers(value, 2) or not value[0] <= value[1]:
                raise PrtError(f"lighting.{name}={value} must be a range [low, high]")
        for name, low, high in (("count", 1, 64), ("distance", 1e-3, 1e6), ("cutoff", 1e-2, 89.9),
                                ("intensity", 1e-12, 1e12), ("saturation", 0, 1), ("elevation", -90, 90),
                                ("azimuth", -360, 360)):  # fmt: skip
            if not low <= ranges[name][0] <= ranges[name][1] <= high:
                raise PrtError(f"lighting.{name}={list(ranges[name])} must lie between {low:g} and {high:g}")
        if any(value != int(value) for value in count):
            raise PrtError(f"lighting.count={list(count)} must be two whole numbers (lights)")
        box = box.tolist() if isinstance(box, np.ndarray) else box
        if not (_list(box, 2) and all(_numbers(corner, 3) for corner in box)) or (
            not all(low <= high for low, high in zip(*box, strict=True))
        ):
            raise PrtError(
                f"lighting.box={box} must be two corners [[x, y, z], [x, y, z]], the low one first"
            )
        if not _numbers([beam], 1) or not 0 < beam <= 1:
            raise PrtError(f"lighting.beam={beam} must be above 0 and at most 1 (share of the cutoff)")
        if not _numbers([aim], 1) or not 0 <= aim <= 100:
            raise PrtError(f"lighting.aim={aim} must be from 0 to 100 (half extents about the centre)")
        if kinds.get(ENVIRONMENT, 0) > 0 and environments is None:
            raise PrtError("lighting.kinds has environment but lighting.environments is null; name a set")
        self.kinds = {kind: float(kinds.get(kind, 0.0)) for kind in (*KINDS, ENVIRONMENT)}
        self.count, self.place = tuple(int(c) for c in count), place
        self.distance, self.elevation, self.azimuth = distance, elevation, azimuth
        self.box, self.aim, self.cutoff, self.beam = np.asarray(box, dtype=float), aim, cutoff, beam
        self.intensity, self.saturation = intensity, saturation
        self.environments, self.seed = environments, seed
        self.others: dict[str, Scenario] = {}
        for name, changes in (others or {}).items():
            if name in SPLIT_SEEDS:
                raise PrtError(f"lighting.others: {name!r} has a meaning of its own; choose another name")
            self.others[str(name)] = self._changed(str(name), changes)

    def _changed(self, name: str, changes: Mapping[str, Any]) -> "Scenario":
        own = {key: value for key, value in self.__dict__.items() if key != "others"}
        if not isinstance(changes, Mapping):
            raise PrtError(f"lighting.others.{name}={changes!r} must be the settings in which it differs")
        unknown = [key for key in changes if key not in own]
        if unknown:
            raise PrtError(
                f"lighting.others.{name}.{unknown[0]} is not a setting; it takes {', '.join(sorted(own))}"
            )
        return Scenario(**{**own, **changes})

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON, for records; caches are keyed by the rigs themselves."""
        plain = {key: value for key, value in self.__dict__.items() if key not in ("others", "environments")}
        return {key: np.asarray(v).tolist() if key == "box" else copy.copy(v) for key, v in plain.items()}

    def rigs(
        self, split: str, count: int, centre: Sequence[float], radius: float,
        half_extents: Sequence[float], poses: int = 1,
    ) -> tuple[list[str], list[LightRig]]:  # fmt: skip
        """``count`` named configurations; the first n are the same for every count.

        Args:
            split: ``train``, ``same`` (test lights of this scenario), ``path`` (one light moving slowly), or
                one of ``others``.
            centre, radius, half_extents: of the asset's bounding box, world units.
            poses: keyframes of the asset; each configuration gets one at random.

        Raises:
            PrtError: for an unknown split. (Test environments are taken in turn, again from the first where
                the set has fewer than ``count``; each time at an intensity of its own.)
        """
        place = _Place(np.asarray(centre, float), float(radius), np.asarray(half_extents, float), poses)
        if split in self.others:
            other = self.others[split]
            number = 16 + sorted(self.others).index(split)
            rigs = [other._draw(np.random.default_rng([self.seed, number, i]), place, i, True)
                    for i in range(count)]  # fmt: skip
        elif split == "path":
            rigs = self._path(count, place)
        elif split in SPLIT_SEEDS:
            tests = split != "train"
            rigs = [
                self._draw(np.random.default_rng([self.seed, SPLIT_SEEDS[split], i]), place, i, tests)
                for i in range(count)
            ]
        else:
            known = ["train", "same", "path", *self.others]
            raise PrtError(
                f"unknown split {split!r} of the lighting scenario; choose from {', '.join(known)}"
            )
        return [f"{split}{i:02d}" for i in range(count)], rigs

    def _draw(self, rng: np.random.Generator, place: "_Place", number: int, test: bool) -> LightRig:
        names = list(self.kinds)
        weights = np.array([self.kinds[name] for name in names]) / sum(self.kinds.values())
        pose = int(rng.integers(place.poses))
        lights, sky = [], None
        for _ in range(int(rng.integers(self.count[0], self.count[1] + 1))):
            kind = names[int(rng.choice(len(names), p=weights))]
            if kind == ENVIRONMENT:
                sky = self._environment(rng, number, test)
            else:
                lights.append(self._light(rng, kind, place))
        return LightRig(tuple(lights), sky, pose)

    def _environment(self, rng: np.random.Generator, number: int, test: bool):
        maps = self.environments.test()[1] if test else self.environments.train()[1]
        which = number % len(maps) if test else int(rng.integers(len(maps)))
        factor = math.exp(rng.uniform(*np.log(self.intensity)))
        return factor * maps[which]

    def _light(self, rng: np.random.Generator, kind: str, place: "_Place") -> LocalLight:
        hue, saturation = rng.uniform(), rng.uniform(*self.saturation)
        color = np.array(colorsys.hsv_to_rgb(hue, saturation, 1.0)) * math.exp(
            rng.uniform(*np.log(self.intensity))
        )
        azimuth = math.radians(rng.uniform(*self.azimuth))
        # even over the sphere within the range
        low, high = (math.sin(math.radians(e)) for e in self.elevation)
        up = rng.uniform(low, high)
        flat = math.sqrt(max(1 - up * up, 0.0))
        outward = np.array([flat * math.sin(azimuth), up, flat * math.cos(azimuth)])
        distance = rng.uniform(*self.distance)
        inside = place.centre + rng.uniform(*self.box) * place.half_extents
        target = place.centre + rng.uniform(-self.aim, self.aim, 3) * place.half_extents
        half_angle = rng.uniform(*self.cutoff)
        position = place.centre + outward * distance * place.radius if self.place == "around" else inside
        reach = place.radius * (np.mean(self.distance) if self.place == "around" else 0.5)
        towards = target - position
        direction = -outward if kind == "directional" else towards / max(np.linalg.norm(towards), 1e-9)
        strength = 1.0 if kind == "directional" else reach**2
        return LocalLight(
            kind, _vector(color * strength), _vector(position), _vector(direction), half_angle,
            self.beam * half_angle,
        )  # fmt: skip

    def _path(self, count: int, place: "_Place") -> list[LightRig]:
        """One light that moves from one drawn configuration a hundredth of the way to another per step."""
        ends = []
        for i in range(2):
            rng = np.random.default_rng([self.seed, SPLIT_SEEDS["path"], i])
            kind = next((k for k in KINDS if self.kinds[k] > 0), None)
            if kind is None:
                raise PrtError("a moving light needs point, spot or directional lights in lighting.kinds")
            ends.append(self._light(rng, kind, place))
        first, last = ends
        rigs = []
        for i in range(count):
            share = 0.01 * i
            position = (1 - share) * np.array(first.position) + share * np.array(last.position)
            direction = (1 - share) * np.array(first.direction) + share * np.array(last.direction)
            direction /= max(np.linalg.norm(direction), 1e-9)
            light = LocalLight(first.kind, first.color, _vector(position), _vector(direction), first.cutoff,
                               first.beam)  # fmt: skip
            rigs.append(LightRig((light,)))
        return rigs


class _Place:
    """Where the asset stands and how large it is."""

    def __init__(self, centre: np.ndarray, radius: float, half_extents: np.ndarray, poses: int):
        self.centre, self.radius, self.half_extents, self.poses = centre, radius, half_extents, poses


def _weights(kinds: Any) -> bool:
    """Whether these are weights of kinds of light, one of them above 0."""
    if not isinstance(kinds, Mapping) or not _numbers(list(kinds.values()), len(kinds)):
        return False
    known = all(kind in (*KINDS, ENVIRONMENT) for kind in kinds)
    return known and min(kinds.values(), default=0) >= 0 and sum(kinds.values()) > 0


def _list(values: Any, length: int) -> bool:
    return isinstance(values, Sequence) and not isinstance(values, str) and len(values) == length


def _numbers(values: Any, length: int) -> bool:
    """Whether it is a list of so many finite numbers."""
    return _list(values, length) and all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values
    )


def _vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z

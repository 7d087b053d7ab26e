"""A ball of curly hair, after the Hairball asset of Belcour 2022 (figures 10 and 11)."""

import functools
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float

from prt.errors import PrtError
from prt.scene.hair_asset import HairAsset
from prt.scene.scene import Scene, Trajectory
from prt.scene.shapes import diffuse, rgb, unit_setting
from prt.scene.strands import Strands

#: the number of strands that ``radius`` is meant for
REFERENCE_STRANDS = 3000
#: a strand's largest radius, in radii of the ball: thicker ones would cut through themselves in their curls
THICKEST = 0.02
CURVES = ("bsplinecurve", "linearcurve")
#: longitudinal and azimuthal roughness of a fibre (Mitsuba's default)
ROUGHNESS = 0.3
#: turns that a curl makes on the way from root to tip, and how soon it reaches its full width
CURL_TURNS, CURL_ONSET = 2.2, 3.5
#: how far tips are blown sideways by a slowly changing field, in lengths: neighbours go together, as locks
LOCKS = 0.35


class Hairball(Scene):
    """Strands that grow outwards from a small sphere about the origin, curl, and droop.

    The shape of the ball does not depend on the number of strands, and neither does how far light gets into
    it: a strand's radius is ``radius * 3000 / strands``, because the mean free path between strands is one
    over (length of hair per volume x diameter). With a constant radius more strands would be a solid ball,
    and with one that keeps their volume (1 / sqrt) it would still grow denser. Only a ball of few strands is
    thinner: they are never thicker than 0.02 (core + length).

    Args:
        strands: how many.
        segments: of each strand's curve.
        radius: of a strand where there are 3000 of them, world units.
        core: radius of the sphere that they grow on, world units.
        length: how far they reach out from there, world units; curls make the strands themselves longer.
        curl: radius of the curls, world units; 0 for straight hair.
        droop: how far the tips hang down, in lengths.
        eumelanin, pheomelanin: concentrations of pigment (brown, red) of Mitsuba's ``hair``; white without.
        reflectance: linear RGB colour of the hair in bulk instead of pigments, by the absorption that gives
            it (Chiang 2016, equation 9).
        curve: ``bsplinecurve`` is smooth and scatters as hair. ``linearcurve`` has straight segments and
            diffuse fibres of ``reflectance``, which it needs: Mitsuba gives no tangents there, on which its
            hair BSDF relies.
        seed: of what differs from strand to strand.
        others: as in :class:`Scene`.

    Raises:
        PrtError: if a setting is out of range.
    """

    geometry_version = 1

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "hairball",
        max_depth: int = 12,
        record: Literal["bsdf", "nee"] = "bsdf",
        strands: int = REFERENCE_STRANDS,
        segments: int = 16,
        radius: float = 0.005,
        core: float = 0.3,
        length: float = 0.7,
        curl: float = 0.08,
        droop: float = 0.2,
        eumelanin: float = 0.1,
        pheomelanin: float = 0.25,
        reflectance: Sequence[float] | None = None,
        curve: Literal["bsplinecurve", "linearcurve"] = "bsplinecurve",
        seed: int = 0,
    ):
        super().__init__(name, cameras, max_depth, record)
        self.strand_count = _whole("strands", strands, 1, 10_000_000)
        self.segments = _whole("segments", segments, 1, 1000)
        self.core = unit_setting("core", core, 0.01, 100.0)
        self.length = unit_setting("length", length, 0.01, 100.0)
        thin = unit_setting("radius", radius, 1e-6, 0.1) * REFERENCE_STRANDS / self.strand_count
        self.strand_radius = min(thin, THICKEST * (self.core + self.length))
        self.curl = unit_setting("curl", curl, 0.0, 10.0)
        self.droop = unit_setting("droop", droop, 0.0, 1.0)
        self.eumelanin = unit_setting("eumelanin", eumelanin, 0.0, 100.0)
        self.pheomelanin = unit_setting("pheomelanin", pheomelanin, 0.0, 100.0)
        self.seed = _whole("seed", seed, 0, 2**63 - 1)
        if curve not in CURVES:
            raise PrtError(f"scene.curve={curve!r} is not one of {', '.join(CURVES)}")
        self.curve = curve
        self.reflectance = None if reflectance is None else _color(reflectance)
        if curve == "linearcurve" and self.reflectance is None:
            raise PrtError(
                "scene.curve='linearcurve' has diffuse fibres and no pigments: set scene.reflectance to "
                "three numbers, or scene.curve=bsplinecurve"
            )

    def fingerprint(self) -> dict[str, Any]:
        pigments = {"eumelanin": self.eumelanin, "pheomelanin": self.pheomelanin}
        return {
            "scene": "hairball",
            "geometry_version": self.geometry_version,
            "strands": self.strand_count,
            "segments": self.segments,
            "radius": self.strand_radius,
            "core": self.core,
            "length": self.length,
            "curl": self.curl,
            "droop": self.droop,
            "curve": self.curve,
            "seed": self.seed,
            # pigments that a reflectance replaces change nothing
            **({"reflectance": self.reflectance} if self.reflectance else pigments),
        }

    def asset(self, texels: int | None = None) -> HairAsset:
        """The asset that a lightmap is baked for; its size follows from the strands, not from ``texels``."""
        return HairAsset(self, texels)

    def description(self) -> dict[str, Any]:
        return {f"hair{i}": shape for i, shape in enumerate(self.hair())}

    def bsdf(self) -> dict[str, Any]:
        """Of the strands, as a Mitsuba dict."""
        if self.reflectance is None:
            return {
                "type": "hair",
                "longitudinal_roughness": ROUGHNESS,
                "azimuthal_roughness": ROUGHNESS,
                "eumelanin": self.eumelanin,
                "pheomelanin": self.pheomelanin,
            }
        if self.curve == "linearcurve":
            return diffuse(self.reflectance)
        return {
            "type": "hair",
            "longitudinal_roughness": ROUGHNESS,
            "azimuthal_roughness": ROUGHNESS,
            "sigma_a": rgb(absorption(self.reflectance)),
        }

    @functools.cache  # noqa: B019  (a scene lives as long as its task)
    def hair(self) -> list[Any]:
        """All strands as ``mi.Shape`` objects, built once: scenes under different light share them."""
        return self.strands.shapes(self.bsdf())

    @functools.cached_property
    def strands(self) -> Strands:
        """The control points of the strands."""
        # a B-spline passes its control points by: with one before the root and one behind the tip it starts
        # and ends where the polyline does, but for the curl
        reach = 1 if self.curve == "bsplinecurve" else 0
        steps = np.arange(-reach, self.segments + 1 + reach) / self.segments
        control = torch.from_numpy(self.grown(steps).astype(np.float32))
        return Strands(control, self.strand_radius, self.curve)

    def grown(self, x: Float[np.ndarray, "C"]) -> Float[np.ndarray, "N C 3"]:
        """Places on all strands, world units, at ``x``: 0 at the root, 1 at the tip, or a little beyond.

        Drawn per strand: a share of the length, a tilt, the phase and pitch of the curl. The rest are smooth
        functions of the root, so that neighbours go together and ever more strands fill the same ball.
        """
        normal = _fibonacci(self.strand_count)
        draw = np.random.default_rng(self.seed).random((self.strand_count, 6))
        lock = _field(normal, self.seed, 3)  # in about [-1, 1]
        tilt = 0.25 * (2 * draw[:, 0:3] - 1) + LOCKS * lock
        # towards what is outside only: along the sphere, not into it
        tilt -= (tilt * normal).sum(1, keepdims=True) * normal
        length = self.length * (1.0 - 0.35 * draw[:, 3:4] ** 2)
        phase = 2 * np.pi * (_field(normal, self.seed + 1, 1) + 0.25 * draw[:, 4:5])
        turns = CURL_TURNS * (0.8 + 0.4 * draw[:, 5:6])

        x = x[None, :, None]
        side = np.cross(normal, [0.0, 1.0, 0.0]) + 1e-6 * np.array([1.0, 0.0, 0.0])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        other = np.cross(normal, side)
        angle = phase[:, None] + 2 * np.pi * turns[:, None] * x
        wide = self.curl * (1.0 - np.exp(-CURL_ONSET * x))
        bent = tilt - self.droop * np.array([0.0, 1.0, 0.0])
        return (
            normal[:, None] * (self.core + length[:, None] * x)
            + bent[:, None] * length[:, None] * x**2
            + wide * (np.cos(angle) * side[:, None] + np.sin(angle) * other[:, None])
        )


def absorption(color: Sequence[float], roughness: float = ROUGHNESS) -> list[float]:
    """Absorption in inverse fibre radii that gives hair this colour in bulk (Chiang 2016, equation 9).

    Args:
        color: linear RGB, above 0 and at most 1.
        roughness: azimuthal.
    """
    b = roughness
    fitted = 5.969 - 0.215 * b + 2.532 * b**2 - 10.73 * b**3 + 5.574 * b**4 + 0.245 * b**5
    return [(math.log(part) / fitted) ** 2 for part in color]


def _fibonacci(count: int) -> Float[np.ndarray, "N 3"]:
    """Unit directions spread evenly over the sphere, turned on by the golden angle one after the other."""
    number = np.arange(count) + 0.5
    y = 1.0 - 2.0 * number / count
    around = np.pi * (3.0 - np.sqrt(5.0)) * number
    flat = np.sqrt(1.0 - y**2)
    return np.stack([flat * np.sin(around), y, flat * np.cos(around)], 1)


def _field(place: Float[np.ndarray, "N 3"], seed: int, channels: int) -> Float[np.ndarray, "N C"]:
    """A smooth random function over the unit sphere, in about [-1, 1]: a few waves in random directions."""
    rng = np.random.default_rng([seed, channels])
    waves = 12
    frequency = 5.0 * rng.normal(size=(3, channels * waves))
    phase = 2 * np.pi * rng.random(channels * waves)
    values = np.sin(place @ frequency + phase).reshape(len(place), channels, waves)
    return values.sum(2) / np.sqrt(waves)


def _whole(name: str, value: Any, low: int, high: int) -> int:
    """A whole number within a range, or an error that names the setting."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise PrtError(f"scene.{name}={value!r} must be a whole number between {low} and {high}")
    return value


def _color(value: Any) -> list[float]:
    """Three reflectances above 0, or an error that names the setting."""
    try:
        parts = [float(part) for part in value]
    except (TypeError, ValueError):
        parts = []
    # darker than this the absorption is above 1, which Mitsuba refuses of a colour
    if isinstance(value, str) or len(parts) != 3 or not all(0.003 <= part <= 1.0 for part in parts):
        raise PrtError(f"scene.reflectance={value!r} must be three numbers between 0.003 and 1, or null")
    return parts

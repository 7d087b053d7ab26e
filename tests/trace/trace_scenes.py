"""Small scenes with known answers, and statistics to compare two Monte Carlo estimators."""

import torch

from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.view import View

NO_CAMERAS = {"train": [lambda places: []], "far": [lambda places: []]}


class DictScene(Scene):
    """Shapes given as a Mitsuba dict."""

    def __init__(self, shapes, max_depth=4):
        super().__init__("test", NO_CAMERAS, max_depth)
        self.shapes = shapes

    def description(self):
        return self.shapes

    def fingerprint(self):
        return {"scene": "test"}


def diffuse(value):
    return {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}},
    }


def plane(bsdf, scale=1.0):
    """A horizontal square at y = 0, facing up."""
    to_world = mitsuba().ScalarTransform4f().rotate([1, 0, 0], -90).scale(scale)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def glossy_corner(max_depth=4):
    """A diffuse wall, a glossy floor and a rough metal ball: direct and indirect light, smooth lobes only."""
    to_world = mitsuba().ScalarTransform4f().translate([0, 1, -1])
    floor = {"type": "principled", "base_color": {"type": "rgb", "value": [0.5, 0.4, 0.3]}, "roughness": 0.4}
    return DictScene(
        {
            "floor": plane({"type": "twosided", "bsdf": floor}),
            "wall": {"type": "rectangle", "to_world": to_world, "bsdf": diffuse(0.7)},
            "ball": {
                "type": "sphere",
                "center": [0, 0.4, -0.2],
                "radius": 0.4,
                "bsdf": {"type": "roughconductor", "material": "Ag", "alpha": 0.2},
            },
        },
        max_depth,
    )


CORNER_VIEW = View((0.0, 1.0, 3.0), (0.0, 0.6, 0.0), width=16, height=16)
#: looks straight down on the middle of ``plane``
DOWN_VIEW = View((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=20.0, width=8, height=8)


def lightings(resolution):
    """Three of different kinds: constant, many-coloured with strong contrast, one bright texel on black."""
    generator = torch.Generator().manual_seed(3)
    shape = (6, resolution, resolution, 3)
    one = torch.zeros(shape)
    one[2, resolution // 2, resolution // 2] = 500.0
    return {
        "constant": torch.ones(shape),
        "contrast": torch.rand(shape, generator=generator) ** 6,
        "one texel": one,
    }


def disagreement(a, b):
    """How far two estimators are apart: n independent images of each, ``(n, H, W, 3)``.

    Returns:
        The mean squared z over blocks of 2 x 2 pixels (about 1.25 for equal expectations and six seeds), and
        the z of the mean.
    """
    a, b = (images.unflatten(1, (-1, 2)).unflatten(3, (-1, 2)).mean((2, 4)) for images in (a, b))
    difference = a.mean(0) - b.mean(0)
    error = (a.var(0) / len(a) + b.var(0) / len(b)).clamp_min(1e-14)
    whole_a, whole_b = a.mean((1, 2, 3)), b.mean((1, 2, 3))
    whole_error = (whole_a.var() / len(a) + whole_b.var() / len(b)).sqrt().clamp_min(1e-9)
    return float((difference.square() / error).mean()), float((whole_a.mean() - whole_b.mean()) / whole_error)

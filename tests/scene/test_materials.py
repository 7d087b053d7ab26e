"""Materials read from Mitsuba's BSDFs: colours, roughness, bumps, and the error for unknown ones."""

import math

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.capture import capture
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

FRONT = View(origin=(0.0, 0.0, 3.0), target=(0.0, 0.0, 0.0), fov=30.0, width=8, height=8)


def on_a_square(bsdf, view: View = FRONT):
    """The G-buffer of a 2 x 2 square in the plane z = 0 that fills the view."""
    square = {"type": "rectangle", "id": "square", "bsdf": bsdf}
    return capture(mitsuba().load_dict({"type": "scene", "square": square}), view)


def rgb(*values):
    return {"type": "rgb", "value": list(values)}


def f0(eta: float) -> float:
    return ((eta - 1) / (eta + 1)) ** 2


RED = (0.6, 0.2, 0.1)
METAL = {"eta": rgb(0.2, 0.9, 1.1), "k": rgb(3.9, 2.4, 2.2)}
METAL_F0 = [
    ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    for n, k in zip((0.2, 0.9, 1.1), (3.9, 2.4, 2.2), strict=True)
]
BLACK = (0.0, 0.0, 0.0)
CASES = {
    "diffuse": ({"type": "diffuse", "reflectance": rgb(*RED)}, RED, BLACK, 1.0),
    "principled": (
        {"type": "principled", "base_color": rgb(*RED), "roughness": 0.3, "specular": 0.5, "metallic": 0.25},
        tuple(0.75 * c for c in RED),
        tuple(0.75 * 0.04 + 0.25 * c for c in RED),
        0.3,
    ),
    "principled eta": (
        {"type": "principled", "base_color": rgb(*RED), "roughness": 0.5, "eta": 1.6},
        RED,
        (f0(1.6),) * 3,
        0.5,
    ),
    "roughconductor": ({"type": "roughconductor", "alpha": 0.09, **METAL}, BLACK, METAL_F0, 0.3),
    "anisotropic": (
        {"type": "roughconductor", "alpha_u": 0.04, "alpha_v": 0.16, **METAL},
        BLACK,
        METAL_F0,
        math.sqrt(0.08),
    ),
    "conductor": (
        {"type": "conductor", "specular_reflectance": rgb(0.5, 0.5, 0.5), **METAL},
        BLACK,
        [0.5 * f for f in METAL_F0],
        0.0,
    ),
    "mirror": ({"type": "conductor", "material": "none"}, BLACK, (1.0,) * 3, 0.0),
    "roughplastic": (
        {
            "type": "roughplastic",
            "alpha": 0.25,
            "int_ior": 1.5,
            "ext_ior": 1.0,
            "diffuse_reflectance": rgb(*RED),
        },
        RED,
        (0.04,) * 3,
        0.5,
    ),
    "plastic": (
        {"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": rgb(*RED)},
        RED,
        (0.04,) * 3,
        0.0,
    ),
    "dielectric": ({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, BLACK, (1.0,) * 3, 0.0),
    "opaque dielectric": (
        {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_transmittance": rgb(0, 0, 0)},
        BLACK,
        (0.04,) * 3,
        0.0,
    ),
    "thindielectric": ({"type": "thindielectric"}, BLACK, (1.0,) * 3, 0.0),
    "roughdielectric": ({"type": "roughdielectric", "alpha": 0.16}, BLACK, (1.0,) * 3, 0.4),
    "twosided": ({"type": "twosided", "b": {"type": "diffuse", "reflectance": rgb(*RED)}}, RED, BLACK, 1.0),
    "mask": (
        {"type": "mask", "opacity": 0.8, "b": {"type": "diffuse", "reflectance": rgb(*RED)}},
        RED,
        BLACK,
        1.0,
    ),
    "nested": (
        {
            "type": "mask",
            "opacity": 1.0,
            "b": {
                "type": "twosided",
                "c": {"type": "roughplastic", "alpha": 0.04, "int_ior": 1.5, "ext_ior": 1.0},
            },
        },
        (0.5,) * 3,
        (0.04,) * 3,
        0.2,
    ),
    "blendbsdf": (
        {
            "type": "blendbsdf",
            "weight": 0.25,
            "a": {"type": "diffuse", "reflectance": rgb(*RED)},
            "b": {"type": "diffuse", "reflectance": rgb(0, 0, 0)},
        },
        tuple(0.75 * c for c in RED),
        BLACK,
        1.0,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_colours_and_roughness(name):
    bsdf, diffuse, specular, roughness = CASES[name]
    g = on_a_square(bsdf)
    assert len(g) == 64
    assert torch.allclose(g.diffuse, torch.tensor(diffuse).float().expand(64, 3), atol=2e-4)
    assert torch.allclose(g.specular, torch.tensor(specular).float().expand(64, 3), atol=2e-4)
    assert torch.allclose(g.roughness, torch.full((64, 1), float(roughness)), atol=1e-4)


def test_textures_are_looked_up_at_the_hit():
    mi = mitsuba()
    texels = np.array([[[0.1], [0.2]], [[0.3], [0.4]]], dtype=np.float32)
    texture = {
        "type": "bitmap",
        "data": mi.TensorXf(texels.ravel().tolist(), shape=(2, 2, 1)),
        "raw": True,
        "filter_type": "nearest",
    }
    g = on_a_square({"type": "roughconductor", "alpha": texture, "material": "Au"})
    column, row = (g.uv[:, 0] >= 0.5).long(), (g.uv[:, 1] >= 0.5).long()
    expected = torch.tensor(texels[..., 0])[row, column]
    assert len(expected.unique()) == 4
    assert torch.allclose(g.roughness[:, 0] ** 2, expected, atol=1e-5)


def test_the_two_sides_of_a_surface_differ():
    bsdf = {
        "type": "twosided",
        "front": {"type": "diffuse", "reflectance": rgb(*RED)},
        "rear": {"type": "roughconductor", "alpha": 0.09, **METAL},
    }
    behind = View(origin=(0.0, 0.0, -3.0), target=(0.0, 0.0, 0.0), fov=30.0, width=4, height=4)
    assert torch.allclose(on_a_square(bsdf).diffuse[0], torch.tensor(RED), atol=1e-4)
    g = on_a_square(bsdf, behind)
    assert g.diffuse.abs().max() == 0.0
    assert torch.allclose(g.specular[0], torch.tensor(METAL_F0), atol=1e-4)
    assert (g.normal[:, 2] < -0.999).all()


def test_bump_map_bends_the_normal():
    """A height that rises linearly along u by `slope` per unit of u, on a square of side 2."""
    mi = mitsuba()
    width, slope = 64, 0.5
    ramp = np.broadcast_to((np.arange(width) + 0.5) / width * slope, (2, width)).astype(np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(ramp.ravel().tolist(), shape=(2, width, 1)), "raw": True}
    g = on_a_square({"type": "bumpmap", "texture": texture, "b": {"type": "diffuse"}})
    inside = (g.uv[:, 0] - 0.5).abs() < 0.4
    expected = torch.nn.functional.normalize(torch.tensor([-slope / 2, 0.0, 1.0]), dim=0)
    assert torch.allclose(g.normal[inside], expected.expand(int(inside.sum()), 3), atol=2e-3)
    assert torch.allclose((g.wo * g.normal).sum(1), (g.wr * g.normal).sum(1), atol=1e-5)


def test_normal_map_bends_the_normal():
    mi = mitsuba()
    wanted = np.array([0.6, 0.0, 0.8])
    data = np.broadcast_to(wanted * 0.5 + 0.5, (2, 2, 3)).astype(np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(data.ravel().tolist(), shape=(2, 2, 3)), "raw": True}
    g = on_a_square({"type": "normalmap", "normalmap": texture, "b": {"type": "diffuse"}})
    assert torch.allclose(g.normal, torch.tensor(wanted).float().expand(len(g), 3), atol=1e-4)


def test_unknown_bsdf_is_named():
    with pytest.raises(PrtError) as caught:
        on_a_square({"type": "hair"})
    message = str(caught.value)
    assert "Hair" in message and "'square'" in message and "roughplastic" in message and "\n" not in message

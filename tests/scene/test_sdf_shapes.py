"""The four shapes and their configurations: they fit, stand on something, cast shadows, and are seen."""

from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from prt.scene.sdf import Sdf

CONF = Path(__file__).parents[2] / "conf" / "scene"
NAMES = ("car", "fish", "monster", "rabbit")


@pytest.fixture(scope="module", params=NAMES)
def scene(request):
    return instantiate(OmegaConf.load(CONF / f"sdf_{request.param}.yaml"))


def rays(view, size=12):
    """Origins and directions (size * size, 3) of a view's pixels."""
    origin = torch.tensor(view.origin)
    forward = torch.nn.functional.normalize(torch.tensor(view.target) - origin, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, torch.tensor(view.up)), dim=0)
    up = torch.linalg.cross(right, forward)
    grid = ((torch.arange(size) + 0.5) / size * 2 - 1) * view.half_width
    direction = forward + grid[:, None] * right - grid[:, None, None] * up
    direction = torch.nn.functional.normalize(direction.reshape(-1, 3), dim=1)
    return origin.expand_as(direction), direction


def traced(distance, origin, direction, start, far, steps=200):
    """Where sphere tracing arrives, and whether it does within ``far``."""
    along = torch.full((len(direction),), start)
    for _ in range(steps):
        step = distance(origin + along[:, None] * direction)
        along = along + step.clamp(min=0) * (along < far)
    return along, step < 1e-3


def test_expression_with_surface_in_the_box(scene):
    assert isinstance(scene.sdf, Sdf)
    scene.check()
    assert scene.max_depth == 2 and scene.albedo == (0.8, 0.8, 0.8)


def test_fits_its_bounds_and_the_unit_box(scene):
    low, high = torch.tensor(scene.bounds)
    place = torch.rand((20000, 3), generator=torch.Generator().manual_seed(0))
    for axis in range(3):
        for side in (low, high):
            face = low + (high - low) * place
            face[:, axis] = side[axis]
            assert scene.distance(face).min() > 0.0
            unit = 2 * place - 1
            unit[:, axis] = side.sign()[axis]
            assert scene.distance(unit).min() > 0.0


def test_stands_on_a_plinth_of_its_own_height(scene):
    """Flat below; from above, one meets the shape at different heights."""
    around = torch.linspace(0, 6.28, 30)
    top = torch.stack([0.4 * around.cos(), torch.full((30,), scene.bounds[1][1]), 0.4 * around.sin()], dim=1)
    low = scene.distance(torch.stack([top[:, 0], torch.full((30,), scene.bounds[0][1]), top[:, 2]], dim=1))
    assert low.max() - low.min() < 1e-5
    along, hit = traced(scene.distance, top, torch.tensor([0.0, -1.0, 0.0]).expand(30, 3), 0.0, 3.0, 60)
    assert hit.all()
    assert (top[:, 1] - along).max() - (top[:, 1] - along).min() > 0.3


@pytest.mark.parametrize("split", ["train", "far"])
def test_cameras_stay_outside_and_see_the_shape(scene, split):
    views = scene.views(split, 9, 12)
    origins, directions = (torch.cat(part) for part in zip(*(rays(view) for view in views), strict=True))
    with torch.no_grad():
        assert scene.distance(origins).min() > 0.8
        _, hit = traced(scene.distance, origins, directions, 0.8, 8.0, 60)
    shares = hit.float().view(len(views), -1).mean(dim=1)
    assert shares.min() > 0.13 and shares.mean() > 0.22, shares


def test_shadows_itself(scene):
    """Light at 45 degrees is kept from a good part of the upward surface."""
    (origin, direction), light = rays(scene.views("far", 3, 16)[0], 16), torch.tensor([0.5, 0.7071, 0.5])
    with torch.no_grad():
        along, hit = traced(scene.distance, origin, direction, 0.8, 8.0, 80)
    place = (origin + along[:, None] * direction)[hit].requires_grad_()
    normal = torch.nn.functional.normalize(torch.autograd.grad(scene.distance(place).sum(), place)[0], dim=1)
    lit = normal @ light > 0.2
    start = (place + 0.01 * normal).detach()[lit]
    with torch.no_grad():
        _, dark = traced(scene.distance, start, light.expand_as(start), 0.0, 2.5, 60)
    assert 0.02 < float(dark.float().mean()) < 0.7


def test_shapes_differ():
    texts = {name: instantiate(OmegaConf.load(CONF / f"sdf_{name}.yaml")).sdf.glsl() for name in NAMES}
    assert len(set(texts.values())) == len(NAMES)
    # a shader that compiles in reasonable time
    assert all(200 < text.count("float t") < 2000 for text in texts.values())

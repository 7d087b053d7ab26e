"""The scene of a distance function: what may be named, its fingerprint, and what is refused."""

import json
import sys
from pathlib import Path

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from prt.errors import PrtError
from prt.scene.cameras import circular_sweep
from prt.scene.sdf import Sdf
from prt.scene.sdf_scene import SdfScene

CONF = Path(__file__).parents[2] / "conf" / "scene"
CAMERAS = {split: [circular_sweep((0.0, 0.0, 0.0), 4.0)] for split in ("train", "far")}
OWN = """
import torch
from prt.scene.sdf import Sdf
from prt.scene.sdf_primitives import sphere

ready = sphere(0.5)
number = 3.0

def expression(radius=0.5):
    return sphere(radius)

def ball(p, radius=0.5):
    return p.norm(dim=1) - radius

def made():
    return lambda p: p.norm(dim=1) - 0.5

class Net(torch.nn.Module):
    def forward(self, p):
        return p.norm(dim=1) - 0.5

net = Net()

def made_net():
    return Net()

class Wants:
    def __init__(self, radius):
        self.radius = radius

def column(p):
    return p.norm(dim=1, keepdim=True)

def listed(p):
    return p[:, 0].tolist()

def empty(p):
    return p.norm(dim=1) + 5.0

def holes(p):
    return (p[:, 0] - 0.5).sqrt()

def fails(p):
    return p @ p

def broken():
    raise ValueError("no\\nluck")

def two(a, b):
    return a

def gives_number():
    return 3
"""


@pytest.fixture
def own(tmp_path, monkeypatch, request):
    """The module of a user's file in the current folder; a name of its own, for modules are kept."""
    name = "own_" + "".join(c if c.isalnum() else "_" for c in request.node.name)
    (tmp_path / f"{name}.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return name


def scene(function, **settings):
    return SdfScene(CAMERAS, function=function, **settings)


@pytest.mark.parametrize("function", ["ready", "expression", "ball", "made", "net", "Net", "made_net"])
def test_what_may_be_named(own, function):
    found = scene(f"{own}:{function}")
    place = torch.tensor([[0.0, 2.0, 0.0], [0.0, 0.0, 0.25]], requires_grad=True)
    distance = found.distance(place)
    torch.testing.assert_close(distance, torch.tensor([1.5, -0.25]))
    torch.testing.assert_close(
        torch.autograd.grad(distance.sum(), place)[0], torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    )
    assert isinstance(found.sdf, Sdf) == (function in ("ready", "expression"))
    found.check()
    json.dumps(found.fingerprint())


def test_the_function_is_imported_when_first_needed():
    late = scene("there_is_no_such_module:sdf")
    assert late.bounds == ((-1.1, -1.1, -1.1), (1.1, 1.1, 1.1)) and late.albedo == (0.8, 0.8, 0.8)
    assert len(late.views("far", 3, 8)) == 3
    with pytest.raises(PrtError, match="cannot import there_is_no_such_module"):
        _ = late.distance


def test_the_path_of_imports_is_left_as_it_was(own):
    before = list(sys.path)
    _ = scene(f"{own}:ball").distance
    assert sys.path == before


def test_fingerprint_follows_expression_and_settings():
    found = scene("prt.scene.sdf_shapes:car")
    print_of = found.fingerprint()
    assert print_of["glsl"] == found.sdf.glsl()
    assert print_of == scene("prt.scene.sdf_shapes.car:car").fingerprint()
    others = [
        scene("prt.scene.sdf_shapes:fish"),
        scene("prt.scene.sdf_shapes:car", albedo=(0.5, 0.5, 0.5)),
        scene("prt.scene.sdf_shapes:car", bounds=((-1, -1, -1), (1, 1, 1))),
    ]
    assert all(other.fingerprint() != print_of for other in others)


def test_fingerprint_follows_the_file(own, tmp_path):
    first = scene(f"{own}:ball")
    before = first.fingerprint()
    assert before == scene(f"{own}:ball").fingerprint() != scene(f"{own}:made").fingerprint()
    (tmp_path / f"{own}.py").write_text(OWN + "\n# changed\n")
    assert scene(f"{own}:ball").fingerprint() != before


def test_fingerprint_follows_a_file_the_function_is_taken_from(own, tmp_path):
    (tmp_path / f"{own}_face.py").write_text(f"from {own} import ball\n")
    before = scene(f"{own}_face:ball").fingerprint()
    (tmp_path / f"{own}.py").write_text(OWN + "\n# changed\n")
    assert scene(f"{own}_face:ball").fingerprint() != before


def test_has_no_shapes_for_mitsuba():
    found = scene("prt.scene.sdf_shapes:car", name="car")
    for use in (found.description, found.load, lambda: found.load({"type": "constant"})):
        with pytest.raises(PrtError, match="scene car is a signed distance field.*use task=relight_direct"):
            use()


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("missing", "has no 'missing'; choose one of its functions: .*ball"),
        ("number", "gives float, no distance"),
        ("gives_number", "gives int, no distance"),
        ("two", "gives function, no distance"),
        ("Wants", "gives type, no distance"),
        ("broken", "failed: ValueError: no luck"),
        ("column", r"returned \(65536, 1\) for positions \(65536, 3\)"),
        ("listed", "returned list for positions"),
        ("empty", "no zero set inside scene.bounds; check"),
        ("holes", "returned NaN at"),
        ("fails", r"failed at positions \(65536, 3\): RuntimeError"),
    ],
)
def test_functions_that_are_no_distance(own, function, message):
    with pytest.raises(PrtError, match=message) as caught:
        scene(f"{own}:{function}").check()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"function": None}, "scene.function=None must be module:function"),
        ({"function": "car"}, "scene.function='car' must be module:function"),
        ({"function": "car:"}, "scene.function='car:' must be module:function"),
        ({"function": "a:b", "bounds": [[0, 0, 0]]}, "must be two corners"),
        ({"function": "a:b", "bounds": [[0, 0, 0], [1, 1]]}, "scene.bounds=.* must be 3 numbers"),
        ({"function": "a:b", "bounds": [[0, 0, 0], [1, -1, 1]]}, "must lie below the second"),
        ({"function": "a:b", "bounds": [[0, 0, 0], [1, 1, float("inf")]]}, "must be finite"),
        ({"function": "a:b", "albedo": [0.5, 0.5, 1.5]}, "scene.albedo=.* between 0 and 1"),
        ({"function": "a:b", "albedo": 0.5}, "scene.albedo=0.5 must be 3 numbers"),
        ({"function": "a:b", "albedo": "red"}, "scene.albedo='red' must be 3 numbers"),
        ({"function": "a:b", "max_depth": 1}, "scene.max_depth=1"),
    ],
)
def test_settings_out_of_range(settings, message):
    with pytest.raises(PrtError, match=message) as caught:
        SdfScene(CAMERAS, **settings)
    assert "\n" not in str(caught.value)


def test_configuration_of_a_users_function(own):
    config = OmegaConf.load(CONF / "sdf.yaml")
    assert OmegaConf.is_missing(config, "function")
    config.function = f"{own}:ball"
    found = instantiate(config)
    found.check()
    assert found.sdf is None
    origins = [view.origin for split in ("train", "far") for view in found.views(split, 6, 8)]
    assert found.distance(torch.tensor(origins)).min() > 1.5

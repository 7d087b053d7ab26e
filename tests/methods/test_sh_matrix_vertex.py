"""Glossy transfer matrices as a method: closed forms in a bowl, path-traced references, storage, refusals."""

import types

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from kept_log import Log

from prt.bench.compose import compose
from prt.errors import PrtError
from prt.light.cubemap import texel_directions
from prt.methods.base import Component, Method
from prt.methods.sh_matrix_vertex import ShMatrixVertex
from prt.scene.capture import capture
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.shapes import MeshData, diffuse, sphere_mesh, to_mesh, twosided
from prt.scene.view import View
from prt.trace.reference import render

R, ALBEDO, DEPTH = 8, 0.8, 4
INTO_BOWL = View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), fov=24.0, width=12, height=12)
AT_CORNER = View((0.4, 2.4, 1.6), (0.0, 0.2, -0.4), fov=40.0, width=16, height=16)


class Shapes(Scene):
    """Shapes made by a function, seen in one view."""

    def __init__(self, make, view: View, record="bsdf"):
        super().__init__(
            "shapes", dict.fromkeys(("train", "far"), [lambda places: [view] * len(places)]), DEPTH, record
        )
        self.description = make

    def fingerprint(self):
        return {"scene": self.name}


def bowl() -> MeshData:
    """The part of the unit sphere below z = 0.6, its normals outside as those of any sphere."""
    ball = sphere_mesh(1.0, 64, 32)
    middle = ball.position[ball.face].mean(1)
    return MeshData(ball.position, ball.normal, ball.uv, ball.face[middle[:, 2] < 0.6])


def bowl_shapes():
    return {"bowl": to_mesh("bowl", bowl(), twosided(diffuse((ALBEDO, ALBEDO / 2, 0.0))))}


def corner_shapes(floor):
    """A floor with a diffuse wall behind it."""
    transform = mitsuba().ScalarTransform4f
    wall = transform().translate([0, 1, -1])
    return {
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90), "bsdf": floor},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": twosided(diffuse((0.8, 0.6, 0.4)))},
    }


def task_of(scene: Scene, pixel_size: float = 0.15):
    prior = torch.ones(6 * R * R, 3)
    return types.SimpleNamespace(scene=scene, pixel_size=pixel_size, resolution=R, prior=lambda: prior)


def fitted(task, **changes) -> ShMatrixVertex:
    settings = {"degree": 4, "paths": 512, "edge_pixels": 2.0, "spacing_pixels": 1.0}
    method = ShMatrixVertex(**{**settings, **changes})
    method.fit(task, Log(), 0, "cpu")
    return method


@pytest.fixture(scope="module")
def in_bowl():
    """Task, fitted method and what the camera sees of the inside of the bowl."""
    task = task_of(Shapes(bowl_shapes, INTO_BOWL))
    gbuffer = capture(task.scene.load(), INTO_BOWL)
    assert len(gbuffer) > 100
    return task, fitted(task), gbuffer


def lighting(seed: int) -> torch.Tensor:
    return torch.rand((6, R, R, 3), generator=torch.Generator().manual_seed(seed))


# ---- what it predicts


def bowl_radiance(albedo: float) -> float:
    """Indirect radiance in the bowl under light of radiance 1 from everywhere, the same at all places.

    In a sphere every place sees every other equally well, so each reflection passes on the share of the
    sphere that is closed, and the rest of the light comes and goes through the opening.
    """
    data = bowl()
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    closed = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 / (4 * np.pi)
    return albedo * (1 - closed) * sum((albedo * closed) ** k for k in range(1, DEPTH))


@pytest.mark.parametrize("record", ["bsdf", "nee"])
def test_a_bowl_under_constant_light_is_as_bright_as_the_closed_form(in_bowl, record):
    task, method, gbuffer = in_bowl
    if record == "nee":
        method = fitted(task_of(Shapes(bowl_shapes, INTO_BOWL, record)))
    found = method.shade(gbuffer, method.light(torch.full((6, R, R, 3), 2.0)))
    for colour, albedo in enumerate((ALBEDO, ALBEDO / 2)):
        expected = 2 * bowl_radiance(albedo)
        assert found[:, colour].mean() == pytest.approx(expected, rel=0.03)
        # vertices at the rim see a little less than their hemisphere
        assert (found[:, colour] - expected).abs().median() < 0.04 * expected
    assert found[:, 2].abs().max() == 0


@pytest.mark.parametrize(
    "floor, tolerance",
    [
        (twosided(diffuse((0.5, 0.5, 0.5))), 0.06),
        ({"type": "roughconductor", "material": "Ag", "alpha": 0.16}, 0.2),
    ],
    ids=["diffuse", "glossy"],
)
def test_it_agrees_with_path_traced_indirect_light_of_few_bands(floor, tolerance):
    scene = Shapes(lambda: corner_shapes(floor), AT_CORNER)
    method = fitted(task_of(scene, 0.1), degree=8, paths=1024)
    d = texel_directions(R)
    smooth = (1 + 0.6 * d[..., 2] - 0.4 * d[..., 0] * d[..., 1])[..., None] * torch.tensor([1.0, 0.7, 0.4])
    gbuffer = capture(scene.load(), AT_CORNER)
    found = method.shade(gbuffer, method.light(smooth))
    reference = render(scene, AT_CORNER, smooth, 1024, DEPTH, 1)["indirect"].reshape(-1, 3)[gbuffer.hit]
    on_floor = gbuffer.normal[:, 1] > 0.9
    for part in (on_floor, ~on_floor):
        assert found[part].mean() == pytest.approx(float(reference[part].mean()), rel=tolerance)
        assert (found[part] - reference[part]).norm() < 2 * tolerance * reference[part].norm()


def test_radiance_is_linear_in_the_lighting(in_bowl):
    _, method, gbuffer = in_bowl
    a, b = (method.shade(gbuffer, method.light(lighting(seed))) for seed in (1, 2))
    both = method.shade(gbuffer, method.light(lighting(1) + 3 * lighting(2)))
    assert both.abs().mean() > 0.01
    torch.testing.assert_close(both, a + 3 * b, rtol=1e-3, atol=1e-5)


def test_a_strong_window_leaves_the_mean_of_the_lighting(in_bowl):
    task, method, gbuffer = in_bowl
    d = texel_directions(R)[..., 2:].expand(-1, -1, -1, 3)
    mean, sided = torch.full((6, R, R, 3), 0.7), 0.7 + 0.5 * d
    plain = method.shade(gbuffer, method.light(mean))
    assert (method.shade(gbuffer, method.light(sided)) - plain).abs().max() > 0.02
    method.window = 1e6
    try:
        damped = method.shade(gbuffer, method.light(sided))
    finally:
        method.window = 0.0
    torch.testing.assert_close(damped, plain, rtol=1e-3, atol=1e-4)


def test_an_empty_view_gives_no_radiance(in_bowl):
    _, method, gbuffer = in_bowl
    nothing = gbuffer.rows(torch.zeros(0, dtype=torch.long))
    assert method.shade(nothing, method.light(lighting(1))).shape == (0, 3)


# ---- fitting and storage


def test_a_stopped_fit_ends_as_one_in_one_go(in_bowl, monkeypatch):
    task, whole, _ = in_bowl
    monkeypatch.setattr("prt.methods.sh_matrix_vertex.SAMPLES", 512 * 100)

    class Stops(Log):
        def step(self, step, **values):
            if step == 3:
                raise InterruptedError

    log, settings = Stops(), (4, 512, 2.0, 1.0)
    with pytest.raises(InterruptedError):
        ShMatrixVertex(*settings).fit(task, log, 0, "cpu")
    assert log.kept[0] == 2 and len(log.kept[1]["matrices"]) == 200
    resumed, straight = ShMatrixVertex(*settings), ShMatrixVertex(*settings)
    resumed.fit(task, Log(log.kept), 0, "cpu")
    straight.fit(task, Log(), 0, "cpu")
    code = straight.light(lighting(1))
    assert torch.equal(resumed.light(lighting(1)), code)
    assert not torch.equal(whole.light(lighting(1)), code)  # other blocks, other random numbers


def test_a_saved_model_renders_the_same(in_bowl, tmp_path):
    task, method, gbuffer = in_bowl
    path = tmp_path / "checkpoint.safetensors"
    method.save(path)
    other = ShMatrixVertex(4, 512, 2.0, 1.0)
    other.load(path, task, "cpu")
    shaded = [m.shade(gbuffer, m.light(lighting(1))) for m in (method, other)]
    assert torch.equal(*shaded)
    assert other.nbytes() == method.nbytes() >= 2 * 3 * 25**2 * 100
    assert isinstance(method, Method) and method.component is Component.INDIRECT


def test_refuses_a_checkpoint_of_something_else(in_bowl, tmp_path):
    task, method, _ = in_bowl
    path = tmp_path / "checkpoint.safetensors"
    method.save(path)
    with pytest.raises(PrtError, match="method.degree=3 means 16; set method.degree=4"):
        ShMatrixVertex(3, 512, 2.0, 1.0).load(path, task, "cpu")
    corner = task_of(Shapes(lambda: corner_shapes(diffuse((0.5, 0.5, 0.5))), AT_CORNER))
    with pytest.raises(PrtError, match="vertices, the scene"):
        ShMatrixVertex(4, 512, 2.0, 1.0).load(path, corner, "cpu")


# ---- refusals


@pytest.mark.parametrize(
    "changed, named",
    [
        ({"degree": 0}, "degree=0.*1 to 15"),
        ({"degree": True}, "degree=True"),
        ({"paths": 2.5}, "paths=2.5"),
        ({"edge_pixels": 0}, "edge_pixels=0 must be a number above 0"),
        ({"spacing_pixels": -1.0}, "spacing_pixels=-1.0 must be a number of 0 or more"),
        ({"window": "much"}, "window='much'"),
        ({"memory_gb": float("nan")}, "memory_gb=nan"),
    ],
)
def test_refuses_settings(changed, named):
    settings = {"degree": 4, "paths": 16, "edge_pixels": 2.0, "spacing_pixels": 1.0}
    with pytest.raises(PrtError, match=named) as caught:
        ShMatrixVertex(**(settings | changed))
    assert "\n" not in str(caught.value)


def test_refuses_more_memory_than_is_allowed(in_bowl):
    with pytest.raises(PrtError, match=r"memory_gb=0.001 allows less.*spacing_pixels.*degree") as caught:
        fitted(in_bowl[0], memory_gb=0.001)
    assert "\n" not in str(caught.value)


def test_refuses_to_render_before_it_is_fitted(in_bowl, tmp_path):
    new = ShMatrixVertex(2, 16, 2.0, 1.0)
    for use in (lambda: new.light(lighting(1)), lambda: new.shade(in_bowl[2], torch.zeros(9, 9)), new.nbytes,
                lambda: new.save(tmp_path / "none")):  # fmt: skip
        with pytest.raises(PrtError, match="no matrices yet"):
            use()


def test_the_configuration_builds_it():
    for budget in ("smoke", "laptop", "gpu", "paper"):
        method = instantiate(compose(["method=sh_matrix_vertex", f"budget={budget}"]).method)
        assert isinstance(method, ShMatrixVertex) and method.degree == 8 and method.window == 0

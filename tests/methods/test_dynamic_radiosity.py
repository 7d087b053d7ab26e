"""Dynamic radiosity where the answer is known: a closed furnace that a variable dims."""

import copy
import types

import pytest
import torch
from omegaconf import OmegaConf

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.methods import dynamic_radiosity as module
from prt.methods.base import Silent
from prt.methods.dynamic_radiosity import DynamicRadiosity
from prt.nn.radiance_network import RadiancePoints, positive
from prt.scene.capture import capture
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

INSIDE = View((0.3, 0.2, 0.9), (-0.2, 0.0, -1.0), (0.0, 1.0, 0.0), 70.0, 16, 16)


class Furnace:
    """A closed cube whose walls all emit 0.5 + v and reflect ``albedo``: reflected is their product over
    1 - albedo, everywhere."""

    def __init__(self, albedo=0.5):
        mi = mitsuba()
        light = {"type": "area", "radiance": {"type": "rgb", "value": [1.0] * 3}}
        wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [albedo] * 3}}
        cube = {"type": "cube", "flip_normals": True, "bsdf": wall, "light": light}
        self.mi_scene = mi.load_dict({"type": "scene", "cube": cube})
        self.params = mi.traverse(self.mi_scene)
        self.key = next(k for k in self.params.keys() if "radiance" in k)
        self.v = None

    def set(self, v):
        import drjit as dr

        value = [float(x) for x in v]
        if value != self.v:
            self.v, color = value, mitsuba().Color3f(0.5 + (value[0] if value else 0.5))
            dr.make_opaque(color)
            self.params[self.key] = color
            self.params.update()


def task(dimension=1, albedo=0.5):
    return types.SimpleNamespace(
        name="animate", dimension=dimension, bounds=([-1.01] * 3, [1.01] * 3), stage=Furnace(albedo),
        walk_views=lambda: [INSIDE],
    )  # fmt: skip


def settings(steps=150, **changes):
    training = {
        "steps": steps, "batch": 256, "samples": 4, "per_state": 1, "adaptive": True, "loss": "relative",
        "detach": True, "epsilon": 0.1, "rate": 5e-3, "grid_rate": 2e-2, "decay": 0.33, "average": 0.9,
        "sampling": "bsdf", "emitters": True,
    }  # fmt: skip
    grid = {"levels": 2, "features": 2, "log2_table": 12, "base_resolution": 4, "scale": 2.0}
    planes = {"levels": 2, "features": 2, "base_resolution": 4, "scale": 2.0}
    own = {
        "grid": grid, "planes": planes, "state": {"width": 16, "hidden_layers": 1, "octaves": 2},
        "direction_degree": 2, "normal_degree": 1, "albedo_bins": 4, "width": 32, "hidden_layers": 2,
    }  # fmt: skip
    training |= {k: changes.pop(k) for k in list(changes) if k in training}
    return OmegaConf.to_container(OmegaConf.create({**own, "training": training, **changes}))


def fitted(where, **changes):
    method = DynamicRadiosity(**settings(**changes))
    method.fit(where, Silent(), 0, "cpu")
    return method


def rendered(method, where, v):
    code = method.light(torch.tensor(v))
    gbuffer = capture(where.stage.mi_scene, INSIDE)
    return method.shade(gbuffer, code)


@pytest.mark.parametrize(
    "changes", [{}, {"loss": "plain"}, {"detach": False}, {"sampling": "uniform", "emitters": False},
                {"encoding": "conditioned"}, {"per_state": 2}],
    ids=["relative", "plain", "both_sides", "as_the_paper_samples", "conditioned", "two_steps_a_state"],
)  # fmt: skip
def test_a_furnace_that_is_dimmed_is_solved_in_all_states(changes):
    where = task()
    method = fitted(where, **changes)
    for v in (0.1, 0.5, 0.9):
        # what is seen: emitted and reflected, which is as much again at albedo 0.5
        found = rendered(method, where, [v])
        assert found.mean() == pytest.approx(2 * (0.5 + v), rel=0.06)


@pytest.mark.parametrize("encoding", ["decomposed", "static"])
def test_without_variables_it_is_neural_radiosity(encoding):
    where = task(0)
    method = fitted(where, encoding=encoding, steps=100)
    assert len(method.net.encodings) == 1 and method.net.state is None
    assert rendered(method, where, []).mean() == pytest.approx(2.0, rel=0.06)


def test_the_right_hand_side_is_closer_than_the_left():
    where = task()
    method = fitted(where, steps=60)
    method.fxaa = False
    left = rendered(method, where, [0.9])
    method.right_hand = 64
    right = rendered(method, where, [0.9])
    truth = 2 * 1.4
    assert (right - truth).abs().mean() < (left - truth).abs().mean()


def test_it_is_the_same_from_a_file(tmp_path):
    where = task()
    method = fitted(where, steps=5)
    method.save(tmp_path / "model.safetensors")
    again = DynamicRadiosity(**settings(steps=5))
    again.load(tmp_path / "model.safetensors", where, "cpu")
    assert torch.equal(rendered(again, where, [0.3]), rendered(method, where, [0.3]))
    other = DynamicRadiosity(**settings(steps=5, width=16))
    with pytest.raises(PrtError, match="other sizes"):
        other.load(tmp_path / "model.safetensors", where, "cpu")
    assert method.nbytes() == sum(method.sized_parts().values())


def test_radiance_that_grows_without_bound_stops_the_fit(monkeypatch):
    monkeypatch.setattr(module, "DIVERGED", 3.0)
    with pytest.raises(PrtError, match="diverged at step .* the last checkpoint is kept"):
        fitted(task(albedo=0.99), steps=400)


def test_a_scene_without_light_is_refused():
    where = task()
    where.stage.set = lambda v: None
    mi = mitsuba()
    where.stage.mi_scene = mi.load_dict({"type": "scene", "cube": {"type": "cube", "flip_normals": True}})
    with pytest.raises(PrtError, match="no light of the scene"):
        fitted(where, steps=2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"encoding": "nerf"}, "method.encoding='nerf' is not one of decomposed"),
        ({"loss": "l1"}, "method.training.loss='l1' is not one of plain, relative"),
        ({"batch": 0}, "method.training.batch=0"),
        ({"pixel_samples": 0}, "method.pixel_samples=0"),
    ],
)
def test_settings_out_of_range_are_one_line(changes, words):
    with pytest.raises(PrtError, match=words):
        DynamicRadiosity(**settings(**changes))


def test_the_output_is_positive_smooth_and_never_flat():
    x = torch.tensor([-50.0, -1.0, -1e-4, 0.0, 1e-4, 50.0], requires_grad=True)
    y = positive(x)
    assert (y > 0).all() and (y[1:] > y[:-1]).all()
    (slope,) = torch.autograd.grad(y.sum(), x)
    torch.testing.assert_close(
        slope, torch.tensor([1 / 51**2, 0.25, 1.0, 1.0, 1.0, 1.0]), atol=1e-3, rtol=1e-3
    )


def test_the_network_knows_the_state_once_and_not_per_point():
    method = DynamicRadiosity(**settings())
    net = method.network(([-1.0] * 3, [1.0] * 3), 3)
    v = torch.rand(3)
    code = net.at(v)
    unit = torch.nn.functional.normalize(torch.randn(7, 3), dim=1)
    points = RadiancePoints(torch.rand(7, 3), unit, unit, torch.rand(7, 3), torch.ones(7, 3), torch.arange(7))
    features = net.features(points, code)
    # the folded first layer is the plain one on all inputs
    plain = net.decoder(torch.cat([features, net.state(v).expand(7, -1)], dim=1))
    out = positive(plain) * net.scale
    torch.testing.assert_close(net(points, code), points.albedo * out[:, :3] + out[:, 3:])
    plainer = DynamicRadiosity(**settings(demodulate=False)).network(([-1.0] * 3, [1.0] * 3), 3)
    assert plainer.decoder.layers[-1].out_features == 3
    assert plainer(points, plainer.at(v)).shape == (7, 3)


class Interrupted(Silent):
    """Keeps one state and stops there, or goes on from it."""

    def __init__(self, at=None, kept=None):
        self.at, self.kept = at, kept

    def checkpoint_due(self, step):
        return step == self.at

    def save(self, step, state):
        self.kept = step, copy.deepcopy(state)
        raise KeyboardInterrupt

    def resume(self):
        return self.kept


@pytest.mark.parametrize("per_state", [1, 3])
def test_a_resumed_fit_ends_where_an_uninterrupted_one_does(per_state):
    whole = fitted(task(), steps=10, per_state=per_state)
    log = Interrupted(at=4)
    with pytest.raises(KeyboardInterrupt):
        DynamicRadiosity(**settings(steps=10, per_state=per_state)).fit(task(), log, 0, "cpu")
    again = DynamicRadiosity(**settings(steps=10, per_state=per_state))
    again.fit(task(), Interrupted(kept=log.kept), 0, "cpu")
    for a, b in zip(whole.net.parameters(), again.net.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


def test_many_factors_share_the_rate_of_three():
    """All planes of K-planes step at once; a product of hundreds of factors would grow without bound."""

    def rate(name: str, variables: int) -> float:
        cfg = compose(["task=animate", f"method={name}", "budget=smoke"])
        method = build(cfg, "method")
        method.net = method.network(([0.0] * 3, [1.0] * 3), variables)
        groups = method.optimiser().param_groups
        assert sum(len(group["params"]) for group in groups) == len(list(method.net.parameters()))
        return groups[0]["lr"]

    whole = rate("dynamic_radiosity", 7)
    assert rate("dynamic_radiosity", 2) == whole
    assert rate("kplanes", 1) == pytest.approx(whole / 2) and rate("kplanes", 23) == pytest.approx(
        whole * 3 / 325
    )


def test_the_usual_brightness_is_neither_that_of_fireflies_nor_of_points_that_found_no_light(monkeypatch):
    """Few points of a room find its window in so many directions, and one has found the sun."""
    known = torch.full((512, 3), 0.001)
    known[::10] = 1.0
    known[1] = 1e6
    answers = types.SimpleNamespace(known=known)
    monkeypatch.setattr(module, "right_hand_side", lambda *_: answers)
    surface = types.SimpleNamespace(sample=lambda count, seed: (None, count))
    stage = types.SimpleNamespace(set=lambda v: None, mi_scene=None)
    method = types.SimpleNamespace(stage=stage, encoding="decomposed", static_state=None)
    residual = module.Residual(method, surface, 2, torch.Generator().manual_seed(0))
    assert 0.05 < residual.scale() < 0.2 and residual.brightest > 1000
    known[:] = 0.0
    with pytest.raises(PrtError, match="no light of the scene reaches"):
        residual.scale()

"""Equal-time calibration on a made-up clock, and real frames of a built-in scene against its reference."""

import time
import types

import pytest
import torch
from kept_log import Log

from prt.errors import PrtError
from prt.methods import path_traced
from prt.methods.path_traced import PathTraced, affordable_samples
from prt.scene.view import View


@pytest.mark.parametrize("seconds, expected", [(0.5, 1), (10.0, 4), (12.0, 5), (100.0, 49)])
def test_affordable_samples_of_an_affine_cost(monkeypatch, seconds, expected):
    clock = types.SimpleNamespace(now=0.0)
    monkeypatch.setattr(path_traced.time, "perf_counter", lambda: clock.now)

    def frame(samples):
        clock.now += 2.0 + 2.0 * samples

    assert affordable_samples(frame, seconds) == expected


def test_settings():
    with pytest.raises(PrtError, match="exactly one"):
        PathTraced(frame_seconds=None)
    with pytest.raises(PrtError, match="exactly one"):
        PathTraced(frame_seconds=1.0, samples=4)
    with pytest.raises(PrtError, match="frame_seconds=-1"):
        PathTraced(frame_seconds=-1.0)
    with pytest.raises(PrtError, match="samples=0"):
        PathTraced(frame_seconds=None, samples=0)


@pytest.fixture(scope="module")
def task():
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    from prt.bench.compose import conf_folder
    from prt.scene.capture import capture

    scene = instantiate(OmegaConf.load(conf_folder() / "scene" / "cornell_glossy.yaml"))
    view = scene.views("far", 1, 24)[0]
    generator = torch.Generator().manual_seed(0)
    lighting = torch.rand((6, 8, 8, 3), generator=generator)
    item = types.SimpleNamespace(gbuffer=capture(scene.load(), view), lighting=lighting)
    return types.SimpleNamespace(name="relight_indirect", scene=scene, tests=lambda: [item])


def fitted(task, seed=0, **settings) -> PathTraced:
    method = PathTraced(**settings)
    method.fit(task, Log(), seed, "cpu")
    return method


def test_agrees_with_the_reference_and_improves_with_samples(task):
    from prt.trace.reference import render

    item = task.tests()[0]
    depth = task.scene.max_depth
    reference = render(task.scene, item.gbuffer.view, item.lighting, 1024, depth, 3)["indirect"]
    truth = reference.reshape(-1, 3)[item.gbuffer.hit]
    errors = {}
    few, many, clean = dict(samples=4), dict(samples=64), dict(samples=4, denoise=True)
    for name, settings in {"4": few, "64": many, "4 denoised": clean}.items():
        method = fitted(task, frame_seconds=None, **settings)
        radiance = method.shade(item.gbuffer, method.light(item.lighting))
        assert radiance.shape == (len(item.gbuffer), 3)
        errors[name] = float((radiance - truth).square().mean())
        assert abs(float(radiance.mean() / truth.mean()) - 1) < 0.1
    assert errors["64"] < 0.3 * errors["4"]  # 1/16 expected
    assert errors["4 denoised"] < errors["4"]


def test_fit_calibrates_saves_and_resumes(task, tmp_path):
    method, log = PathTraced(frame_seconds=0.2), Log()
    started = time.perf_counter()
    method.fit(task, log, 5, "cpu")
    assert time.perf_counter() - started < 30
    assert method.samples >= 1 and log.values == {"samples": float(method.samples)}
    resumed = PathTraced(frame_seconds=1e-9)
    resumed.fit(task, Log(log.kept), 5, "cpu")
    assert resumed.samples == method.samples
    method.samples = 2
    method.save(tmp_path / "checkpoint.safetensors")
    again = PathTraced(frame_seconds=0.2)
    again.load(tmp_path / "checkpoint.safetensors", task, "cpu")
    item = task.tests()[0]
    assert torch.equal(again.shade(item.gbuffer, item.lighting), method.shade(item.gbuffer, item.lighting))
    assert again.nbytes() == 0


def test_black_light_empty_view_and_single_points(task):
    item, method = task.tests()[0], fitted(task, frame_seconds=None, samples=1, denoise=True)
    black = method.shade(item.gbuffer, torch.zeros((6, 8, 8, 3)))
    assert torch.equal(black, torch.zeros((len(item.gbuffer), 3)))
    empty = item.gbuffer.rows(torch.zeros(0, dtype=torch.int64))
    with pytest.raises(PrtError, match="whole images"):
        method.shade(empty, item.lighting)
    empty.hit = torch.zeros(24 * 24, dtype=torch.bool)
    empty.view = View((0, 0, 9), (0, 0, 10), width=24, height=24)
    assert method.shade(empty, item.lighting).shape == (0, 3)


def test_unfitted_is_an_error(task):
    with pytest.raises(PrtError, match="fit it or load"):
        PathTraced(frame_seconds=1.0).shade(task.tests()[0].gbuffer, task.tests()[0].lighting)

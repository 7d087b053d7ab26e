"""The task on the real scene at a size of seconds: its data, its splits, its caches, its error split."""

import dataclasses
import math
import types
import warnings

import pytest
import tiny
import torch

from prt.bench.build import build as build_group
from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.light import haar
from prt.methods.wavelet_neural import WaveletNeural
from prt.metrics.image import PSNR_CAP
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.tasks.relight_indirect import product_psnr
from prt.trace.rooms import ProceduralEnvironments

#: every texel and every wavelet of a tiny lighting
ALL = 6 * tiny.RESOLUTION**2


def build(maps, *overrides):
    return build_task(compose([*tiny.TASK, *tiny.lights(maps), *overrides]))


def equal(a, b) -> bool:
    return all(torch.equal(getattr(a, f), getattr(b, f)) for f in ("offsets", "texel", "weight", "bounces"))


# ---- training data


def test_training_points_carry_their_transport(tiny_task):
    data = tiny_task.training()
    count = len(data.gbuffer)
    assert 0 < count < 4 * 8 * 8 and data.transport.pixels == count == len(data.point_view)
    assert (data.transport.bounces >= 2).all() and data.transport.resolution == tiny.RESOLUTION
    assert set(data.importance) == {"specular", "high_frequency", "view_variance"}
    assert all(
        w.shape == (count,) and (w >= 0).all() and w.isfinite().all() for w in data.importance.values()
    )
    low, high = (torch.tensor(corner) for corner in data.bounds)
    assert ((data.gbuffer.position >= low) & (data.gbuffer.position <= high)).all()
    # a point belongs to the view that its wo points to
    for number in range(4):
        mine = data.point_view == number
        assert mine.any()
        towards = torch.tensor(data.views[number].origin) - data.gbuffer.position[mine]
        towards = torch.nn.functional.normalize(towards, dim=1)
        assert torch.allclose(towards, data.gbuffer.wo[mine], atol=1e-4)


def test_pixel_size_is_the_distance_between_neighbouring_pixels_that_face_the_camera(tiny_task):
    """A plane seen head-on: all neighbouring points lie one pixel width apart."""
    data = tiny_task.training()
    view = dataclasses.replace(data.views[0], origin=(0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), fov=40.0)
    width = 2 * 4 * math.tan(math.radians(20)) / view.width
    x = (torch.arange(view.width) - (view.width - 1) / 2) * width
    plane = torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)], dim=1)
    gbuffer = dataclasses.replace(data.gbuffer, position=plane)
    flat = dataclasses.replace(
        data, gbuffer=gbuffer, views=[view], point_view=torch.zeros(len(plane), dtype=torch.long)
    )
    neighbours = (plane[1:] - plane[:-1]).norm(dim=1).median()
    # towards the edge of the image a pixel is a little farther away
    assert neighbours <= flat.pixel_size < 1.1 * neighbours


def test_pixel_size_is_known_without_recording(tiny_task, monkeypatch):
    expected = tiny_task.training().pixel_size
    monkeypatch.setattr(type(tiny_task), "training", None)
    vars(tiny_task).pop("pixel_size", None)
    assert tiny_task.pixel_size == expected


def test_a_grid_sized_by_training_pixels_has_cells_of_that_width(tiny_task, maps):
    settings = ["method=wavelet_neural", "method.grid.finest_pixels=1.5", "method.training.steps=1"]
    method = build_group(compose([*tiny.TASK, *tiny.lights(maps), *settings]), "method")
    method.fit(tiny_task, tiny.Log(), 0, "cpu")
    width = 1 / float(method.net.grid.per_unit.max())
    # the finest level has a whole number of cells
    assert width == pytest.approx(1.5 * tiny_task.training().pixel_size, rel=0.1)


def test_recorded_training_radiance_is_that_of_the_renderer(tiny_task):
    """Mean over all points, under the prior: recorder and ``path`` integrator estimate the same number."""
    from prt.trace.reference import render

    data, prior = tiny_task.training(), tiny_task.prior()
    recorded = data.transport.relight(prior[None])[0].mean()
    cubemap = prior.view(6, tiny.RESOLUTION, tiny.RESOLUTION, 3)
    depth, total = tiny_task.scene.max_depth, 0.0
    for view in data.views:
        hit = capture(tiny_task.mitsuba_scene, view).hit
        image = render(tiny_task.scene, view, cubemap, 64, depth, 7)["indirect"]
        total += float(image.reshape(-1, 3)[hit].sum())
    assert float(recorded) == pytest.approx(total / (3 * len(data.gbuffer)), rel=0.05)


def test_scenes_lit_through_openings_are_recorded_with_the_prior(own_cache, maps, tiny_task):
    """``record: nee`` draws from the prior: other samples, the same transport in the mean."""
    task = build(maps, "scene.record=nee", "task.train_views=1")
    bsdf = build(maps, "task.train_views=1")
    prior = tiny_task.prior()[None]
    means = [float(t.training().transport.relight(prior).mean()) for t in (task, bsdf)]
    assert len(task.training().transport.texel) > 1.2 * len(bsdf.training().transport.texel)
    assert means[0] == pytest.approx(means[1], rel=0.25)


# ---- splits


@pytest.mark.parametrize(("train", "near"), [(4, 1), (5, 3), (96, 4), (96, 20), (7, 7)])
@pytest.mark.parametrize("name", ["cornell_glossy", "four_shapes", "mirror_room"])
def test_no_test_view_was_trained_on(name, train, near):
    scene: Scene = build_group(compose([f"scene={name}"]), "scene")

    def poses(views):
        return torch.tensor([[*view.origin, *view.target] for view in views])

    trained = poses(scene.views("train", train, 8))
    for split in ("near", "far"):
        tested = poses(scene.views(split, near, 8, train_count=train))
        assert len(tested) == near and len(torch.unique(tested, dim=0)) == near
        assert torch.cdist(tested, trained).min() > 1e-3 * trained.std(), split


def test_training_and_test_lightings_are_disjoint(tiny_task):
    _, train = tiny_task.lighting.train()
    names, test = tiny_task.lighting.test()
    assert names == ["d", "e"] or names == ["e", "d"]
    assert torch.cdist(train.flatten(1), test.flatten(1)).min() > 0.1 * train.flatten(1).norm(dim=1).mean()
    assert {item.lighting_name for item in tiny_task.tests()} <= {"d", "e"}
    assert torch.equal(tiny_task.prior(), tiny_task.train_lightings().mean(0))


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_procedural_seeds_of_training_and_tests_never_meet(seed):
    sets = [ProceduralEnvironments(8, 700, 300, 90, 90, seed=s) for s in (seed, seed + 1)]
    groups = [set(s.seeds(split, 700)) for s in sets for split in ("train", "test")]
    assert sum(map(len, groups)) == len(set.union(*groups)) == 4 * 700


# ---- references


def test_references_do_not_depend_on_the_cache(tiny_task, maps, warm_cache, tmp_path, monkeypatch):
    first = tiny_task.tests()
    for folder in (warm_cache, tmp_path / "other"):  # read back, then rendered once more
        monkeypatch.setenv("PRT_CACHE", str(folder))
        for one, other in zip(first, build(maps).tests(), strict=True):
            assert (one.split, one.view_name, one.lighting_name) == (
                other.split, other.view_name, other.lighting_name
            )  # fmt: skip
            assert one.noise_floor == other.noise_floor and torch.equal(one.direct, other.direct)
            for name in one.references:
                assert torch.equal(one.references[name], other.references[name])
            for name in (*GBuffer.FIELDS, "hit"):
                assert torch.equal(getattr(one.gbuffer, name), getattr(other.gbuffer, name))


def test_components_add_up_and_composing_adds_other_direct_light(tiny_task):
    for item in tiny_task.tests():
        r = item.references
        assert torch.allclose(r["full"], r["direct"] + r["indirect"], atol=1e-5)
        assert (r["indirect"] >= 0).all() and r["indirect"].max() > 0
        made = tiny_task.compose(item, r["indirect"], "indirect")
        assert set(made) == set(tiny_task.components) and torch.equal(made["indirect"], r["indirect"])
        # independent noise: an oracle's full image is not the reference itself
        assert not torch.equal(made["full"], r["full"])
        assert float((made["full"] - r["full"]).mean().abs()) < 0.2 * float(r["full"].mean())
    with pytest.raises(PrtError, match="not full"):
        tiny_task.compose(item, r["full"], "full")


# ---- caches


@pytest.mark.parametrize("kind", ["transport", "reference"])
@pytest.mark.parametrize("damage", ["truncated", "flipped"])
def test_damaged_caches_are_named_and_rebuilt(kind, damage, maps, tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    few = ["task.train_views=2", "task.train_spp=2"]

    def content(task):
        return task.training().transport if kind == "transport" else task.tests()[0].references["full"]

    whole = content(build(maps, *few))
    path = sorted((tmp_path / kind).glob("*.safetensors"))[0]
    blob = path.read_bytes()
    middle = len(blob) // 2
    damaged = blob[:middle] + bytes([blob[middle] ^ 16]) + blob[middle + 1 :]
    path.write_bytes(blob[: middle + 1] if damage == "truncated" else damaged)
    with pytest.warns(UserWarning, match=f"{path.name} is damaged"):
        again = content(build(maps, *few))
    assert equal(whole, again) if kind == "transport" else torch.equal(whole, again)
    assert path.read_bytes() == blob
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        content(build(maps, *few))


def test_what_determines_the_content_makes_another_cache_entry(maps, tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    few = ["task.train_views=1", "task.train_spp=2", "task.train_size=4"]

    def entries(*overrides):
        build(maps, *few, *overrides).training()
        return len(list((tmp_path / "transport").iterdir()))

    assert entries() == entries() == 1
    for number, change in enumerate(
        [
            "task.train_spp=3",
            "task.seed=1",
            "scene.floor_roughness=0.3",
            "scene.max_depth=3",
            "task.resolution=4",
        ]
    ):
        assert entries(change) == number + 2, change
    assert entries("lighting.train_count=2") == 6  # a record serves all lightings
    assert entries("scene.record=nee") == 7
    assert entries("scene.record=nee", "lighting.train_count=2") == 8  # but this one draws from their mean


# ---- error split


def untrained(task, wavelets: int) -> WaveletNeural:
    settings = [
        *tiny.TASK,
        "method=wavelet_neural",
        f"method.wavelets={wavelets}",
        "method.selection=magnitude",
    ]
    method = build_group(compose(settings), "method")
    torch.manual_seed(0)
    method.build(task.training().bounds, task.resolution, torch.ones(ALL), "cpu")
    return method


def test_nothing_is_lost_where_all_wavelets_are_kept(tiny_task, own_cache):
    item = tiny_task.tests()[0]
    image = item.references["indirect"]
    parts = tiny_task.error_split(item, image, untrained(tiny_task, ALL))
    assert parts["psnr/truncation"] == parts["psnr/fit"] == PSNR_CAP
    assert parts["psnr/noise"] == item.noise_floor["indirect"]


def test_truncation_shrinks_with_more_wavelets_and_fit_is_apart_from_it(tiny_task, own_cache):
    item = tiny_task.tests()[0]
    reference = item.references["indirect"]
    found = {k: tiny_task.error_split(item, reference * 1.2, untrained(tiny_task, k)) for k in (4, 200, ALL)}
    truncation = [found[k]["psnr/truncation"] for k in (4, 200, ALL)]
    assert truncation[0] < truncation[1] < truncation[2] == PSNR_CAP
    assert found[ALL]["psnr/fit"] < 40  # a fifth too bright, and nothing is truncated


def test_the_truncated_truth_has_no_fit_error(tiny_task, own_cache):
    """An oracle that renders the kept wavelets exactly: all that is left is truncation."""
    item, method = tiny_task.tests()[0], untrained(tiny_task, 4)
    lost = (item.lighting - method.truncated(item.lighting)).reshape(1, -1, 3)
    assert haar.forward(lost.view(6, 8, 8, 3)).abs().sum() > 0
    # truth and split from one and the same record: no noise between them
    _, transport = tiny_task.recorded(item.gbuffer.view, tiny_task.split_spp, 9000)
    missing = transport.component("indirect").relight(lost)[0].view(item.references["indirect"].shape)
    oracle = item.references["indirect"] - missing
    parts = tiny_task.error_split(item, oracle, method)
    assert parts["psnr/fit"] == PSNR_CAP  # one of its two estimates is exactly zero
    assert parts["psnr/truncation"] < 60


def test_methods_without_truncation_get_the_noise_alone(tiny_task):
    item = tiny_task.tests()[0]
    assert set(tiny_task.error_split(item, item.references["indirect"], types.SimpleNamespace())) == {
        "psnr/noise"
    }


def test_product_of_two_estimates_removes_their_noise():
    generator = torch.Generator().manual_seed(0)
    error, shape = 0.02, (200, 200, 3)
    first, second = (error + 0.1 * torch.randn(shape, generator=generator).numpy() for _ in range(2))
    assert product_psnr(first, second) == pytest.approx(34.0, abs=1.0)  # 20 log10 of 1 / 0.02
    assert product_psnr(0 * first, second) == PSNR_CAP == product_psnr(-first, first)


# ---- mistakes


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("task.resolution=12", "task.resolution=12 must be a power of two"),
        ("task.train_spp=0", "task.train_spp=0 must be at least 1"),
        ("task.reference_spp=0", "task.reference_spp=0 must be at least 1"),
        ("task.lightings_per_view=-1", "task.lightings_per_view=-1 must be at least 1"),
    ],
)
def test_bad_sizes_are_named(maps, override, says):
    with pytest.raises(PrtError, match=says):
        build(maps, override, "lighting.resolution=8")


def test_cameras_that_see_nothing_in_training_are_named(tiny_task, maps, own_cache, monkeypatch):
    task = build(maps)
    away = View((0.0, 0.7, 3.0), (0.0, 0.7, 9.0), width=8, height=8)
    monkeypatch.setattr(task.scene, "views", lambda *_, **__: [away, away])
    with pytest.raises(PrtError, match="no training view of scene 'cornell_glossy' sees the scene"):
        task.training()


def test_one_empty_training_view_among_others_is_fine(tiny_task, maps, own_cache, monkeypatch):
    task = build(maps)
    away = View((0.0, 0.7, 3.0), (0.0, 0.7, 9.0), width=8, height=8)
    views = task.scene.views("train", 2, 8)
    monkeypatch.setattr(task.scene, "views", lambda *_, **__: [views[0], away, views[1]])
    data = task.training()
    assert set(data.point_view.tolist()) == {0, 2} and len(data.gbuffer) == data.transport.pixels
    assert all(weights.isfinite().all() for weights in data.importance.values())

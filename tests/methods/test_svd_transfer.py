"""Data-driven transfer on a small baked asset, and its settings."""

import dataclasses

import pytest
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.light.local import LightRig
from prt.methods.benchmark_svd import Silent, Storage, capacity, eigenvalues, fitted, storage
from prt.methods.stability_svd import flicker, judged, measure_failures
from prt.methods.svd_transfer import SvdTransfer

COMMON = ["task=local_lights", "lighting=spots_inside", "method=svd_transfer", "budget=smoke"]
SETTINGS = dict(
    basis=4, target_error=0.1, held_out=0.25, points=24, supersample=2, regularisation=1e-3,
    channels="shared", gamma=1.0, normalise="l1", keyframes="shared", renderer="torch",
)  # fmt: skip


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("PRT_CACHE", str(tmp_path_factory.mktemp("cache")))
    cfg = compose([*COMMON, "scene=cornell_box", "task.train_count=24", "task.path_steps=3",
                   "task.others=[coloured]", "task.texels=24"])  # fmt: skip
    yield build_task(cfg)
    patch.undo()


def lightmaps(task, model):
    items = [item for item in task.tests() if item.view_name == "lightmap" and item.split == "same"]
    return [(item, model.shade(item.gbuffer, model.light(item.lighting))) for item in items]


def test_training_lights_are_reproduced_when_nothing_is_left_out(task):
    whole = dict(channels="interleaved", points=256, supersample=1, regularisation=None)
    model = fitted(task, SETTINGS, basis=24, **whole)  # as many elements as vectors
    database = task.database()
    gbuffer = task.asset.texel_gbuffer()
    for rig, truth in list(zip(database.rigs, database.lightmaps, strict=True))[:4]:
        found = model.shade(gbuffer, model.light(rig))
        assert float((found - truth).norm() / truth.norm()) < 1e-2
    worse = fitted(task, SETTINGS, basis=2, **whole)
    found = worse.shade(gbuffer, worse.light(database.rigs[0]))
    assert float((found - database.lightmaps[0]).norm() / database.lightmaps[0].norm()) > 0.1


def test_prediction_is_linear_in_brightness_and_black_without_light(task):
    model = fitted(task, SETTINGS)
    item = task.tests()[0]
    once = model.shade(item.gbuffer, model.light(item.lighting))
    thrice = model.shade(item.gbuffer, model.light(item.lighting.scaled(3.0)))
    assert torch.allclose(thrice, 3 * once, rtol=1e-4, atol=1e-6 * float(once.max()))
    assert float(model.shade(item.gbuffer, model.light(LightRig())).abs().max()) == 0


@pytest.mark.parametrize("changes", [
    {}, {"channels": "interleaved"}, {"channels": "separate"}, {"gamma": 2.2}, {"normalise": "l2"},
    {"normalise": "none"},
])  # fmt: skip
def test_the_projection_is_a_bound_and_saving_loses_nothing(task, changes, tmp_path):
    model = fitted(task, SETTINGS, **changes)
    model.save(tmp_path / "model.safetensors")
    again = SvdTransfer(**{**SETTINGS, **changes})
    again.load(tmp_path / "model.safetensors", task, "cpu")
    for item, found in lightmaps(task, model):
        truth = item.references["indirect"].reshape(-1, 3)[item.gbuffer.hit]
        bound = model.project(truth, item.lighting)
        assert bound.shape == truth.shape
        if model.gamma == 1:  # in gamma space the projection is best only there
            assert float((bound - truth).norm()) <= float((found - truth).norm()) * (1 + 1e-5)
        if model.normalise != "l2":  # between few points a spot's l2 norm is anything: a known failure
            assert float((found - truth).norm() / truth.norm()) < 0.9
        assert torch.equal(found, again.shade(item.gbuffer, again.light(item.lighting)))


def test_a_shader_gives_the_same_image(task):
    from prt.methods.blend_shader import available

    if available():
        pytest.skip(available())
    model, other = fitted(task, SETTINGS), fitted(task, SETTINGS, renderer="shader")
    item = next(item for item in task.tests() if item.view_name == "frame00")
    code = model.light(item.lighting)
    first, second = model.shade(item.gbuffer, code), other.shade(item.gbuffer, code)
    assert float((first - second).abs().max()) <= 1e-3 * float(first.abs().max())
    other.shader().release()


def test_the_number_of_elements_can_be_chosen(task):
    curve = {}

    class Log(Silent):
        def step(self, step, **values):
            curve[step] = values

    settings = {**SETTINGS, "points": 128}
    model = SvdTransfer(**settings)
    model.fit(task, Log(), 0, "cpu")
    errors = [curve[n]["held_out_error"] for n in sorted(curve)]
    target = (max(errors[1:]) + min(errors)) / 2
    chosen = SvdTransfer(**{**settings, "basis": "auto", "target_error": target})
    chosen.fit(task, Silent(), 0, "cpu")
    first = next(n for n, error in enumerate(errors, 1) if error <= target)
    assert len(chosen.basis) == first
    with pytest.raises(PrtError, match="target_error=1e-09 is not met.*at .* elements"):
        SvdTransfer(**{**settings, "basis": "auto", "target_error": 1e-9}).fit(task, Silent(), 0, "cpu")


@pytest.mark.parametrize(("changes", "says"), [
    ({"basis": 0}, "method.basis=0 must be"), ({"basis": "many"}, "or auto"),
    ({"regularisation": -0.1}, "method.regularisation=-0.1 must be at least 0"),
    ({"channels": "both"}, "shared, interleaved, separate"), ({"gamma": 0}, "method.gamma=0"),
    ({"normalise": "l3"}, "l2, l1, none"), ({"held_out": 1.0}, "method.held_out"),
])  # fmt: skip
def test_wrong_settings_are_one_line(changes, says):
    with pytest.raises(PrtError, match=says) as caught:
        SvdTransfer(**{**SETTINGS, **changes})
    assert "\n" not in str(caught.value)


def test_more_elements_than_configurations_and_too_many_points_are_one_line(task):
    with pytest.raises(PrtError, match="method.basis=25 is more elements than the 24 configurations"):
        fitted(task, SETTINGS, basis=25)
    with pytest.raises(PrtError, match="method.points=0 must be a whole number"):
        fitted(task, SETTINGS, points=0)


def test_only_places_of_the_asset_can_be_shaded(task):
    model = fitted(task, SETTINGS)
    item = task.tests()[0]
    parts = {name: getattr(item.gbuffer, name) for name in ("position", "normal", "wo", "wr", "diffuse",
             "specular", "roughness", "uv", "hit")}  # fmt: skip
    from prt.scene.gbuffer import GBuffer

    with pytest.raises(PrtError, match="G-buffer of its asset"):
        model.shade(GBuffer(**parts), model.light(item.lighting))
    with pytest.raises(PrtError, match="keyframes 0 to 0, not 3"):
        model.light(dataclasses.replace(item.lighting, pose=3))


def test_keyframes_share_a_basis_and_may_have_their_own_transfer(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    cfg = compose(["task=local_lights", "lighting=spots", "method=svd_transfer", "budget=smoke",
                   "scene=bending", "task.train_count=12", "task.texels=24", "task.frames=0"])  # fmt: skip
    task = build_task(cfg)
    assert {rig.pose for rig in task.database().rigs} == {0, 1}
    one, own = fitted(task, SETTINGS), fitted(task, SETTINGS, keyframes="separate")
    assert one.transfer.shape[0] == 1 and own.transfer.shape[0] == 2
    assert torch.equal(one.basis, own.basis)
    assert not torch.allclose(own.transfer[0], own.transfer[1])
    item = task.tests()[0]
    other = dataclasses.replace(item.lighting, pose=1 - item.lighting.pose)
    assert not torch.equal(own.light(item.lighting), own.light(other))


def test_transport_that_differs_from_channel_to_channel_is_learnt():
    """A medium that absorbs blue: the direct light on its white boundary does not say so."""
    from prt.tasks.local_lights import Database

    g = torch.Generator().manual_seed(0)
    light, transport = torch.rand((40, 6, 3), generator=g), torch.rand((50, 6), generator=g)
    absorbed = torch.tensor([1.0, 0.7, 0.2])
    maps = torch.einsum("tm,nmc->ntc", transport, light) * absorbed
    whole = torch.ones(50, dtype=torch.bool)
    rigs = [LightRig(pose=0) for _ in light]

    class Asset:
        size, poses, stores, covered = (5, 10), 1, "outgoing", whole

    class Task:
        asset = Asset()

        def database(self):
            return Database(rigs, maps, whole, torch.arange(50), (5, 10), 0.0)

    for channels in ("shared", "separate", "interleaved"):
        model = SvdTransfer(**{**SETTINGS, "basis": 20, "channels": channels, "regularisation": None})
        rows = iter(light)

        def take(task, seed, device, model=model, rows=rows):
            model.asset, model.meter = task.asset, lambda rig: next(rows)

        model._take = take
        model.fit(Task(), Silent(), 0, "cpu")
        unseen = torch.rand((6, 3), generator=g)
        found = torch.einsum("kc,khwd->hwcd", model.coefficients(unseen), model.basis)
        found = found.diagonal(dim1=2, dim2=3) if found.shape[3] == 3 else found[..., 0]
        truth = (transport @ unseen * absorbed).view(5, 10, 3)
        assert float((found - truth).norm() / truth.norm()) < 1e-3, channels


def test_storage_of_the_papers_size():
    assert Storage.of(16, 1024, 1024, 256).basis == 64 * 2**20  # "64MB" (section 6.5)
    found = {row["metric"]: row["value"] for row in storage(16, 64, 32)}
    assert 0 <= found["bytes/basis_file"] - found["bytes/basis"] < 512
    assert 0 <= found["bytes/transfer_file"] - found["bytes/transfer"] < 512


def test_failures_are_measured(task):
    rows = measure_failures(
        task, SETTINGS, lambdas=[0.0, 1.0], duplicates=[0.0, 0.5], configurations=[1, 24], points=[8, 64],
        supersample=[1, 4], lights=["coloured"], brighter=[100.0],
    )  # fmt: skip
    value = {(row["variant"], row["metric"]): row["value"] for row in rows}
    assert len(value) == len(rows)
    # near-duplicates worsen the conditioning, lambda mends it
    plain = value["duplicates=0,lambda=0", "condition/direct"]
    assert value["duplicates=0.5,lambda=0", "condition/direct"] > 10 * plain
    assert value["duplicates=0.5,lambda=1", "condition/direct"] < 1000
    assert value["configurations=1", "error/relative"] > value["configurations=24", "error/relative"]
    same = value["lights=same", "error/relative"]
    assert value["configurations=24", "error/relative"] == same  # all of them, with as many elements
    assert value["brighter=100", "error/relative"] == pytest.approx(same, rel=1e-3)
    assert value["lights=none", "error/black"] == 0
    assert value["lights=same", "error/bound"] <= same
    with pytest.raises(PrtError, match="no test lights 'nowhere'"):
        judged(task, fitted(task, SETTINGS), "nowhere")


def test_flicker_of_a_perfect_method_is_zero(task):
    path = [item for item in task.tests() if item.split == "path"]

    class Perfect:
        def light(self, rig):
            return next(item for item in path if item.lighting.lights == rig.lights)

        def shade(self, gbuffer, item):
            return item.references["indirect"].reshape(-1, 3)[gbuffer.hit]

    class Still(Perfect):
        def shade(self, gbuffer, item):
            return path[0].references["indirect"].reshape(-1, 3)[gbuffer.hit]

    assert flicker(Perfect(), path) == 0 and flicker(Still(), path) > 0  # pyright: ignore


def test_eigenvalues_fall_from_one(task):
    values = [row["value"] for row in eigenvalues(task, SETTINGS, 8)]
    assert values[0] == 1 and values == sorted(values, reverse=True)


def test_the_curve_justifies_the_chosen_number(task):
    rows = capacity(task, SETTINGS, [0.9, 1e-9])
    error = {r["variant"]: r["value"] for r in rows if r["metric"] == "error/held_out"}
    chosen = {r["variant"]: r["value"] for r in rows if r["metric"] == "basis/chosen"}
    assert "target=1e-09" not in chosen
    number = int(chosen["target=0.9"])
    assert error[f"basis={number}"] <= 0.9
    assert all(error[f"basis={n}"] > 0.9 for n in range(1, number))


def test_the_method_composes_and_builds():
    assert isinstance(build(compose(COMMON + ["scene=cornell_box"]), "method"), SvdTransfer)

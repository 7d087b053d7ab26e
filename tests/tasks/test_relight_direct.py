"""The task relight_direct: what it casts, what it compares with, how it splits the error, what it refuses."""

import dataclasses

import pytest
import torch

from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.methods.cast_prt import CastPrt
from prt.metrics.image import PSNR_CAP
from prt.tasks.relight_direct import HELD_OUT_SEED

SMALL = ["task=relight_direct", "scene=four_shapes", "budget=smoke", "task.train_points=300",
         "task.directions=16", "task.texels=32", "task.size=16", "task.reference_directions=64",
         "task.truth_samples=32"]  # fmt: skip


@pytest.fixture(scope="module")
def words(module_lights):
    return [*SMALL, *module_lights]


def task_of(words, *more):
    return build_task(compose([*words, *more]))


def test_points_are_cast_once_and_none_is_held_out_and_trained_on(words):
    task = task_of(words)
    data, other = task.training(), task.held_out()
    assert data.transfer.shape == (300, 16) and len(other.points) == 30
    again = task_of(words).training()
    assert torch.equal(again.transfer, data.transfer)
    apart = torch.cdist(other.points.position, data.points.position).min()
    assert float(apart) > 0 and HELD_OUT_SEED != 0
    assert task_of(words, "task.order=3").training().transfer.shape == (300, 9)


def test_each_material_is_a_split_of_the_same_views(words):
    task = task_of(words)
    items = task.tests()
    assert [(i.split, i.view_name) for i in items] == [
        ("diffuse", "view00"), ("glossy", "view00"), ("diffuse", "view01"), ("glossy", "view01"),
    ]  # fmt: skip
    diffuse, glossy = (i.gbuffer for i in items[:2])
    assert float(diffuse.specular.abs().max()) == 0 and float(glossy.diffuse.abs().max()) == 0
    torch.testing.assert_close(diffuse.diffuse, glossy.specular)
    # neighbouring views are lit by different environments
    assert items[0].lighting_name != items[2].lighting_name


@pytest.mark.parametrize("reference", ["cast", "texture", "truth"])
def test_references_agree_within_what_tells_them_apart(words, reference):
    task = task_of(words, f"task.reference={reference}", "task.views=1", "task.materials=[diffuse]")
    item = task.tests()[0]
    method = CastPrt(256)
    method.order, method._surface = task.order, task.surface
    image = item.gbuffer.image(method.shade(item.gbuffer, method.light(item.lighting)))
    wrong = float((image - item.references["direct"]).abs().mean() / item.references["direct"].mean())
    # 64 directions of noise, 32 x 32 texels, bands that are cut
    assert wrong < {"cast": 0.04, "texture": 0.35, "truth": 0.25}[reference]
    assert 10 < item.noise_floor["direct"] < 60


def test_the_error_is_split_for_the_first_views_only(words):
    task = task_of(words)
    item, other = task.tests()[0], task.tests()[2]
    parts = task.error_split(item, item.references["direct"], None)
    assert set(parts) == {"negative/share", "psnr/cast", "psnr/truth", "psnr/truncation"}
    assert parts["psnr/cast"] == PSNR_CAP and parts["psnr/truth"] == pytest.approx(parts["psnr/truncation"])
    assert set(task.error_split(other, other.references["direct"], None)) == {"negative/share"}
    ringing = item.references["direct"].clone()
    ringing[item.gbuffer.hit.view(16, 16)] = -1
    assert task.error_split(other, ringing, None)["negative/share"] > 0


def test_reflectance_is_the_sum_of_both(words):
    task = task_of(words)
    base = task.tests()[0].gbuffer
    mixed = dataclasses.replace(base, diffuse=0.5 * torch.ones_like(base.diffuse),
                                specular=0.2 * torch.ones_like(base.diffuse))  # fmt: skip
    assert float(task.dressed(mixed, "glossy").specular.mean()) == pytest.approx(0.7)


def test_the_fewest_bands_that_are_enough(words):
    few, more = (
        task_of(words, "task.order=auto", f"task.order_target={target}", "task.materials=[diffuse]",
                "task.truth_samples=256").order
        for target in (0.5, 0.15)
    )  # fmt: skip
    assert 1 <= few < more <= 10
    with pytest.raises(PrtError, match="no number of bands up to 10 meets task.order_target=0.001"):
        _ = task_of(words, "task.order=auto", "task.order_target=0.001").order


@pytest.mark.parametrize(("change", "message"), [
    ("task.materials=[metal]", "names 'metal'; choose from diffuse, glossy"),
    ("task.reference=best", "task.reference='best' is not one of"),
    ("task.order=0", "task.order=0 must be at least 1"),
    ("task.exponent=-1", "task.exponent=-1"),
])  # fmt: skip
def test_refusals(words, change, message):
    with pytest.raises(PrtError, match=message):
        task_of(words, change)

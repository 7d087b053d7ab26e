"""The task local_lights: what it bakes, what it tests on, what it refuses."""

import pytest
import torch

from prt.bench import compose as composer
from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.tasks.local_lights import LIGHTMAP

SMALL = ["task=local_lights", "scene=cornell_box", "lighting=spots_inside", "budget=smoke", "task.texels=16",
         "task.train_count=3", "task.spp=4", "task.reference_spp=8", "task.frame_spp=4",
         "task.frame_size=16"]  # fmt: skip


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    return tmp_path


def test_configurations_are_baked_one_by_one_and_kept(cache):
    first = build_task(compose(SMALL)).database()
    files = {path: path.stat().st_mtime_ns for path in (cache / "lightmap").iterdir()}
    assert len(files) == 3 and first.seconds > 0
    # a larger database holds the smaller one, from the cache
    more = build_task(compose([*SMALL, "task.train_count=4"])).database()
    assert torch.equal(more.lightmaps[:3], first.lightmaps)
    assert all(path.stat().st_mtime_ns == when for path, when in files.items())
    assert len(list((cache / "lightmap").iterdir())) == 4
    assert first.lightmaps.shape == (3, int(first.covered.sum()), 3)
    assert first.fill.shape == (first.size[0] * first.size[1],)
    # other settings, other lightmaps
    other = build_task(compose([*SMALL, "task.spp=8"])).database()
    assert not torch.equal(other.lightmaps, first.lightmaps)


def test_common_random_numbers_share_paths_and_tests_share_none(cache):
    task = build_task(compose([*SMALL, "task.common_random_numbers=true"]))
    seeds = []
    task._lightmap = lambda rig, spp, seed, filtered: (seeds.append(seed), (torch.zeros((1, 3)), 0.0))[1]
    task.database()
    assert len(set(seeds)) == 1
    apart = build_task(compose(SMALL))
    apart._lightmap = task._lightmap
    apart.database()
    assert len(set(seeds[3:])) == 3 and max(seeds) < 7000


def test_items_are_lightmaps_and_frames_of_every_split(cache):
    task = build_task(compose([*SMALL, "task.others=[points,coloured]", "task.path_steps=2"]))
    items = task.tests()
    assert {item.split for item in items} == {"same", "points", "coloured", "path"}
    assert sum(item.view_name == LIGHTMAP and item.split == "same" for item in items) == 2
    assert {item.view_name for item in items if item.split == "path"} == {LIGHTMAP}
    trained = [rig.lights for rig in task.database().rigs]
    assert all(item.lighting.lights not in trained for item in items)
    for item in items:
        height, width = item.references["indirect"].shape[:2]
        assert (height, width) == (task.asset.size if item.view_name == LIGHTMAP else (16, 16))
        assert item.noise_floor["indirect"] > 0
        parts = task.compose(item, torch.zeros((height, width, 3)), "indirect")
        assert set(parts) == ({"indirect"} if item.view_name == LIGHTMAP else {"indirect", "full"})
    frame = task.timed_item()
    assert frame.view_name != LIGHTMAP
    whole = task.compose(frame, frame.references["indirect"], "indirect")["full"]
    # what is added to an exact prediction makes the exact full image
    assert torch.allclose(whole, frame.references["full"], atol=1e-5)


def test_the_error_is_split_in_texture_space(cache):
    task = build_task(compose(SMALL))
    item = next(item for item in task.tests() if item.view_name == LIGHTMAP)

    class Method:
        from prt.methods.base import Component

        component = Component.INDIRECT

        def project(self, reference, rig):
            return 0.9 * reference

    truth = item.references["indirect"]
    found = task.error_split(item, 0.8 * truth, Method())
    assert found["rmse/relative"] == pytest.approx(0.2, rel=1e-4)
    assert found["rmse/over_bound"] == pytest.approx(2.0, rel=1e-4)
    assert found["negative/share"] == 0
    assert task.error_split(item, -truth, Method())["negative/share"] > 0.5
    assert task.error_split(task.timed_item(), truth, Method()) == {}


@pytest.mark.parametrize(("change", "says"), [
    ("task.train_count=0", "task.train_count=0 must be at least 1"),
    ("task.texels=4", "task.texels=4 must lie between 8 and 8192"),
    ("task.others=[nowhere]", "task.others names 'nowhere'; the scenario has"),
    ("task.reference_spp=1", "task.reference_spp=1"),
])  # fmt: skip
def test_wrong_settings_are_one_line(cache, change, says):
    with pytest.raises(PrtError, match=says.replace("[", r"\[")) as caught:
        build_task(compose([*SMALL, change])).tests()
    assert "\n" not in str(caught.value)


def test_another_kind_of_lighting_is_refused(cache):
    from prt.bench.build import build

    cfg = compose(SMALL)
    with pytest.raises(PrtError, match="needs a lighting scenario: lighting=spots"):
        build(cfg, "task", scene=build(cfg, "scene"), lighting=object())


def test_the_task_brings_its_lighting_and_method():
    cfg = compose(["task=local_lights", "scene=cornell_box"])
    assert (cfg.choice.lighting, cfg.choice.method) == ("spots", "svd_transfer")
    cfg = compose(["lighting=points", "task=local_lights", "scene=cornell_box", "method=sh_vertex"])
    assert (cfg.choice.lighting, cfg.choice.method) == ("points", "sh_vertex")
    # a sweep's values are not joined by the task's own choice
    given = ["task=local_lights", "lighting=points,spots"]
    assert composer.with_companions(given) == ["method=svd_transfer", *given]
    assert composer.with_companions(["scene=kitchen"]) == ["scene=kitchen"]
    assert "_with_" not in cfg.task

"""Task animate: test states, references, and what path tracing at equal time does with it."""

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from prt.bench.build import build
from prt.bench.compose import compose
from prt.bench.run import build_task
from prt.errors import PrtError
from prt.methods.base import Component, Silent
from prt.methods.path_traced import PathTraced
from prt.metrics.registry import evaluate

SMALL = ["task=animate", "budget=smoke", "task.size=16", "task.spp=64", "task.states=2"]


def task(*more):
    return build_task(compose([*SMALL, *more]))


def test_its_own_choices_are_made_where_nothing_else_is():
    cfg = compose(["task=animate", "budget=smoke"])
    assert (
        dict(cfg.choice)["scene"] == "cornell_animated" and dict(cfg.choice)["method"] == "dynamic_radiosity"
    )
    assert OmegaConf.select(cfg, "lighting._target_").endswith("OwnLights")


def test_states_are_in_the_cube_at_its_corners_and_beyond_it():
    where = task("scene.variables=3", "task.corners=8", "task.outside=6", "task.path_steps=3")
    states = where.test_states()
    by_split = {}
    for split, name, v in states:
        assert len(v) == 3
        by_split.setdefault(split, []).append((name, v))
    assert {split: len(found) for split, found in by_split.items()} == {
        "inside": 2, "corners": 8, "outside": 6, "path": 3,
    }  # fmt: skip
    assert all(0 <= x <= 1 for _, v in by_split["inside"] for x in v)
    assert len({tuple(v) for _, v in by_split["corners"]}) == 8, "all corners, none twice"
    for _, v in by_split["outside"]:
        assert sum(x < 0 or x > 1 for x in v) == 1
    assert {round(v[0] - by_split["path"][0][1][0], 3) for _, v in by_split["path"]} == {0.0, 0.02, 0.04}
    assert where.test_states() == states
    more = task("scene.variables=3", "task.states=4").test_states()
    assert more[:2] == states[:2], "a longer list begins as a shorter one"


def test_a_reference_is_what_a_path_tracer_makes_of_the_state():
    where = task("task.states=1", "task.spp=256")
    item = where.tests()[0]
    assert item.references["full"].shape == (16, 16, 3) and item.gbuffer.hit.all()
    again = where.render(item.lighting, item.gbuffer.view, 256, 5)
    assert evaluate(again, item.references["full"], ["mape"])["mape"] < 0.25
    other = where.render(1 - item.lighting, item.gbuffer.view, 256, 5)
    assert (other - again).abs().mean() > (again - item.references["full"]).abs().mean()
    split = where.error_split(item, again, None)
    assert 0 < split["mape/noise"] < 0.5


def test_without_variables_and_with_given_states():
    where = task("scene.variables=0", "task.states=1")
    assert where.dimension == 0 and where.tests()[0].lighting.shape == (0,)
    given = task("task.states=0", "task.given=[[0.25, 1.0]]")
    (item,) = given.tests()
    assert item.split == "given" and item.lighting.tolist() == [0.25, 1.0]


def test_states_of_all_kinds_are_seen_by_the_same_cameras():
    where = task(
        "task.states=2", "task.corners=2", "task.outside=2", "task.path_steps=2", "task.given=[[0.5,0.5]]"
    )
    seen = {}
    for item in where.tests():
        seen.setdefault(item.split, []).append(item.gbuffer.view)
    assert seen["inside"] == seen["corners"] == seen["outside"] and seen["inside"][0] != seen["inside"][1]
    assert seen["path"] == [seen["inside"][0]] * 2
    assert seen["given"][0] not in seen["inside"]
    (alone,) = task("task.states=1").tests()
    assert alone.gbuffer.view == where.scene.views("far", 1, 16)[0]


def test_bounds_hold_the_geometry_in_every_state():
    where = task("scene.variables=3")
    low, high = where.bounds
    rng = np.random.default_rng(0)
    for _ in range(5):
        where.stage.set(rng.random(3).tolist())
        box = where.stage.mi_scene.bbox()
        assert (np.array(list(box.min)) >= low).all() and (np.array(list(box.max)) <= high).all()


@pytest.mark.parametrize("denoise", [False, True])
def test_path_tracing_at_equal_time_gives_full_radiance(denoise, tmp_path):
    where = task()
    method = PathTraced(None, samples=4, denoise=denoise)
    method.fit(where, Silent(), 0, "cpu")
    assert method.component is Component.FULL
    item = where.tests()[0]
    image = item.gbuffer.image(method.shade(item.gbuffer, method.light(item.lighting)))
    assert where.compose(item, image, method.component.value).keys() == {"full"}
    assert image.mean() == pytest.approx(float(item.references["full"].mean()), rel=0.3)
    method.save(tmp_path / "m.safetensors")
    again = PathTraced(None, samples=1, denoise=denoise)
    again.load(tmp_path / "m.safetensors", where, "cpu")
    found = item.gbuffer.image(again.shade(item.gbuffer, again.light(item.lighting)))
    torch.testing.assert_close(found, image)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("lighting=spots", "takes the scene's own lights: lighting=own"),
        ("lighting=procedural", "lighting=procedural does not go with task=animate, which has no resolution"),
        ("scene=four_shapes", "no lights of its own"),
        ("task.given=[[0.5]]", r"task.given\[0\] has 1 values; the scene has 2 variables"),
        ("task.size=4", "task.size=4 must be an integer of at least 8"),
        ("task.states=0", "no test states; raise task.states"),
        ("scene.variables=4", "scene.variables=4 must be an integer from 0 to 3"),
    ],
)
def test_mistakes_are_one_line(override, words):
    with pytest.raises(PrtError, match=words):
        task(override).tests()


def test_a_method_of_indirect_light_is_refused():
    where = task("task.states=1")
    with pytest.raises(PrtError, match="full radiance, not indirect"):
        where.compose(where.tests()[0], torch.zeros(16, 16, 3), "indirect")


def test_a_scene_the_project_has_never_seen(tmp_path):
    (tmp_path / "scene.xml").write_text("""<scene version="3.0.0">
      <sensor type="perspective"><transform name="to_world">
        <lookat origin="0, 1, 4" target="0, 0.5, 0" up="0, 1, 0"/></transform></sensor>
      <bsdf type="diffuse" id="Paint"><rgb name="reflectance" value="0.5, 0.4, 0.3"/></bsdf>
      <shape type="rectangle" id="Ground"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="3"/></transform><bsdf type="diffuse"/></shape>
      <shape type="cube" id="Box"><transform name="to_world"><scale value="0.4"/>
        <translate y="0.4"/></transform><ref id="Paint"/></shape>
      <emitter type="constant"/>
    </scene>""")
    (tmp_path / "my.yaml").write_text("""variables:
      - {name: box, translate: {shapes: [Box], start: [-1, 0, 0], end: [1, 0, 0]}}
      - {name: paint, value: {parameter: Paint.reflectance.value, start: [0.8, 0, 0], end: [0, 0, 0.8]}}
    """)
    cfg = compose([
        *SMALL, "scene=mitsuba", f"scene.path={tmp_path / 'scene.xml'}", "scene.animation=my.yaml",
        "method.training.steps=3", "method.training.batch=64",
    ])  # fmt: skip
    where = build_task(cfg)
    assert where.stage.animation.names == ["box", "paint"]
    method = build(cfg, "method")
    method.fit(where, Silent(), 0, "cpu")
    item = where.tests()[0]
    found = method.shade(item.gbuffer, method.light(item.lighting))
    assert found.shape == (len(item.gbuffer), 3) and found.isfinite().all()

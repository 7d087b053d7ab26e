"""Scenes that move: nothing collides, all variables show, cameras stand free in every state."""

import itertools
import os

import numpy as np
import pytest
from data_scenes import scene

from prt.errors import PrtError
from prt.scene import cornell_animated, many
from prt.scene.capture import capture, sensor_description
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.stage import Stage

ROOMS = {"dining_room": 7, "veach_door": 6, "living_room": 5}
GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}


@pytest.fixture(scope="module")
def stages():
    """Stages by name, each loaded once; rooms from PRT_DATA only where it is set."""
    found: dict[str, tuple] = {}

    def of(name: str):
        if name in ROOMS and not os.environ.get("PRT_DATA"):
            pytest.skip("PRT_DATA is not set: rooms that move are not tested")
        if name not in found:
            where = scene(name, *(["scene.variables=3"] if name == "cornell_animated" else []))
            found[name] = where, Stage(where)
        return found[name]

    return of


def vertices(stage: Stage, shape: str) -> np.ndarray:
    """Of a mesh where it now is, (V, 3)."""
    return np.array(stage.params[f"{shape}.vertex_positions"]).reshape(-1, 3)


def box_of(stage: Stage, shape: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the bounding box of any shape where it now is."""
    found = next(s for s in stage.mi_scene.shapes() if s.id() == shape).bbox()
    return np.array(found.min).reshape(3), np.array(found.max).reshape(3)


def states(n: int, count: int = 12) -> list[list[float]]:
    """Random ones, and corners of the cube."""
    rng = np.random.default_rng(n)
    return [*rng.random((count, n)).tolist(), *rng.integers(0, 2, (count, n)).astype(float).tolist()]


# ---- cornell_animated


def test_cornell_keeps_everything_apart_and_in_the_room(stages):
    _, stage = stages("cornell_animated")
    room = cornell_animated
    for v in itertools.product(np.linspace(0, 1, 7), np.linspace(0, 1, 7), (0.0, 1.0)):
        stage.set(v)
        ball, box = vertices(stage, "ball"), vertices(stage, "box")
        for inner in (ball, box):
            assert (inner > [-room.HALF, -1e-6, room.BACK]).all()
            assert (inner < [room.HALF, room.HEIGHT, room.FRONT]).all()
        # on the floor, as far as that is exact in float32
        assert abs(ball[:, 1].min()) < 1e-6 and abs(box[:, 1].min()) < 1e-6
        low, high = box_of(stage, "lamp")
        assert (low[[0, 2]] > [-room.HALF, room.BACK]).all() and (
            high[[0, 2]] < [room.HALF, room.FRONT]
        ).all()
        assert box[:, 1].max() + 0.2 < low[1] <= high[1] < room.HEIGHT
        # distance of the ball's centre from the box's footprint, in the box's own axes
        centre = (ball.min(0) + ball.max(0)) / 2
        turn = np.radians(90 * v[0])
        x, z = centre[[0, 2]] - room.BOX_AT
        local = np.array([np.cos(turn) * x - np.sin(turn) * z, np.sin(turn) * x + np.cos(turn) * z])
        outside = np.maximum(np.abs(local) - np.array(room.BOX_SIDES) / 2, 0)
        assert np.linalg.norm(outside) > room.BALL_RADIUS + 0.02
    assert room.gap() > 0.02


def test_cornell_variables_and_settings():
    names = ["box", "ball", "lamp"]
    for count in range(4):
        where = scene("cornell_animated", f"scene.variables={count}")
        assert where.animation.names == names[:count]
    with pytest.raises(PrtError, match=r"scene\.variables=4"):
        scene("cornell_animated", "scene.variables=4")
    # still things stand half way, whatever moves
    still, moving = (Stage(scene("cornell_animated", f"scene.variables={count}")) for count in (0, 3))
    moving.set([0.5, 0.5, 0.5])
    assert (vertices(still, "ball") == vertices(moving, "ball")).all()
    assert still.state == []
    for ball in cornell_animated.BALLS:
        assert len(Stage(scene("cornell_animated", f"scene.ball={ball}")).mi_scene.shapes()) == 9
    with pytest.raises(PrtError, match=r"scene\.ball='wood'.*mirror"):
        scene("cornell_animated", "scene.ball=wood")


def test_cornell_is_closed(stages):
    """No ray from inside gets out, in any state."""
    _, stage = stages("cornell_animated")
    mi, rng = mitsuba(), np.random.default_rng(0)
    for v in states(3, 3):
        stage.set(v)
        d = rng.normal(size=(3, 20000))
        ray = mi.Ray3f(mi.Point3f(0.0, 1.7, 1.2), mi.Vector3f(d / np.linalg.norm(d, axis=0)))
        assert np.array(stage.mi_scene.ray_test(ray)).all()


# ---- many


def test_many_counts_and_order():
    a = many.animation()
    assert a.dimension == 23
    kinds = [variable.motions[0].kind for variable in a.variables]
    assert sum(kind != "value" for kind in kinds) == 8 and kinds.count("value") == 15
    for count in (0, 7, 12, 16, 23):
        where = scene("many", f"scene.variables={count}")
        assert where.animation.names == a.names[:count]
        moving = sum(kind != "value" for kind in kinds[:count])
        assert moving == min((count + 1) // 2, 8)
    with pytest.raises(PrtError, match=r"scene\.variables=24"):
        scene("many", "scene.variables=24")


def test_many_objects_never_meet(stages):
    _, stage = stages("many")
    names = [f"object{number}" for number in range(8)]
    for v in [*states(23, 20), [0.0] * 23, [1.0] * 23]:
        stage.set(v)
        where = {name: vertices(stage, name) for name in names}
        for number, name in enumerate(names):
            points, (x, z) = where[name], many.centre(number)
            # all stay above their own cell of the table, so no two can meet
            assert np.abs(points[:, [0, 2]] - [x, z]).max() < many.HALF_CELL - 0.02
            plinth = f"plinth{number}"
            ground = box_of(stage, plinth)[1][1] if number < 4 else 0.0
            assert points[:, 1].min() == pytest.approx(ground, abs=1e-5)
    for number in range(8):
        x, z = many.centre(number)
        assert abs(x) + many.HALF_CELL <= many.WIDE and abs(z) + many.HALF_CELL <= many.DEEP


# ---- all


@pytest.mark.parametrize("name", ["cornell_animated", "many", *ROOMS])
def test_every_variable_shows(stages, name):
    """From some view each variable changes the image by more than noise does: same seed, other state."""
    where, stage = stages(name)
    mi, n = mitsuba(), stage.animation.dimension
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    sensors = [mi.load_dict(sensor_description(view)) for view in where.views("train", 2, 32)]

    def images(v):
        stage.set(v)
        parts = [
            np.array(mi.render(stage.mi_scene, sensor=s, integrator=integrator, spp=8, seed=1))
            for s in sensors
        ]
        return np.minimum(np.stack(parts), 10.0)

    base = images([0.5] * n)
    assert np.isfinite(base).all() and base.mean() > 1e-3
    for i in range(n):
        ends = [images([end if j == i else 0.5 for j in range(n)]) for end in (0.0, 1.0)]
        change = np.abs(ends[1] - ends[0]).mean() / base.mean()
        assert change > 2e-3, f"{name}: variable {stage.animation.names[i]} changes the image by {change:.2%}"


@pytest.mark.parametrize("name", ["cornell_animated", "many", *ROOMS])
def test_cameras_stand_free_in_every_state(stages, name):
    where, stage = stages(name)
    n = stage.animation.dimension
    views = where.views("train", 3, 16) + where.views("far", 3, 16)
    for v in ([0.0] * n, [0.5] * n, [1.0] * n):
        stage.set(v)
        for view in views:
            g = capture(stage.mi_scene, view)
            distance = np.linalg.norm(g.position.numpy() - np.array(view.origin), axis=1)
            assert len(g) > 0.5 * 16 * 16, f"{name}, {v}: most of {view} is empty"
            assert distance.min() > 0.05, f"{name}, {v}: {view} touches something"


@pytest.mark.parametrize("name", list(ROOMS))
def test_rooms_have_the_papers_dimension_and_keep_things_inside(stages, name):
    where, stage = stages(name)
    assert stage.animation.dimension == ROOMS[name]
    fixed = [s for s in stage.mi_scene.shapes() if s.id() not in stage.animation.shapes()]
    low = np.min([np.array(s.bbox().min).reshape(3) for s in fixed], axis=0)
    high = np.max([np.array(s.bbox().max).reshape(3) for s in fixed], axis=0)
    # blinds hang outside; the lamps of the paper's animation, on their cords, go through the ceiling
    lamps = ("FrostedGlass", "WhitePlastic") if name == "dining_room" else ()
    inside = [s for s in stage.animation.shapes() if not s.startswith(("blind", *lamps))]
    for v in states(ROOMS[name], 4):
        stage.set(v)
        for shape in inside:
            a, b = box_of(stage, shape)
            assert (a >= low - 0.02).all() and (b <= high + 0.02).all(), f"{shape} leaves the room at {v}"


@pytest.mark.parametrize("name", ["cornell_animated", "many", *ROOMS])
def test_fingerprints_tell_lit_scenes_apart(stages, name):
    import json

    where, _ = stages(name)
    found = where.lit_fingerprint()
    assert json.loads(json.dumps(found)) == found == where.lit_fingerprint()
    fewer = scene(name, "scene.variables=1").lit_fingerprint()
    assert fewer != found
    # other tasks know nothing of lights and motions: their caches stay
    assert scene(name, "scene.variables=1").fingerprint() == where.fingerprint()
    assert not {"animation", "add", "emitters"} & set(where.fingerprint())


def test_other_tasks_get_the_scene_without_its_lights(stages):
    for name in ("cornell_animated", "many"):
        where, stage = stages(name)
        assert len(where.load().emitters()) == 0
        assert len(where.load({"type": "constant"}).emitters()) == 1
        assert len(stage.mi_scene.emitters()) >= 1


def test_scenes_without_lights_say_so(tmp_path):
    with pytest.raises(PrtError, match=r"cornell_box has no lights.*cornell_animated") as caught:
        scene("cornell_box").load_lit()
    assert "\n" not in str(caught.value)
    dark = MitsubaScene(path={"box": {"type": "cube", "bsdf": GREY}})
    with pytest.raises(PrtError, match="no emitters"):
        dark.load_lit()


# ---- files


FILE = """<scene version="3.0.0">
  <bsdf type="diffuse" id="Paint"><rgb name="reflectance" value="0.5, 0.4, 0.3"/></bsdf>
  <bsdf type="roughconductor" id="Steel"><float name="alpha" value="0.1"/></bsdf>
  <shape type="cube"><ref id="Paint"/></shape>
  <shape type="cube"><transform name="to_world"><translate x="4"/></transform><ref id="Paint"/></shape>
  <shape type="cube" id="Roof">
    <transform name="to_world"><translate y="4"/></transform><ref id="Steel"/></shape>
  <shape type="rectangle" id="Lamp"><transform name="to_world"><translate z="3"/></transform>
    <ref id="Paint"/><emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter></shape>
  <emitter type="constant"/>
</scene>"""


def test_files_keep_their_lights_and_names(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(FILE)
    plain = MitsubaScene(path=path).load_lit()
    ids = [shape.id() for shape in plain.shapes()]
    assert sorted(ids) == ["Lamp", "Paint_0001", "Paint_0002", "Roof"] and len(plain.emitters()) == 2
    # the first one of the file has the first number
    assert np.array(next(s for s in plain.shapes() if s.id() == "Paint_0002").bbox().min)[0] == 3
    assert ids == [shape.id() for shape in MitsubaScene(path=path).load_lit().shapes()]
    opened = MitsubaScene(path=path, open=["Roof"], roughness={"Steel": 0.5}).load_lit()
    assert "Roof" not in [shape.id() for shape in opened.shapes()]
    rough = mitsuba().traverse(MitsubaScene(path=path, roughness={"Steel": 0.5}).load_lit())
    assert np.allclose(np.array(rough[next(k for k in rough.keys() if "alpha" in k)]), 0.25)
    # as before without lights
    assert len(MitsubaScene(path=path).load().emitters()) == 0


def test_files_take_more_shapes_and_lights(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(FILE)
    lamp = {"type": "sphere", "center": [0, 3, 0], "radius": 0.2, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}}  # fmt: skip # noqa: E501
    motion = {"name": "up", "translate": {"shapes": ["bulb", "Roof"], "start": [0, 0, 0], "end": [0, 1, 0]}}
    paint = {
        "name": "p",
        "value": {"parameter": "Paint.reflectance.value", "start": [0.5, 0.4, 0.3], "end": [1, 0, 0]},
    }
    where = MitsubaScene(path=path, add={"bulb": lamp}, animation={"variables": [motion, paint]})
    stage = Stage(where)
    stage.set([1.0, 1.0])
    assert box_of(stage, "bulb")[0][1] == pytest.approx(3.8) and box_of(stage, "Roof")[0][1] == pytest.approx(
        4
    )
    assert len(stage.mi_scene.emitters()) == 3
    assert where.fingerprint() == MitsubaScene(path=path).fingerprint()
    assert where.lit_fingerprint() != MitsubaScene(path=path).lit_fingerprint()
    # what is called as in the file shares the material of the file
    for shape in stage.mi_scene.shapes():
        if shape.id().startswith("Paint"):
            colour = mitsuba().traverse(shape.bsdf())["reflectance.value"]
            assert np.allclose(np.array(colour).reshape(3), [1, 0, 0])


def test_animations_lie_beside_the_scene(tmp_path, monkeypatch):
    path = tmp_path / "scene.xml"
    path.write_text(FILE)
    (tmp_path / "moves.yaml").write_text(
        "variables: [{name: up, translate: {shapes: [Roof], start: [0, 0, 0], end: [0, 1, 0]}}]"
    )
    assert MitsubaScene(path=path, animation="moves.yaml").animation.names == ["up"]
    assert MitsubaScene(path=path, animation="moves.yaml", variables=0).animation.dimension == 0
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "scene.xml").write_text(FILE)
    assert MitsubaScene(path=tmp_path / "sub/scene.xml", animation="moves.yaml").animation.dimension == 1
    with pytest.raises(PrtError, match="does not exist"):
        MitsubaScene(path=path, animation="nowhere.yaml")


def test_the_papers_environment_stands_at_the_angles_of_its_file(stages):
    """The authors set the transform, and 90 to 120 degrees enclose the 115 of the scene's own file."""
    where, stage = stages("dining_room")
    mi, n = mitsuba(), stage.animation.dimension
    for v, degrees in ((0.0, 90), (1.0, 120), (25 / 30, 115)):
        stage.set([v] * n)
        found = np.array(stage.params[stage._environment].matrix).reshape(4, 4)
        expected = np.array(mi.ScalarTransform4f().rotate([0, 1, 0], degrees).matrix).reshape(4, 4)
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_ball_that_meets_the_box_touches_it_on_its_way():
    """At 0.448 of its way the ball's surface lies on the front face of the box, which has not turned."""
    from prt.scene import cornell_animated as room

    moved = room.animation(meeting=True).transforms([0.0, 0.448, 0.0])["ball"]
    z = room.BALL_START[2] + float(moved[2][3])
    face = room.BOX_AT[1] + room.BOX_SIDES[1] / 2
    assert z - room.BALL_RADIUS == pytest.approx(face, abs=2e-3)
    end = room.animation(meeting=True).transforms([0.0, 1.0, 0.0])["ball"]
    assert room.BALL_START[0] + float(end[0][3]) == pytest.approx(room.BOX_AT[0], abs=1e-6)

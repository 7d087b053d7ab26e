"""Scenes from Mitsuba files and dicts: lights removed, shapes opened, roughness, cameras, errors."""

import json

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.capture import capture
from prt.scene.mitsuba_file import MitsubaScene

SENSOR = """
    <sensor type="perspective">
        <float name="fov" value="50"/>
        <transform name="to_world"><lookat origin="0, 1, 3" target="0, 0.8, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="$w"/><integer name="height" value="8"/></film>
    </sensor>
"""
ROOM = """<scene version="3.0.0">
    <default name="spp" value="16"/>
    <default name="w" value="8"/>
    <integrator type="path"/>
    {sensor}
    <bsdf type="twosided" id="Paint"><bsdf type="diffuse">
        <rgb name="reflectance" value="0.5, 0.4, 0.3"/></bsdf></bsdf>
    <bsdf type="twosided" id="Chrome"><bsdf type="conductor">
        <string name="material" value="none"/></bsdf></bsdf>
    <bsdf type="roughplastic" id="Coat"><float name="alpha" value="0.1"/></bsdf>
    <shape type="obj" id="Floor"><string name="filename" value="floor.obj"/><ref id="Paint"/></shape>
    <shape type="rectangle" id="Ceiling">
        <transform name="to_world"><scale value="3"/><rotate x="1" angle="90"/>
        <translate y="2.5"/></transform>
        <ref id="Paint"/></shape>
    <shape type="sphere" id="Ball"><point name="center" x="0" y="0.8" z="0"/>
        <float name="radius" value="0.6"/>
        <ref id="Chrome"/></shape>
    <shape type="sphere" id="Bead"><point name="center" x="0.9" y="0.8" z="0.6"/>
        <float name="radius" value="0.2"/>
        <ref id="Coat"/></shape>
    <shape type="rectangle" id="Panel"><transform name="to_world"><translate z="2"/></transform>
        <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>
    <emitter type="constant"/>
    <emitter type="envmap"><string name="filename" value="no_such_map.exr"/></emitter>
</scene>"""
FLOOR = "v -3 0 -3\nv 3 0 -3\nv 3 0 3\nv -3 0 3\nf 1 2 3\nf 1 3 4\n"


@pytest.fixture
def room(tmp_path):
    (tmp_path / "floor.obj").write_text(FLOOR)
    path = tmp_path / "scene.xml"
    path.write_text(ROOM.format(sensor=SENSOR))
    return path


def test_lights_go_and_the_rest_stays(room):
    scene = MitsubaScene(path=room).load()
    assert len(scene.emitters()) == 0 and scene.environment() is None and len(scene.sensors()) == 0
    ids = [shape.id() for shape in scene.shapes()]
    assert len(ids) == 4 and not any("Panel" in name for name in ids)
    kept = MitsubaScene(path=room, emitting_shapes="keep").load()
    assert len(kept.shapes()) == 5 and len(kept.emitters()) == 0


def test_exactly_the_given_emitter(room):
    scene = MitsubaScene(path=room)
    assert len(scene.load({"type": "constant"}).emitters()) == 1
    assert len(scene.load().emitters()) == 0  # the shapes are shared, the light is not


def test_opening(room):
    assert MitsubaScene(path=room).bounds[1][1] == pytest.approx(2.5)
    assert MitsubaScene(path=room, open=["Ceil*"]).bounds[1][1] == pytest.approx(1.4)
    with pytest.raises(PrtError, match="'Roof'.*Ball"):
        MitsubaScene(path=room, open=["Roof"]).load()
    with pytest.raises(PrtError, match="list"):
        MitsubaScene(path=room, open="Ceiling")


def materials(scene):
    """(roughness, specular is non-zero) at the ball, the bead and the floor, from the scene's own camera."""
    g = capture(scene.load(), scene.views("train", 1, 96)[0])
    ball = (g.position - torch.tensor([0.0, 0.8, 0.0])).norm(dim=1) < 0.61
    bead = (g.position - torch.tensor([0.9, 0.8, 0.6])).norm(dim=1) < 0.21
    floor = g.position[:, 1] < 1e-3
    return [float(g.roughness[part].mean()) for part in (ball, bead, floor)]


def test_roughness(room):
    assert materials(MitsubaScene(path=room)) == pytest.approx([0.0, 0.1**0.5, 1.0], abs=1e-4)
    assert materials(MitsubaScene(path=room, roughness=0.5)) == pytest.approx([0.5, 0.5, 1.0], abs=1e-4)
    assert materials(MitsubaScene(path=room, roughness={"Chrome": 0.3})) == pytest.approx(
        [0.3, 0.1**0.5, 1.0], abs=1e-4
    )
    with pytest.raises(PrtError, match="'Gold'.*Chrome"):
        MitsubaScene(path=room, roughness={"Gold": 0.3}).load()
    with pytest.raises(PrtError, match=r"2.0.*from 0"):
        MitsubaScene(path=room, roughness=2.0)


def test_cameras_stay_about_the_files_own_sensor(room):
    scene = MitsubaScene(path=room)
    train, far = scene.views("train", 6, 16), scene.views("far", 4, 16)
    for view in train + far:
        assert np.linalg.norm(np.array(view.origin) - [0, 1, 3]) < 1.2
        assert view.fov == pytest.approx(50.0) and view.width == view.height == 16
        assert len(capture(scene.load(), view)) > 0
    assert len({view.origin for view in train + far}) == 10
    # they all look at the point on the ball that the sensor looks at
    assert np.linalg.norm(np.array(train[0].target) - [0, 0.8, 0]) == pytest.approx(0.6, abs=0.02)


def test_cameras_about_the_bounding_box_without_a_sensor(room):
    room.write_text(ROOM.format(sensor=""))
    scene = MitsubaScene(path=room, open=["Ceiling"])
    for view in scene.views("train", 4, 16) + scene.views("far", 4, 16):
        g = capture(scene.load(), view)
        assert 20 < len(g) < 256


def test_fingerprint_follows_the_content(room):
    before = MitsubaScene(path=room).fingerprint()
    assert before == MitsubaScene(path=room).fingerprint()
    assert json.loads(json.dumps(before)) == before
    assert before != MitsubaScene(path=room, open=["Ceiling"]).fingerprint()
    assert before != MitsubaScene(path=room, roughness=1.0).fingerprint()
    (room.parent / "floor.obj").write_text(FLOOR.replace("3 0 3", "4 0 3"))
    meshes_changed = MitsubaScene(path=room).fingerprint()
    assert before != meshes_changed
    room.write_text(room.read_text().replace("0.5, 0.4, 0.3", "0.5, 0.4, 0.2"))
    assert meshes_changed != MitsubaScene(path=room).fingerprint()


def test_xml_parameters(room):
    room.write_text(
        room.read_text()
        .replace('value="0.1"', 'value="$shine"')
        .replace('name="spp"', 'name="shine"')
        .replace('"16"', '"0.25"')
    )
    assert materials(MitsubaScene(path=room))[1] == pytest.approx(0.5, abs=1e-4)
    assert materials(MitsubaScene(path=room, parameters={"shine": 0.04}))[1] == pytest.approx(0.2, abs=1e-4)


def test_dicts_in_python_json_and_yaml(tmp_path):
    matrix = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 1], [0, 0, 0, 1]]
    paint = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}
    content = {
        "square": {"type": "rectangle", "to_world": matrix, "bsdf": paint},
        "lamp": {"type": "point", "position": [0, 0, 3]},
    }
    (tmp_path / "scene.json").write_text(json.dumps({"type": "scene", **content}))
    (tmp_path / "scene.yaml").write_text(json.dumps(content))
    for path in (content, tmp_path / "scene.json", tmp_path / "scene.yaml"):
        scene = MitsubaScene(path=path)
        assert scene.bounds == ((-2, -2, 1), (2, 2, 1))
        assert len(scene.load().emitters()) == 0
        assert scene.fingerprint()["content"]


@pytest.mark.parametrize("path", [None, "", "  "])
def test_path_is_mandatory(path):
    with pytest.raises(PrtError, match=r"scene\.path is not set.*scene\.path=/folder"):
        MitsubaScene(path=path)


def test_missing_and_broken_files(tmp_path, room, monkeypatch):
    with pytest.raises(PrtError, match="does not exist"):
        MitsubaScene(path=tmp_path / "nowhere.xml")
    monkeypatch.delenv("PRT_DATA", raising=False)
    with pytest.raises(PrtError, match="PRT_DATA"):
        MitsubaScene(path="scenes/nowhere/scene.xml")
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    with pytest.raises(PrtError, match=str(tmp_path / "scenes/nowhere/scene.xml")):
        MitsubaScene(path="scenes/nowhere/scene.xml")
    (room.parent / "floor.obj").unlink()
    for action in ("load", "fingerprint"):
        with pytest.raises(PrtError, match=r"floor\.obj, which does not exist") as caught:
            getattr(MitsubaScene(path=room), action)()
        assert "\n" not in str(caught.value)
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><shape type='sphere'></scene>")
    with pytest.raises(PrtError, match=r"cannot read scene\.path.*broken\.xml") as caught:
        MitsubaScene(path=tmp_path / "broken.xml").load()
    assert "\n" not in str(caught.value)
    (tmp_path / "empty.xml").write_text("<scene version='3.0.0'></scene>")
    with pytest.raises(PrtError, match="no shapes"):
        MitsubaScene(path=tmp_path / "empty.xml").load()

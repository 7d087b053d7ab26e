"""Mitsuba files with their own lights: names, added parts, fingerprints, mistakes said in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from prt.errors import PrtError
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.stage import Stage

GREY = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}
BULB = {
    "type": "sphere", "center": [9, 0, 0],
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}},
}  # fmt: skip
UP = {"name": "up", "translate": {"shapes": ["mesh.001"], "start": [0, 0, 0], "end": [0, 1, 0]}}
FILE = """<scene version="3.0.0">
  <bsdf type="twosided" id="Wood"><bsdf type="diffuse"/></bsdf>
  <shape type="rectangle"><ref id="Wood"/></shape>
  <shape type="rectangle" id="Wood_0001"><ref id="Wood"/></shape>
  <shape type="cube"><bsdf type="diffuse"/></shape>
  <shape type="cube"><bsdf type="diffuse" id="Own"/></shape>
  <shape type="sphere" id="_mine"><ref id="Wood"/></shape>
  <shape type="sphere" id="mesh.001"><ref id="Wood"/></shape>
  <shape type="rectangle" id="light0"><ref id="Wood"/></shape>
  <shape type="rectangle" id="Panel"><emitter type="area"><rgb name="radiance" value="9"/></emitter></shape>
  <emitter type="point"><rgb name="intensity" value="1"/></emitter>
  <emitter type="constant" id="sky"/>
</scene>"""
#: of the file's shapes, in order
NAMES = ["Wood_0002", "Wood_0001", "cube_0001", "Own_0001", "_mine", "mesh.001", "light0", "Panel"]


@pytest.fixture
def path(tmp_path) -> Path:
    (tmp_path / "scene.xml").write_text(FILE)
    (tmp_path / "tile.obj").write_text("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nf 1 3 2\n")
    return tmp_path / "scene.xml"


def says(match: str, path, **settings) -> None:
    """Building the lit scene fails with one line."""
    with pytest.raises(PrtError, match=match) as caught:
        MitsubaScene(path=path, **settings).load_lit()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("add", [{}, {"bulb": BULB, "twin": BULB}])
def test_names_are_the_same_whatever_is_added(path, add):
    """Given names are kept, with dots and underscores, or as a light might be called; others get numbers."""
    mi = mitsuba()
    lit = MitsubaScene(path=path, add=add).load_lit()
    assert [shape.id() for shape in lit.shapes()] == [*NAMES, *add]
    free = [e.id() for e in lit.emitters() if not mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]
    assert free == ["light1", "sky"] and len(lit.emitters()) == 3 + len(add)
    params = mi.traverse(lit)
    for key in ("light1.intensity.value", "sky.radiance.value", "Panel.emitter.radiance.value"):
        assert key in params
    for key in add:
        np.testing.assert_allclose(np.array(params[f"{key}.emitter.radiance.value"]).reshape(3), [1, 2, 3])


def test_names_of_dicts_are_their_keys():
    content = {"a": {"type": "cube"}, "b": {"type": "cube"}, "sun": {"type": "constant"}}
    lit = MitsubaScene(path=content).load_lit()
    assert [shape.id() for shape in lit.shapes()] == ["a", "b"]
    assert [emitter.id() for emitter in lit.emitters()] == ["sun"]


def test_everything_named_can_be_moved(path):
    sky = {"parameter": "sky.radiance.value", "start": 1, "end": 4}
    lamp = {"parameter": "light1.position", "start": [0, 0, 0], "end": [5, 6, 7]}
    more = [{"name": "sky", "value": sky}, {"name": "lamp", "value": lamp}]
    for add in ({}, {"bulb": BULB}):
        stage = Stage(MitsubaScene(path=path, add=add, animation={"variables": [UP, *more]}))
        stage.set([1.0, 1.0, 1.0])
        params = mitsuba().traverse(stage.mi_scene)
        box = next(s for s in stage.mi_scene.shapes() if s.id() == "mesh.001").bbox()
        np.testing.assert_allclose(np.array(box.max).reshape(3), [1, 2, 1], atol=1e-6)
        np.testing.assert_allclose(np.array(params["sky.radiance.value"]).reshape(-1), 4.0)
        np.testing.assert_allclose(np.array(params["light1.position"]).reshape(3), [5, 6, 7])


def test_files_of_added_parts_lie_beside_the_scene(path, monkeypatch):
    monkeypatch.chdir("/")
    tile = {"type": "obj", "filename": "tile.obj", "bsdf": GREY}
    where = MitsubaScene(path=path, add={"tile": tile})
    assert "tile" in [shape.id() for shape in where.load_lit().shapes()]
    before = where.lit_fingerprint()
    assert before == MitsubaScene(path=path, add={"tile": tile}).lit_fingerprint()
    (path.parent / "tile.obj").write_text("v -2 0 -1\nv 1 0 -1\nv 1 0 1\nf 1 3 2\n")
    assert before != MitsubaScene(path=path, add={"tile": tile}).lit_fingerprint()
    missing = MitsubaScene(path=path, add={"tile": {**tile, "filename": "none.obj"}})
    with pytest.raises(PrtError, match=r"needs .*none\.obj, which does not exist"):
        missing.lit_fingerprint()


def test_other_tasks_see_neither_added_parts_nor_motions(path):
    plain, moving = (
        MitsubaScene(path=path),
        MitsubaScene(path=path, add={"bulb": BULB}, animation={"variables": [UP]}),
    )
    assert plain.fingerprint() == moving.fingerprint()
    a, b = plain.load(), moving.load()
    assert len(a.emitters()) == len(b.emitters()) == 0 and len(a.shapes()) == len(b.shapes())
    assert list(a.bbox().max) == list(b.bbox().max)
    assert len(plain.load_lit().sensors()) == 0


def test_lit_fingerprints_follow_all_that_is_seen(path):
    def of(file=path, **settings) -> str:
        found = MitsubaScene(path=file, **settings).lit_fingerprint()
        return json.dumps(found, sort_keys=True)

    other_light = path.parent / "other.xml"
    other_light.write_text(FILE.replace('value="9"', 'value="8"'))
    brighter = json.loads(json.dumps(BULB))
    brighter["emitter"]["radiance"]["value"][0] = 5.0
    further = {**UP, "translate": {**UP["translate"], "end": [0, 2, 0]}}
    found = [
        of(), of(other_light), of(add={"bulb": BULB}), of(add={"bulb": brighter}), of(add={"lamp": BULB}),
        of(animation={"variables": [UP]}), of(animation={"variables": [further]}),
        of(animation={"variables": [UP]}, variables=0), of(roughness=0.5), of(open=["Panel"]),
    ]  # fmt: skip
    assert len(set(found)) == len(found)
    assert of() == found[0]
    content = {"box": {"type": "cube"}, "sky": {"type": "constant", "radiance": 1.0}}
    assert of(content) != of({**content, "sky": {"type": "constant", "radiance": 2.0}})


def test_environment_maps_count_by_their_content(path):
    mi = mitsuba()
    sky = path.parent / "sky.exr"
    content = {"box": {"type": "cube"}, "sky": {"type": "envmap", "filename": str(sky)}}
    found = []
    for value in (1.0, 2.0):
        mi.Bitmap(np.full((4, 8, 3), value, dtype=np.float32)).write(str(sky))
        found.append(MitsubaScene(path=content).lit_fingerprint())
    assert found[0] != found[1] and found[0]["scene"] == found[1]["scene"]


def test_mistakes_are_said_in_one_line(path):
    says("itself has a part called 'Panel'", path, add={"Panel": BULB})
    says("itself has a part called 'sky'", path, add={"sky": {"type": "constant"}})
    says(r"cannot build scene\.path=.*nosuch", path, add={"x": {"type": "nosuch"}})
    for wrong in ([1], "lamp", {"lamp": 3}):
        says(r"scene\.add=.*must map ids", path, add=wrong)
    # a part that is added but does not shine is no light either
    says("no emitters", {"box": {"type": "cube"}})
    says("no emitters", {"box": {"type": "cube"}}, add={"more": {"type": "sphere"}})
    assert len(MitsubaScene(path={"box": {"type": "cube"}}, add={"bulb": BULB}).load_lit().emitters()) == 1
    says(r"scene\.variables=2.*from 0 to 1", path, animation={"variables": [UP]}, variables=2)

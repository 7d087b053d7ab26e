"""The built-in scenes that lightmaps are baked for, and what :class:`Scene` offers for them."""

import dataclasses

import numpy as np
import pytest
from data_scenes import scene

from prt.errors import PrtError
from prt.scene import bending, cornell_box
from prt.scene.capture import camera_rays
from prt.scene.closing import open_edges
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import block, joined

LAMP = {"type": "point", "position": [0.0, 1.5, 0.5], "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}


def volume(data) -> float:
    """Enclosed volume by the divergence theorem: negative if the faces are wound inwards."""
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def normals_agree(data) -> bool:
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    agree = np.einsum("ij,ij->i", cross, data.normal[data.face].mean(axis=1))
    return agree.sum() > 0.97 * np.linalg.norm(cross, axis=1).sum() and (agree > 0).mean() > 0.99


# ---- what all scenes offer


@pytest.fixture(scope="module")
def box():
    return scene("cornell_box")


def test_any_number_of_emitters_by_name(box):
    assert box.load().emitters() == [] == box.load_with({}).emitters()
    assert len(box.load(LAMP).emitters()) == 1
    lit = box.load_with({"light_0": LAMP, "light_1": {**LAMP, "position": [0.5, 1.0, 0.0]}, "sky": LAMP})
    assert len(lit.emitters()) == 3
    # a shape that is called like an emitter is not lost
    clash = box.load_with({"floor": LAMP})
    assert len(clash.shapes()) == len(box.load().shapes()) and len(clash.emitters()) == 1
    assert clash.bbox() == box.load().bbox()


def test_scenes_of_files_take_emitters_by_name_too():
    content = {"light": {"type": "cube", "bsdf": {"type": "diffuse"}}, "lamp": LAMP}
    found = MitsubaScene(path=content)
    assert len(found.load().emitters()) == 0
    lit = found.load_with({"light_0": LAMP, "light_1": {"type": "constant"}})
    assert len(lit.emitters()) == 2 and len(lit.shapes()) == 1
    assert found.poses == 1 and found.medium is None


def test_a_scene_that_stands_still_has_one_pose(box):
    assert box.poses == 1 and box.posed(0) is box and box.medium is None
    for wrong in (1, -1, 0.5, "now", None):
        with pytest.raises(PrtError, match="pose=.*cornell_box has only pose 0") as caught:
            box.posed(wrong)
        assert "\n" not in str(caught.value)


# ---- panels


def test_blocks_face_outwards_and_leave_sides_out():
    whole = block((-1, 0, -2), (3, 0.1, 2.3))
    assert volume(whole) == pytest.approx(4 * 0.1 * 4.3) and normals_agree(whole)
    assert len(open_edges(whole)) == 0 and len(whole.face) == 12
    part = block((-1, 0, -2), (3, 0.1, 2.3), without=("bottom", "back"))
    assert len(part.face) == 8 and part.position[:, 2].min() == -2
    assert not ((part.normal == (0, -1, 0)).all(1) | (part.normal == (0, 0, -1)).all(1)).any()
    # no two sides share a place in texture space
    assert len(np.unique(whole.uv.reshape(6, 4, 2).mean(axis=1).round(6), axis=0)) == 6


# ---- cornell_box


def test_cornell_box_is_one_closed_surface_seen_from_inside():
    meshes = cornell_box.meshes()
    whole = joined(list(meshes.values()))
    assert len(open_edges(whole)) == 0, "walls and boxes meet edge to edge"
    assert normals_agree(whole)
    assert volume(whole) == pytest.approx(-(2 * 2 * 2.75 - 0.36 * 0.6 - 0.36 * 1.2))
    area = {
        name: np.linalg.norm(np.cross(*(np.diff(m.position[m.face], axis=1).swapaxes(0, 1))), axis=1).sum()
        / 2
        for name, m in meshes.items()
    }
    assert area["floor"] == pytest.approx(2 * 2.75 - 2 * 0.36)
    assert area["tall_box"] == pytest.approx(0.36 + 4 * 0.6 * 1.2)


def test_no_ray_leaves_the_cornell_box(box):
    mi, count = mitsuba(), 300_000
    rng = np.random.default_rng(0)
    origin = rng.uniform((-0.95, 1.25, -0.95), (0.95, 1.95, 1.7), (count, 3))  # above the boxes
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ray = mi.Ray3f(
        mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(np.ascontiguousarray(direction.T, np.float32))
    )
    si = box.load().ray_intersect(ray)
    assert np.array(si.is_valid()).all()
    facing = (np.array(mi.Vector3f(si.n)) * direction.T).sum(0)
    assert (facing < 1e-3).all(), "only the insides of walls and the outsides of boxes are seen"


@pytest.mark.parametrize("split", ["train", "far"])
def test_cornell_cameras_stand_inside_and_see_surfaces_only(box, split):
    mi_scene, seen, mi = box.load(), set(), mitsuba()
    names = {str(np.array(s.bbox().max).round(3)) + str(np.array(s.bbox().min).round(3)): s.id()
             for s in mi_scene.shapes()}  # fmt: skip
    assert len(names) == 8
    for view in box.views(split, 14, 32):
        x, y, z = view.origin
        assert abs(x) < 0.9 and 0.3 < y < 1.9 and 1.0 < z < 1.7
        si = mi_scene.ray_intersect(camera_rays(view))
        assert np.array(si.is_valid()).all()
        away = np.linalg.norm(np.array(mi.Point3f(si.p)).T - view.origin, axis=1)
        assert away.min() > 0.2 and np.median(away) > 1.0
        for shape in mi_scene.shapes():
            if (np.array(si.shape == mi.ShapePtr(shape))).any():
                seen.add(shape.id())
    assert seen >= {"floor", "ceiling", "back", "left", "right", "short_box", "tall_box"}


def test_cornell_box_settings(box):
    assert box.fingerprint() == scene("cornell_box").fingerprint()
    assert box.fingerprint() != scene("cornell_box", "scene.white=0.5").fingerprint()
    with pytest.raises(PrtError, match=r"scene\.white=1\.0"):
        scene("cornell_box", "scene.white=1.0")


# ---- bending


@pytest.fixture(scope="module")
def animated():
    return scene("bending", "scene.keyframes=5")


@pytest.mark.parametrize("angle", [0.0, 1e-7, 20.0, bending.STEEPEST])
def test_bent_columns_stand_on_the_plate_and_clear_of_the_wall(angle):
    straight = bending.column(0.0, 0.0)
    foot = straight.position[:, 1] == 0.0
    assert foot.sum() > 50
    for side in np.arange(0.0, 360.0, 30.0):
        bent = bending.column(angle, side)
        assert bent.position[:, 1].min() > -1e-9
        assert np.allclose(bent.position[foot], straight.position[foot], atol=1e-9)
        assert bent.position[:, 0].min() > -1.15 and np.abs(bent.position[:, [0, 2]]).max() < 1.2
        assert np.array_equal(bent.face, straight.face) and np.array_equal(bent.uv, straight.uv)
        assert np.allclose(np.linalg.norm(bent.normal, axis=1), 1.0) and normals_agree(bent)
        welded = dataclasses.replace(bent, position=bent.position.round(9))
        assert len(open_edges(welded)) == 0
        assert volume(bent) == pytest.approx(volume(straight), rel=1e-3)


def test_poses_are_keyframes_of_one_mesh(animated):
    mi = mitsuba()
    assert animated.poses == 5 and animated.posed(0) is animated
    position, face = [], []
    for pose in range(animated.poses):
        params = mi.traverse(animated.posed(pose).description()["column"])
        position.append(np.array(params["vertex_positions"]))
        face.append(np.array(params["faces"]))
        assert animated.posed(pose).posed(0).fingerprint() == animated.fingerprint()
    assert all(np.array_equal(face[0], other) for other in face)
    assert all(np.abs(position[0] - other).max() > 0.05 for other in position[1:])
    prints = [str(animated.posed(pose).fingerprint()) for pose in range(animated.poses)]
    assert len(set(prints)) == 5
    with pytest.raises(PrtError, match="pose=5: scene bending has poses 0 to 4"):
        animated.posed(5)


def test_bounds_follow_the_pose_and_cameras_see_it(animated):
    low, high = animated.bounds
    assert low == pytest.approx((-1.3, -0.06, -1.2)) and high == pytest.approx((1.3, 1.6, 1.2))
    mi_scene = animated.posed(3).load()
    for view in animated.views("train", 6, 24) + animated.views("far", 6, 24):
        si = mi_scene.ray_intersect(camera_rays(view))
        hit, t = np.array(si.is_valid()), np.array(si.t)
        assert hit.mean() > 0.4 and t[hit].min() > 1.5


def test_keyframes_are_drawn_from_their_range(animated):
    angle, side = np.array(scene("bending", "scene.keyframes=400", "scene.bend=[10,30]").bends).T
    assert 10 <= angle.min() < 11 and 29 < angle.max() <= 30
    assert side.min() < 5 and side.max() > 355
    assert scene("bending", "scene.keyframes=9").bends[:5] == animated.bends
    assert scene("bending").poses == 2
    for other in ("scene.seed=1", "scene.bend=[0,50]", "scene.keyframes=6"):
        changed = scene("bending", "scene.keyframes=5", other)
        assert changed.fingerprint() != animated.fingerprint(), other


@pytest.mark.parametrize(
    "override, message",
    [
        ("scene.keyframes=0", "keyframes=0"),
        ("scene.seed=-1", "seed=-1"),
        ("scene.bend=[0,80]", r"scene\.bend=80"),
        ("scene.bend=[40,20]", "must rise"),
        ("scene.bend=30", "list of 2 angles"),
    ],
)
def test_wrong_settings_of_bending_are_refused(override, message):
    with pytest.raises(PrtError, match=message) as caught:
        scene("bending", override)
    assert "\n" not in str(caught.value)

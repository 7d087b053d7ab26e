"""The built-in scenes: settings, determinism, closed smooth meshes, cameras that see the scene."""

from pathlib import Path

import numpy as np
import pytest
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf

from prt.errors import PrtError
from prt.scene import shapes
from prt.scene.capture import sensor_description
from prt.scene.mitsuba_setup import mitsuba

CONF = Path(__file__).parents[2] / "conf" / "scene"
NAMES = ("cornell_glossy", "four_shapes", "mirror_room")
ALLOWED_BSDFS = {
    "diffuse",
    "principled",
    "roughconductor",
    "conductor",
    "roughplastic",
    "plastic",
    "dielectric",
    "twosided",
}


def config(name):
    return OmegaConf.load(CONF / f"{name}.yaml")


@pytest.fixture(scope="module", params=NAMES)
def scene(request):
    return instantiate(config(request.param))


def first_hits(mi_scene, view, size=24):
    """Distance of the first hit of each pixel's centre ray, infinite where it leaves."""
    mi = mitsuba()
    sensor = mi.load_dict(sensor_description(view))
    grid = (np.arange(size) + 0.5) / size
    x, y = (part.ravel().astype(np.float32) for part in np.meshgrid(grid, grid))
    ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    # from the camera itself, not from the near clipping plane: what is closer must not be overlooked
    ray.o = mi.Point3f(*view.origin)
    hit = mi_scene.ray_intersect_preliminary(ray)
    return np.where(np.array(hit.is_valid()), np.array(hit.t), np.inf)


@pytest.mark.parametrize("split", ["train", "far"])
def test_cameras_stay_outside_and_see_the_scene(scene, split):
    mi_scene = scene.load()
    views = scene.views(split, 12, 24)
    distances = np.stack([first_hits(mi_scene, view) for view in views])
    share = np.isfinite(distances).mean(axis=1)
    assert share.min() > 0.6, f"hit shares {share.round(2)}"
    assert share.mean() > 0.8
    assert distances.min() > 0.8, "a camera comes too close to a surface"


def test_test_views_are_not_training_views(scene):
    train = np.array([view.origin for view in scene.views("train", 40, 8)])
    far = np.array([view.origin for view in scene.views("far", 12, 8)])
    assert np.linalg.norm(train[:, None] - far[None], axis=-1).min() > 0.02


def test_loading_twice_gives_the_same_picture_bit_for_bit(scene):
    """Mitsuba merges meshes in an order of its own, so it is what is seen that must not change."""
    mi = mitsuba()
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    for view in scene.views("far", 3, 24):
        sensor = mi.load_dict(sensor_description(view))
        images = [
            np.array(
                mi.render(
                    scene.load({"type": "constant"}), integrator=integrator, sensor=sensor, spp=2, seed=7
                )
            )
            for _ in range(2)
        ]
        assert np.array_equal(*images)
        assert images[0].std() > 0.0


def test_materials_are_ones_the_gbuffer_knows(scene):
    def kinds(content):
        for value in content.values():
            if isinstance(value, dict):
                if "bsdf" in value:
                    yield value["bsdf"]["type"]
                yield from kinds(value)

    assert set(kinds(scene.description())) <= ALLOWED_BSDFS
    assert scene.load().emitters() == []


def test_fingerprint_knows_materials_but_not_cameras(scene):
    base = config(scene.name)
    moved = OmegaConf.merge(base, {})
    moved.cameras.train = moved.cameras.train[:1]
    assert instantiate(moved).fingerprint() == scene.fingerprint()
    settings = [key for key in base if key not in ("_target_", "name", "cameras", "max_depth", "record")]
    assert settings
    for key in settings:
        other = {"Ag": "Au", "Au": "Ag", "Cu": "Ag"}.get(base[key]) if isinstance(base[key], str) else 0.77
        changed = instantiate(OmegaConf.merge(base, {key: other}))
        assert changed.fingerprint() != scene.fingerprint(), key


@pytest.mark.parametrize(
    "name, key, value",
    [
        ("cornell_glossy", "floor_roughness", 1.5),
        ("cornell_glossy", "sphere_metal", "Unobtainium"),
        ("cornell_glossy", "record", "magic"),
        ("four_shapes", "ring_roughness", -0.1),
        ("four_shapes", "ring_metal", "gold"),
        ("mirror_room", "mirror_roughness", 0.005),
        ("mirror_room", "mirror_roughness", 2),
        ("mirror_room", "max_depth", 1),
    ],
)
def test_wrong_settings_are_refused_when_built(name, key, value):
    with pytest.raises((PrtError, InstantiationException), match=key if "metal" not in key else "metal"):
        instantiate(OmegaConf.merge(config(name), {key: value}))


def test_mirror_roughness_reaches_the_renderer():
    base = config("mirror_room")
    rough = instantiate(OmegaConf.merge(base, {"mirror_roughness": 0.3})).description()["mirror"]["bsdf"][
        "bsdf"
    ]
    assert rough["type"] == "roughconductor" and rough["alpha"] == pytest.approx(0.09)
    smooth = instantiate(OmegaConf.merge(base, {"mirror_roughness": 0})).description()["mirror"]["bsdf"][
        "bsdf"
    ]
    assert smooth["type"] == "conductor"


def volume(data):
    """Enclosed volume by the divergence theorem: negative if the faces are wound inwards."""
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0


def test_meshes_enclose_the_volume_of_their_shape():
    assert volume(shapes.sphere_mesh(0.7)) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.01)
    assert volume(shapes.torus_mesh(0.6, 0.2)) == pytest.approx(2 * np.pi**2 * 0.6 * 0.04, rel=0.01)


@pytest.mark.parametrize(
    "build",
    [
        lambda: shapes.sphere_mesh(1.0),
        lambda: shapes.superquadric_mesh(0.4, 0.35, 0.35),
        lambda: shapes.torus_mesh(0.6, (0.03, 0.14), 128, 32, bulge=0.6),
        lambda: shapes.twisted_column_mesh(0.36, 1.25),
        lambda: shapes.vase_mesh(0.4, 1.05),
    ],
    ids=["sphere", "box", "ring", "column", "vase"],
)
def test_meshes_are_closed_and_smooth(build):
    data = build()
    assert np.isfinite(data.normal).all() and np.allclose(np.linalg.norm(data.normal, axis=1), 1.0)
    assert 2000 <= len(data.face) <= 10000
    # seams are doubled vertices: welded by position, every edge belongs to exactly two faces
    _, welded = np.unique(data.position.round(9), axis=0, return_inverse=True)
    face = welded.reshape(-1)[data.face]
    edges = np.sort(np.concatenate([face[:, [0, 1]], face[:, [1, 2]], face[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    # normals point out of the face they belong to; area weights, for slivers at poles have no direction
    a, b, c = (data.position[data.face[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    mean = data.normal[data.face].mean(axis=1)
    agree = np.einsum("ij,ij->i", cross, mean)
    assert agree.sum() > 0.97 * np.linalg.norm(cross, axis=1).sum()
    assert (agree > 0).mean() > 0.99


def test_moved_turns_about_the_vertical_and_ring_lies_on_the_ground():
    data = shapes.torus_mesh(0.6, 0.2)
    moved = data.moved(scale=2.0, turn=90.0, to=(1.0, 0.0, 0.0))
    front = np.argmax(data.position[:, 2])
    assert moved.position[front] == pytest.approx((1.0 + 2 * 0.8, 0.0, 0.0), abs=1e-9)
    assert shapes.torus_mesh(0.6, 0.2).on_ground().position[:, 1].min() == pytest.approx(0.0)
    low = shapes.ring_description(center=(0.5, 0.0, 0.2)).bbox().min
    assert low[1] == pytest.approx(0.0, abs=1e-6)

"""The G-buffer: the camera is Mitsuba's own, directions are consistent, masks are looked through."""

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.scene.capture import camera_rays, capture, pixel_directions, sensor_description
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

VIEW = View(origin=(1.0, 2.0, 6.0), target=(0.0, 0.8, 0.0), fov=40.0, width=24, height=16)


def small_scene(**more):
    mi = mitsuba()
    content = {
        "type": "scene",
        "ground": {"type": "rectangle", "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(3)},
        "ball": {"type": "sphere", "center": [0, 1, 0], "bsdf": {"type": "roughconductor", "alpha": 0.09}},
    }
    return mi.load_dict({**content, **more})


@pytest.mark.parametrize("size", [(24, 16), (16, 24), (17, 17)])
def test_rays_are_those_of_mitsubas_sensor(size):
    mi = mitsuba()
    view = VIEW.resized(*size)
    x, y = np.meshgrid((np.arange(size[0]) + 0.5) / size[0], (np.arange(size[1]) + 0.5) / size[1])
    film = mi.Point2f(np.stack([x.ravel(), y.ravel()]).astype(np.float32))
    rays, _ = mi.load_dict(sensor_description(view)).sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    assert np.abs(np.array(rays.d).T - pixel_directions(view)).max() < 2e-6
    assert np.abs(np.array(rays.o) - np.array(camera_rays(view).o)).max() < 2e-6


def test_positions_agree_with_mitsubas_own_render():
    """The aov integrator with one sample at each pixel centre sees the same points."""
    mi = mitsuba()
    scene = small_scene()
    sensor = mi.load_dict({**sensor_description(VIEW, 64)})
    image = np.array(
        mi.render(
            scene, sensor=sensor, integrator=mi.load_dict({"type": "aov", "aovs": "p:position"}), spp=64
        )
    )
    g = capture(scene, VIEW)
    mine = g.image(g.position).numpy()
    flat = g.hit.reshape(16, 24).numpy() & (np.abs(mine[..., 1]) < 1e-4)
    inside = flat & np.roll(flat, 1, 0) & np.roll(flat, -1, 0) & np.roll(flat, 1, 1) & np.roll(flat, -1, 1)
    assert inside.sum() > 30
    assert np.abs(image[..., :3] - mine)[inside].max() < 0.12  # pixels of the ground are up to 0.5 deep


def test_directions_are_unit_and_mirrored():
    g = capture(small_scene(), VIEW)
    assert 0 < len(g) < VIEW.width * VIEW.height and len(g) == int(g.hit.sum())
    for name in ("normal", "wo", "wr"):
        assert torch.allclose(getattr(g, name).norm(dim=1), torch.ones(len(g)), atol=1e-5)
    cosine = (g.normal * g.wo).sum(1, keepdim=True)
    assert cosine.min() >= -1e-6
    assert torch.allclose(g.wr, 2 * cosine * g.normal - g.wo, atol=1e-5)
    assert torch.allclose(
        g.wo, torch.nn.functional.normalize(torch.tensor(VIEW.origin) - g.position, dim=1), atol=1e-5
    )
    ball = g.roughness[:, 0] < 0.5
    assert torch.allclose(g.normal[ball], g.position[ball] - torch.tensor([0.0, 1.0, 0.0]), atol=1e-4)


def test_an_emitter_changes_nothing():
    dark, lit = capture(small_scene(), VIEW), capture(small_scene(light={"type": "constant"}), VIEW)
    for name in dark.FIELDS:
        assert torch.equal(getattr(dark, name), getattr(lit, name))


def pane(opacity):
    return {
        "type": "rectangle",
        "to_world": mitsuba().ScalarTransform4f().translate([0, 1, 3]),
        "bsdf": {"type": "mask", "opacity": opacity, "b": {"type": "diffuse"}},
    }


def test_transparent_parts_of_a_mask_are_looked_through():
    checks = {"type": "checkerboard", "color0": 0.1, "color1": 0.9}
    bare, solid, checked = (
        capture(small_scene(**more), VIEW) for more in ({}, {"pane": pane(1.0)}, {"pane": pane(checks)})
    )
    depth = [g.image(g.position)[..., 2] for g in (bare, solid, checked)]
    on_solid, on_checked = ((d - 3.0).abs() < 1e-4 for d in depth[1:])
    assert 0.3 < on_checked.sum() / on_solid.sum() < 0.7
    assert torch.allclose(depth[0][~on_checked], depth[2][~on_checked], atol=5e-3)


def test_thin_glass_stays_a_surface():
    glass = {**pane(1.0), "bsdf": {"type": "thindielectric"}}
    g = capture(small_scene(glass=glass), VIEW)
    assert ((g.position[:, 2] - 3.0).abs() < 1e-4).sum() > 50


def test_empty_view():
    g = capture(small_scene(), View(origin=(0.0, 2.0, 6.0), target=(0.0, 9.0, 9.0), width=4, height=4))
    assert len(g) == 0 and not g.hit.any() and g.hit.shape == (16,)
    assert g.image(g.diffuse).shape == (4, 4, 3)


def test_mesh_without_normals(tmp_path):
    """A pyramid without vertex normals, with one degenerate triangle, gives finite unit normals."""
    (tmp_path / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
        "-1 0 1\n1 0 1\n0 2 0\n0 0 -1\n5 5 5\n3 0 1 2\n3 1 3 2\n3 3 0 2\n3 4 4 4\n"
    )
    mi = mitsuba()
    scene = mi.load_dict({"type": "scene", "mesh": {"type": "ply", "filename": str(tmp_path / "mesh.ply")}})
    g = capture(scene, VIEW)
    assert len(g) > 20
    assert torch.allclose(g.normal.norm(dim=1), torch.ones(len(g)), atol=1e-5)
    assert ((g.normal * g.wo).sum(1) >= -1e-6).all()


@pytest.mark.parametrize(
    "view",
    [
        View((0, 0, 0), (0, 0, 0)),
        View((0, 5, 0), (0, 0, 0), up=(0, 1, 0)),
        View((0, 0, 5), (0, 0, 0), fov=180.0),
    ],
)
def test_degenerate_camera_is_an_error(view):
    with pytest.raises(PrtError, match="view"):
        capture(small_scene(), view)

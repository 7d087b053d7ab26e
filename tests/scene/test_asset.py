"""A scene as an asset: orientation, places in the lightmap, measurement points."""

import pytest
import torch

from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError
from prt.scene.lightmap_points import AtlasGBuffer
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

VIEW = View((0.0, 1.0, 3.0), (0.0, 0.5, 0.0), width=32, height=32)


def at(view):
    def one(places):
        return [view for _ in places]

    return {"train": [one], "far": [one]}


def diffuse(color):
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}}


@pytest.fixture(scope="module")
def asset():
    """A floor, and a wall behind it that is modelled facing away from the camera."""
    up = mitsuba().ScalarTransform4f().rotate([1, 0, 0], -90)
    away = mitsuba().ScalarTransform4f().translate([0, 1, -1]).rotate([0, 1, 0], 180)
    content = {
        "floor": {"type": "rectangle", "to_world": up, "bsdf": diffuse([0.2, 0.4, 0.6])},
        "wall": {"type": "rectangle", "to_world": away, "bsdf": diffuse([0.7, 0.1, 0.3])},
    }
    return MitsubaScene("corner", content, at(VIEW), max_depth=3).asset(32)


def test_a_wall_that_is_seen_from_behind_is_turned(asset):
    for points in (asset.measure_points(64, 2, 0), asset.sites(), asset.texel_gbuffer()):
        wall = points.position[:, 1] > 1e-3
        assert bool(wall.any()) and bool((points.normal[wall, 2] > 0.99).all())
        assert bool((points.normal[~wall, 1] > 0.99).all())


def test_reflectances_at_points_are_the_materials(asset):
    points = asset.measure_points(64, 1, 0)
    wall = points.position[:, 1] > 1e-3
    assert torch.allclose(
        points.albedo[wall], torch.tensor([0.7, 0.1, 0.3]).expand(int(wall.sum()), 3), atol=1e-3
    )
    assert torch.allclose(
        points.albedo[~wall], torch.tensor([0.2, 0.4, 0.6]).expand(int((~wall).sum()), 3), atol=1e-3
    )
    floor = asset.mesh().position[:, 1].abs() < 1e-6
    assert asset.vertex_albedo().shape == (len(floor), 3)


def test_measure_points_are_the_same_for_equal_seeds_and_even(asset):
    first, again, other = (asset.measure_points(32, 4, seed) for seed in (1, 1, 2))
    assert torch.equal(first.position, again.position) and not torch.equal(first.position, other.position)
    assert bool((torch.bincount(first.group) == 4).all())
    # two squares of equal area
    assert 0.4 < float((first.position[:, 1] > 1e-3).float().mean()) < 0.6


def test_a_pixel_finds_its_place_in_the_lightmap(asset):
    """Positions stored as a lightmap come back where a ray hits, within a texel."""
    sites = asset.sites()
    many = torch.bincount(sites.texel, minlength=len(asset.covered))[asset.covered]
    total = torch.zeros((int(asset.covered.sum()), 3))
    place = (asset.covered.cumsum(0) - 1)[sites.texel]
    stored = total.index_add_(0, place, sites.position) / many[:, None]
    gbuffer = asset.capture(asset.load({}), VIEW)
    height, width = asset.size
    texel = (gbuffer.uv[:, 1] * height).long() * width + (gbuffer.uv[:, 0] * width).long()
    found = stored[asset.fill[texel]]
    texel_size = 2.0 / (0.5 * min(height, width)) * 2
    assert float((found - gbuffer.position).norm(dim=1).max()) < texel_size
    # and the triangle with its weights says the same
    mesh = asset.mesh()
    corners = mesh.position[mesh.face[gbuffer.triangle]]
    b, c = gbuffer.barycentric.T[..., None]
    again = (1 - b - c) * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2]
    assert torch.allclose(again, gbuffer.position, atol=1e-4)


def test_the_lightmap_is_a_gbuffer_of_its_texels(asset):
    gbuffer = asset.texel_gbuffer()
    assert isinstance(gbuffer, AtlasGBuffer) and len(gbuffer) == int(asset.covered.sum())
    image = gbuffer.image(gbuffer.uv)
    height, width = asset.size
    rows, columns = asset.covered.view(height, width).nonzero().T
    assert torch.allclose(image[rows, columns, 0], (columns + 0.5) / width)
    assert torch.allclose(image[rows, columns, 1], (rows + 0.5) / height)


def test_samples_of_a_pixel_are_averaged(asset):
    gbuffer = asset.capture(asset.load({}), VIEW)
    gbuffer.supersample = 4
    values = torch.rand((len(gbuffer), 3))
    image = gbuffer.image(values)
    assert image.shape == (8, 8, 3)
    whole = torch.zeros((32 * 32, 3))
    whole[gbuffer.hit] = values
    assert torch.allclose(image[2, 3], whole.view(32, 32, 3)[8:12, 12:16].mean((0, 1)))
    assert gbuffer.to("cpu").supersample == 4


def test_poses_share_places_and_move_them():
    cfg = compose(
        ["task=local_lights", "lighting=spots", "scene=bending", "method=svd_transfer", "budget=smoke"]
    )
    asset = build(cfg, "scene").asset(24)
    first, second = asset.measure_points(16, 2, 0, 0), asset.measure_points(16, 2, 0, 1)
    assert torch.equal(first.group, second.group) and not torch.allclose(first.position, second.position)
    assert torch.equal(asset.sites(0).texel, asset.sites(1).texel)
    assert asset.poses == 2 and len(asset.fingerprint()["frames"]) == 2


def test_shapes_that_have_no_lightmap_are_refused(tmp_path):
    (tmp_path / "curve.txt").write_text("0 0 0 0.1\n1 0 0 0.1\n2 0 0 0.1\n3 0 0 0.1\n")
    hair = {"type": "bsplinecurve", "filename": str(tmp_path / "curve.txt"), "bsdf": {"type": "diffuse"}}
    with pytest.raises(PrtError, match="which has no lightmap here"):
        MitsubaScene("lock", {"lock": hair}, at(VIEW), max_depth=3).asset(16).sites()

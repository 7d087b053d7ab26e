"""Which places of an asset are baked and measured: insides, orientation, and the way back from a pixel."""

import dataclasses

import pytest
import torch

from prt.scene.asset import SurfaceAsset
from prt.scene.mitsuba_file import MitsubaScene
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.panels import block, panel
from prt.scene.scene import Scene
from prt.scene.shapes import diffuse, to_mesh, twosided
from prt.scene.view import View

VIEW = View((1.0, 1.5, 3.0), (0.0, 0.2, 0.0), width=48, height=48)
COLORS = {"floor": (0.2, 0.4, 0.6), "box": (0.7, 0.1, 0.3), "wall": (0.5, 0.5, 0.1)}


class Corner(Scene):
    """A floor, a box standing on it and a wall, each of them perhaps the wrong way round."""

    def __init__(self, turned=(), wound=(), name="corner"):
        super().__init__(name, {split: [lambda places: [VIEW for _ in places]] for split in ("train", "far")})
        self.turned, self.wound = turned, wound

    def description(self):
        meshes = {
            "floor": panel((-1, 0, 1), (2, 0, 0), (0, 0, -2)),
            "box": block((-0.4, 0.0, -0.4), (0.4, 0.8, 0.4)),
            "wall": panel((-1, 0, -1), (2, 0, 0), (0, 1.5, 0)),
        }
        out = {}
        for name, mesh in meshes.items():
            if name in self.turned:
                mesh = dataclasses.replace(mesh, normal=-mesh.normal, face=mesh.face[:, ::-1].copy())
            if name in self.wound:  # only the order of the corners, as some exporters do
                mesh = dataclasses.replace(mesh, face=mesh.face[:, ::-1].copy())
            out[name] = to_mesh(name, mesh, twosided(diffuse(COLORS[name])))
        return out

    def fingerprint(self):
        return {"turned": list(self.turned), "wound": list(self.wound)}


@pytest.fixture(autouse=True)
def cache(own_cache):
    return own_cache


WAYS = [((), ()), (("floor",), ()), (("wall", "box"), ()), ((), ("box", "floor")), (("wall",), ("wall",))]


@pytest.mark.parametrize("turned, wound", WAYS)
def test_what_is_looked_at_is_out_and_what_is_enclosed_is_hidden(turned, wound):
    asset = SurfaceAsset(Corner(turned, wound), 48)
    for points in (asset.sites(), asset.measure_points(96, 2, 0), asset.texel_gbuffer()):
        p, n = points.position, points.normal
        floor, wall = p[:, 1] < 1e-4, p[:, 2] < -1 + 1e-4
        under = floor & (n[:, 1] > 0) & (p[:, [0, 2]].abs() < 0.36).all(1)
        out = ~floor & ~wall
        assert bool((n[wall, 2] > 0.99).all()) and bool(wall.any())
        assert bool((((p - torch.tensor([0, 0.4, 0])) * n).sum(1)[out] > 0).all()) and bool(out.any())
        if not hasattr(points, "group"):
            assert not bool(under.any())
            free = floor & (n[:, 1] > 0.99) & (p[:, [0, 2]].abs() > 0.5).any(1)
            assert int(free.sum()) > 50
    mesh = asset.mesh()
    assert bool((asset.face_normal() * mesh.normal[mesh.face[:, 0]]).sum(1).gt(0.9).all())


@pytest.mark.parametrize("turned, wound", WAYS[:3])
def test_a_pixel_looks_up_its_own_position(turned, wound):
    """Positions stored in the lightmap come back by bilinear lookup, far finer than a texel."""
    asset = SurfaceAsset(Corner(turned, wound), 64)
    height, width = asset.size
    gbuffer = asset.texel_gbuffer()
    # exact: the position at the texel's centre, of those whose centre is on the surface
    texel = asset.covered.nonzero()[:, 0]
    stored = torch.full((height * width, 3), float("nan"))
    stored[texel] = gbuffer.position
    image = stored.view(height, width, 3)
    pixels = asset.capture(asset.load({}), VIEW)
    x, y = pixels.uv[:, 0] * width - 0.5, pixels.uv[:, 1] * height - 0.5
    column, row = x.floor().long(), y.floor().long()
    found = torch.zeros_like(pixels.position)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = (y - row if i else 1 - (y - row)) * (x - column if j else 1 - (x - column))
        found += weight[:, None] * image[(row + i).clamp(0, height - 1), (column + j).clamp(0, width - 1)]
    inner = found.isfinite().all(1)
    assert float(inner.float().mean()) > 0.8
    world = asset.mesh().position[asset.mesh().face]
    area = torch.linalg.cross(world[:, 1] - world[:, 0], world[:, 2] - world[:, 0]).norm(dim=1).sum() / 2
    size = float((area / asset.covered.sum()).sqrt())
    error = (found - pixels.position).norm(dim=1)[inner]
    # a texel's stand-in lies up to half a texel from its centre
    assert float(error.median()) < 0.5 * size and float(error.quantile(0.95)) < size


def test_shapes_that_mitsuba_merges_are_turned_one_by_one():
    transform = mitsuba().ScalarTransform4f
    both = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    cube = transform().translate([0, 0.3, 0]).scale(0.2)
    content = {
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90), "bsdf": both},
        "wall": {"type": "rectangle", "to_world": transform().translate([0, 1, -1]).rotate([0, 1, 0], 180),
                 "bsdf": both},
        "cube": {"type": "cube", "to_world": cube, "bsdf": both},
    }  # fmt: skip
    cameras = {split: [lambda places: [VIEW for _ in places]] for split in ("train", "far")}
    asset = SurfaceAsset(MitsubaScene("merged", content, cameras), 48)
    assert len(asset.shapes()) == 1
    for points in (asset.sites(), asset.measure_points(64, 1, 0)):
        p, n = points.position, points.normal
        floor, wall = p[:, 1] < 1e-4, p[:, 2] < -1 + 1e-4
        assert bool((n[floor, 1] > 0.99).all()) and bool((n[wall, 2] > 0.99).all())
        out = ((p - torch.tensor([0.0, 0.3, 0.0])) * n).sum(1)[~floor & ~wall]
        assert min(int(floor.sum()), int(wall.sum()), len(out)) > 5 and bool((out > 0).all())


def test_triangles_come_in_the_same_order_every_time():
    """An atlas is kept by triangle, and poses share it."""
    transform = mitsuba().ScalarTransform4f

    class Room(Corner):  # shapes as dicts: Mitsuba gathers those of one material, in any order
        def description(self):
            return {
                f"wall{i}": {
                    "type": "rectangle",
                    "to_world": transform().translate([i % 4, 0, i // 4]).scale(0.1),
                    "bsdf": twosided(diffuse((0.1 * (i % 8), 0.5, 0.5))),
                }
                for i in range(16)
            }

    first = SurfaceAsset(Room(), 32).mesh()
    for _ in range(4):
        again = SurfaceAsset(Room(), 32).mesh()
        assert torch.equal(again.position, first.position) and torch.equal(again.face, first.face)


def test_materials_at_points_and_vertices():
    asset = SurfaceAsset(Corner(("wall",)), 32)
    points, mesh = asset.measure_points(64, 1, 0), asset.mesh()
    wall, floor = points.position[:, 2] < -1 + 1e-4, points.position[:, 1] < 1e-4
    for where, name in ((wall & ~floor, "wall"), (~wall & ~floor, "box")):
        assert bool(where.any())
        assert torch.allclose(points.albedo[where], torch.tensor(COLORS[name]), atol=1e-3)
    albedo = asset.vertex_albedo()
    for number, name in enumerate(("floor", "box", "wall")):
        # the base of the box lies in the floor, where a ray meets either
        seen = (mesh.shape == number) & (asset.face_normal()[:, 1] > -0.5)
        vertices = mesh.face[seen].unique()
        assert torch.allclose(albedo[vertices], torch.tensor(COLORS[name]), atol=1e-3)


def test_an_asset_makes_its_parts_once():
    asset = SurfaceAsset(Corner(), 16)
    assert asset.mesh() is asset.mesh(0) is asset.mesh(pose=0) and asset.shapes()[0] is asset.shapes(0)[0]
    other = SurfaceAsset(Corner(), 16)
    assert other.mesh() is not asset.mesh()
    box = asset.load({}).bbox()
    assert list(box.min) == pytest.approx([-1, 0, -1]) and list(box.max) == pytest.approx([1, 1.5, 1])
    assert asset.centre == pytest.approx((0, 0.75, 0)) and asset.half_extents == pytest.approx((1, 0.75, 1))
    assert asset.radius == pytest.approx((1 + 1 + 0.75**2) ** 0.5) and mitsuba() is not None

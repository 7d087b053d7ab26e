"""The Hairball: strands where they should be, lightmap places by arc length, measurement points outside."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf

from prt.bench.compose import compose
from prt.errors import PrtError
from prt.scene import strands as strands_module
from prt.scene.cameras import circular_sweep
from prt.scene.capture import sensor_description
from prt.scene.hair_asset import HULL_OFFSET, TEXELS_PER_STRAND, HairAsset
from prt.scene.hairball import THICKEST, Hairball, absorption
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.strands import Strands

CONF = Path(__file__).parents[2] / "conf" / "scene" / "hairball.yaml"
COUNT = 200
LIGHT = {"lamp": {"type": "point", "position": [3.0, 3.0, 3.0], "intensity": {"type": "rgb", "value": 100.0}}}
KINDS = {
    "bsplinecurve": {},
    "linearcurve": {"curve": "linearcurve", "reflectance": [0.6, 0.4, 0.2]},
}


def hairball(**settings):
    cameras = [circular_sweep([0.0, -0.1, 0.0], 3.0, 20.0, fov=44.0)]
    return Hairball({"train": cameras, "far": cameras}, **{"strands": COUNT, **settings})


@pytest.fixture(scope="module", params=KINDS)
def asset(request) -> HairAsset:
    return hairball(**KINDS[request.param]).asset()


@pytest.fixture(scope="module")
def seen(asset):
    return asset.capture(asset.load({}), asset.scene.views("far", 3, 128)[0])


def everywhere(strands: Strands, per_segment: int):
    """Strand, segment and t of places along all strands."""
    t = (torch.arange(per_segment) + 0.5) / per_segment
    numbers = torch.arange(len(strands) * strands.segments * per_segment)
    segment = numbers // per_segment
    return segment // strands.segments, segment % strands.segments, t[numbers % per_segment]


def distance(points, others, chunk=2000):
    """From each point to the nearest of others."""
    return torch.cat([torch.cdist(part, others).amin(1) for part in points.split(chunk)])


def curve_at(asset, uv):
    """The strand and the point of its centre line that a place in the lightmap names."""
    height, width = asset.size
    column = uv[:, 0].double() * width
    row = (uv[:, 1].double() * height).long()
    strand = row * asset.strands_per_row + (column / TEXELS_PER_STRAND).long()
    share = (column % TEXELS_PER_STRAND / TEXELS_PER_STRAND).float()
    segment, t = asset.strands.locate(strand, share[:, None])
    return strand, share, asset.strands.at(strand, segment[:, 0], t[:, 0])


# ---- strands


def test_strands_grow_from_the_core_to_their_length(asset):
    scene, strands = asset.scene, asset.strands
    assert strands.control.shape == (COUNT, 19 if strands.curve == "bsplinecurve" else 17, 3)
    every, none = torch.arange(COUNT), torch.zeros(COUNT)
    last = torch.full((COUNT,), strands.segments - 1)
    roots, tips = strands.at(every, none.long(), none), strands.at(every, last, none + 1)
    assert (roots.norm(dim=1) - scene.core).abs().max() < 0.2 * scene.curl + 1e-3
    reach = tips.norm(dim=1)
    assert reach.min() > scene.core + 0.4 * scene.length
    assert reach.max() < scene.core + 1.6 * scene.length
    # all around, and hanging down
    assert roots.mean(0).norm() < 0.05 * scene.core
    assert tips[:, 1].mean() < -0.05


def test_the_renderer_has_the_same_strands(asset):
    """What Mitsuba read from its file is the control points, to the last bit, and its segments are ours."""
    strands = asset.strands
    (shape,) = asset.scene.hair()
    params = mitsuba().traverse(shape)
    points = strands.control.shape[1]
    control = np.array(params["control_points"]).reshape(-1, 4)[: COUNT * points].reshape(COUNT, points, 4)
    assert np.array_equal(control[..., :3], strands.control.numpy())
    assert np.allclose(control[..., 3], strands.radius)
    first = np.array(params["segment_indices"])[: COUNT * strands.segments]
    number = np.arange(len(first))
    expected = number // strands.segments * control.shape[1] + number % strands.segments
    assert np.array_equal(first, expected)


def test_more_strands_fill_the_same_ball_equally_densely():
    few, many = hairball(strands=800), hairball(strands=2400)
    boxes = [scene.asset() for scene in (few, many)]
    assert boxes[0].half_extents == pytest.approx(boxes[1].half_extents, rel=0.05)
    assert few.strands.radius < THICKEST  # where it does not stop growing
    assert len(few.strands) * few.strands.radius == pytest.approx(len(many.strands) * many.strands.radius)
    shares = [
        float(box.capture(box.load({}), box.scene.views("far", 1, 96)[0]).hit.float().mean()) for box in boxes
    ]
    assert shares[0] == pytest.approx(shares[1], abs=0.05)


def test_the_same_settings_give_the_same_strands_and_another_seed_others():
    first, again, other = hairball(), hairball(), hairball(seed=1)
    assert torch.equal(first.strands.control, again.strands.control)
    assert not torch.equal(first.strands.control, other.strands.control)


def test_the_bounding_box_holds_what_is_rendered(asset):
    box = asset.load({}).bbox()
    centre, half = torch.tensor(asset.centre), torch.tensor(asset.half_extents)
    if asset.strands.curve == "linearcurve":
        assert np.allclose((centre - half).numpy(), np.array(box.min), atol=1e-5)
        assert np.allclose((centre + half).numpy(), np.array(box.max), atol=1e-5)
    points = asset.strands.at(*everywhere(asset.strands, 8))
    assert ((points - centre).abs() <= half - 0.99 * asset.strands.radius).all()
    assert asset.radius == pytest.approx(float(half.norm()))


# ---- arc length


def test_arc_length_is_measured_along_the_curve(asset):
    strands = asset.strands
    _, segment, t = everywhere(strands, 200)
    one = segment.numel() // COUNT
    strand = torch.full((one,), 7)
    segment, t = segment[:one], t[:one]
    points = strands.at(strand, segment, t).double()
    length = torch.nn.functional.pad(points.diff(dim=0).norm(dim=1).cumsum(0), (1, 0))
    share = strands.share(strand, segment, t)
    # the sampled stretch is all but its two ends
    fitted = share[0] + length / length[-1] * (share[-1] - share[0])
    assert (share - fitted).abs().max() < 2e-4
    assert share[0] < 1e-3 and share[-1] > 1 - 1e-3


def test_locate_inverts_share(asset):
    strand, segment, t = everywhere(asset.strands, 3)
    share = asset.strands.share(strand, segment, t)
    assert ((share >= 0) & (share <= 1)).all()
    found = asset.strands.locate(strand, share[:, None])
    assert ((found[0][:, 0] + found[1][:, 0]) - (segment + t)).abs().max() < 2e-3
    ends = asset.strands.locate(torch.tensor([0]), torch.tensor([[0.0, 1.0]]))
    assert ends[0].tolist() == [[0, asset.strands.segments - 1]] and ends[1].tolist() == [[0.0, 1.0]]


def test_tangents_are_those_of_the_curve(asset):
    strand, segment, t = everywhere(asset.strands, 1)
    step = 5e-3
    along = asset.strands.at(strand, segment, t + step) - asset.strands.at(strand, segment, t - step)
    along = torch.nn.functional.normalize(along, dim=1)
    assert (along * asset.strands.tangent(strand, segment, t)).sum(1).min() > 0.9999


# ---- what a camera sees


def test_captured_places_are_where_the_ray_hit(asset, seen):
    """The point of the curve that a pixel's uv names is one strand radius from what the pixel sees."""
    strand, share, centre = curve_at(asset, seen.uv)
    radius = asset.strands.radius
    away = (centre - seen.position).norm(dim=1)
    inner = (share > 0.051) & (share < 0.949)  # the half texels at the ends are clamped
    assert inner.sum() > 200
    assert away[inner].max() < 1.01 * radius
    if asset.strands.curve == "bsplinecurve":
        assert away[inner].min() > 0.99 * radius
    assert len(strand.unique()) > COUNT / 4
    end = ~inner
    texel = asset.strands.arc.new_tensor(2.0) / TEXELS_PER_STRAND  # no strand is longer than 2
    assert away[end].max() < 0.5 * texel + radius


def test_captured_places_stay_in_their_strand(asset, seen):
    height, width = asset.size
    column = seen.uv[:, 0].double() * width
    inside = column % TEXELS_PER_STRAND
    assert inside.min() > 0.5 - 1e-3 and inside.max() < TEXELS_PER_STRAND - 0.5 + 1e-3
    row = seen.uv[:, 1].double() * height
    assert (row % 1 - 0.5).abs().max() < 1e-3
    assert bool(asset.covered[row.long() * width + column.long()].all())


def test_a_captured_gbuffer_is_that_of_hair(asset, seen):
    assert len(seen) == int(seen.hit.sum()) == len(seen.uv)
    assert (seen.triangle == -1).all() and (seen.barycentric == 0).all()
    assert (seen.diffuse == 1).all() and (seen.specular == 0).all() and (seen.roughness == 1).all()
    for name in ("normal", "wo", "wr"):
        assert np.allclose(getattr(seen, name).norm(dim=1), 1, atol=1e-5)
    assert (seen.normal * seen.wo).sum(1).min() > -1e-5
    assert np.allclose(
        seen.wr, 2 * (seen.normal * seen.wo).sum(1, keepdim=True) * seen.normal - seen.wo, atol=1e-4
    )
    again = seen.from_tensors(seen.tensors(), seen.view)
    assert torch.equal(again.uv, seen.uv)


def test_a_view_that_sees_nothing_is_an_error(asset):
    away = circular_sweep([0.0, 50.0, 0.0], 3.0)([0.0])[0].resized(8, 8)
    with pytest.raises(PrtError, match="sees nothing"):
        asset.capture(asset.load({}), away)


def test_hair_in_several_shapes_is_the_same(monkeypatch):
    """Many strands are split over shapes, whose segments are each counted from 0."""
    whole = hairball().asset()
    view = whole.scene.views("far", 3, 96)[0]
    expected = whole.capture(whole.load({}), view)
    monkeypatch.setattr(strands_module, "SHAPE_SEGMENTS", 16 * 37)
    split = hairball().asset()
    assert len(split.scene.hair()) == 6
    found = split.capture(split.load({}), view)
    assert torch.equal(found.hit, expected.hit)
    # where two strands cross within rounding either may be in front
    assert ((found.uv - expected.uv).abs().amax(1) < 1e-5).float().mean() > 0.995


def test_the_tip_of_the_last_strand_is_looked_up_in_the_strands():
    """Mitsuba takes the tangent there from one segment further on, which has to exist: it read beyond."""
    mi = mitsuba()
    asset = hairball().asset()
    strands = asset.strands
    last, t = torch.tensor([COUNT - 1]), torch.tensor([0.9999])
    place = last, torch.tensor([strands.segments - 1]), t
    side = torch.linalg.cross(strands.tangent(*place), torch.tensor([[0.3, 0.9, 0.1]]))
    side = torch.nn.functional.normalize(side, dim=1)
    origin = strands.at(*place) + 1.5 * strands.radius * side
    ray = mi.Ray3f(mi.Point3f(origin[0].tolist()), mi.Vector3f((-side[0]).tolist()))
    si = asset.load({}).ray_intersect(ray)
    assert bool(np.array(si.is_valid())[0])
    assert int(np.array(si.prim_index)[0]) == COUNT * strands.segments - 1
    along = np.array(si.sh_frame.t)[:, 0]
    assert abs(float(along @ strands.tangent(*place)[0].numpy())) > 0.99
    assert mi.traverse(asset.scene.hair()[0])["segment_indices"].shape[0] == COUNT * strands.segments + 1


# ---- the lightmap


@pytest.mark.parametrize("strands, size", [(1, (1, 10)), (200, (50, 40)), (100_000, (1000, 1000))])
def test_size(strands, size, monkeypatch):
    scene = hairball()
    monkeypatch.setitem(scene.__dict__, "strands", Strands(torch.zeros(strands, 4, 3), 1.0))
    for texels in (16, 1024):
        asset = scene.asset(texels)
        assert asset.size == size
        assert int(asset.covered.sum()) == TEXELS_PER_STRAND * strands


@pytest.mark.parametrize("per_texel", [1, 8, 13])
def test_sites_spread_over_each_texel(asset, per_texel):
    sites, strands = asset.sites(per_texel=per_texel), asset.strands
    texels = TEXELS_PER_STRAND * COUNT
    assert sites.size == asset.size
    assert torch.equal(sites.texel, torch.arange(texels).repeat_interleave(per_texel))
    assert np.allclose(sites.normal.norm(dim=1), 1.0, atol=1e-5)
    # the middles of per_texel pieces of the texel's arc length
    strand = sites.texel // TEXELS_PER_STRAND
    along = (torch.arange(per_texel) + 0.5) / per_texel
    share = ((sites.texel % TEXELS_PER_STRAND).view(texels, -1) + along).flatten() / TEXELS_PER_STRAND
    segment, t = strands.locate(strand, share[:, None])
    place = strand, segment[:, 0], t[:, 0]
    radial = sites.position - strands.at(*place)
    assert np.allclose(radial, strands.radius * sites.normal, atol=1e-6)
    tangent = strands.tangent(*place)
    assert (sites.normal * tangent).sum(1).abs().max() < 1e-5
    # azimuths of a texel are per_texel equal angles: on a straight piece their normals would cancel
    if per_texel > 1:
        mean = sites.normal.view(texels, per_texel, 3).mean(1).norm(dim=1)
        assert mean.median() < 0.2
    again = asset.sites(per_texel=per_texel)
    assert torch.equal(again.position, sites.position)


def test_sites_face_all_ways(asset):
    """Where each texel has a single place, it is not always the same side of the hair."""
    assert asset.sites(per_texel=1).normal.mean(0).norm() < 0.1


def test_sites_need_a_place(asset):
    with pytest.raises(PrtError, match="per_texel=0"):
        asset.sites(per_texel=0)


def test_rays_towards_sites_hit_them(asset):
    """Light that leaves a site is found by a ray sent at it from just outside."""
    mi = mitsuba()
    sites = asset.sites(per_texel=1)
    step = 0.05 * asset.strands.radius
    origin = (sites.position + step * sites.normal).T.contiguous().numpy()
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f((-sites.normal).T.contiguous().numpy()))
    found = asset.load({}).ray_intersect_preliminary(ray)
    t = np.array(found.t)
    segment = np.array(found.prim_index).astype(np.int64)
    ours = segment // asset.strands.segments == sites.texel.numpy() // TEXELS_PER_STRAND
    near = np.isfinite(t) & (np.abs(t - step) < 0.02 * asset.strands.radius)
    # a few sites lie inside of another strand
    assert (ours & near).mean() > 0.98


def test_texels_as_a_gbuffer(asset):
    points = asset.texel_gbuffer()
    assert len(points) == TEXELS_PER_STRAND * COUNT == int(points.hit.sum())
    height, width = asset.size
    texel = (points.uv[:, 1] * height).long() * width + (points.uv[:, 0] * width).long()
    assert torch.equal(texel, torch.arange(len(points)))
    _, _, centre = curve_at(asset, points.uv)
    assert np.allclose((points.position - centre).norm(dim=1), asset.strands.radius, rtol=0.05)
    assert points.image(points.position).shape == (height, width, 3)


# ---- measurement points


def test_hull_holds_every_strand(asset):
    corners, normal = asset.hull
    points = asset.strands.at(*everywhere(asset.strands, 4))
    height = points @ normal.T - (corners[:, 0] * normal).sum(1)
    assert height.max() < 1e-5
    # wound and turned outwards, and closed: the flux of a constant field through it vanishes
    flat = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((flat * normal).sum(1) > 0).all()
    assert flat.sum(0).norm() < 1e-3 * flat.norm(dim=1).sum()


def test_measurement_points_lie_outside_all_hair(asset):
    points = asset.measure_points(64, 4, seed=3)
    radius = asset.strands.radius
    assert points.position.shape == points.albedo.shape == (256, 3)
    assert (points.albedo == 1).all()
    assert torch.equal(points.group.unique(), torch.arange(64))
    assert np.allclose(points.normal.norm(dim=1), 1.0, atol=1e-5)
    centre_lines = asset.strands.at(*everywhere(asset.strands, 8))
    away = distance(points.position, centre_lines)
    assert away.min() > 0.99 * HULL_OFFSET * radius
    # ... and no hair shadows them: what is above their plane is clear
    mi = mitsuba()
    ray = mi.Ray3f(
        mi.Point3f(points.position.T.contiguous().numpy()), mi.Vector3f(points.normal.T.contiguous().numpy())
    )
    assert not np.array(asset.load({}).ray_test(ray)).any()


def test_flat_hair_has_no_hull():
    scene = hairball()
    flat = torch.rand((5, 6, 3), generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 1.0, 0.0])
    scene.__dict__["strands"] = Strands(flat, 0.01)
    with pytest.raises(PrtError, match="no hull"):
        scene.asset().measure_points(4, 1, 0)


# ---- light


def test_a_render_is_not_black(asset):
    mi = mitsuba()
    assert (
        asset.integrator == "path"
        and asset.stores == "outgoing"
        and asset.poses == 1
        and not asset.filterable
    )
    view = asset.scene.views("far", 3, 48)[0]
    lit = asset.load(LIGHT)
    images = {
        depth: np.array(
            mi.render(
                lit,
                sensor=mi.load_dict(sensor_description(view)),
                integrator=mi.load_dict({"type": asset.integrator, "max_depth": depth}),
                spp=16,
            )
        )
        for depth in (2, 6)
    }
    assert all(np.isfinite(image).all() for image in images.values())
    assert images[2].mean() > 1e-3
    assert images[6].mean() > 1.02 * images[2].mean(), "no light between the hairs"


def test_hair_that_takes_nothing_sends_on_all_that_it_gets():
    from prt.light.local import LightRig
    from prt.trace.rig import LitAsset

    white = hairball(strands=60, eumelanin=0.0, pheomelanin=0.0, max_depth=200).asset()
    lit = LitAsset(white)
    del lit.integrators["direct"]  # which would be taken away from what leaves
    sent = lit.lightmap(LightRig(environment=torch.ones(6, 4, 4, 3)), white.sites(), 32, seed=0)
    assert sent.mean().item() == pytest.approx(1.0, abs=0.02)


def test_scenes_share_one_shape(asset):
    shapes = [asset.load(emitters).shapes() for emitters in ({}, LIGHT)]
    assert len(shapes[0]) == len(shapes[1]) == 1 and shapes[0][0] is shapes[1][0]


def test_scene_loads_by_itself():
    scene = hairball()
    assert len(scene.load().shapes()) == 1
    assert scene.bounds[1][1] > 0.5


# ---- settings


@pytest.mark.parametrize(
    "settings",
    [
        {"strands": 0},
        {"strands": 2.5},
        {"segments": 0},
        {"radius": 0},
        {"core": 0.0},
        {"length": -1},
        {"curl": -0.1},
        {"droop": 2},
        {"eumelanin": -1},
        {"pheomelanin": "red"},
        {"reflectance": [0.5, 0.5]},
        {"reflectance": [0.0, 0.5, 0.5]},
        {"reflectance": "red"},
        {"curve": "linearcurve"},
        {"curve": "nurbs"},
        {"seed": -1},
        {"max_depth": 1},
    ],
    ids=str,
)
def test_wrong_settings_are_refused_in_one_line(settings):
    name = next(iter(settings))
    with pytest.raises(PrtError, match=f"scene.{name}=") as error:
        hairball(**settings)
    assert "\n" not in str(error.value)


def test_fingerprint_knows_every_setting():
    base = hairball().fingerprint()
    for change in (
        {"strands": 201}, {"segments": 9}, {"radius": 1e-3}, {"core": 0.2}, {"length": 0.6}, {"curl": 0.0},
        {"droop": 0.0}, {"eumelanin": 1.0}, {"pheomelanin": 1.0}, {"reflectance": [0.5] * 3}, {"seed": 1},
        {"curve": "linearcurve", "reflectance": [0.5] * 3},
    ):  # fmt: skip
        assert hairball(**change).fingerprint() != base, change
    assert hairball().asset().fingerprint() != hairball(seed=2).asset().fingerprint()
    assert hairball(max_depth=5).fingerprint() == base


def test_absorption_gives_less_colour_for_darker_hair():
    bright, dark = absorption([0.9] * 3)[0], absorption([0.1] * 3)[0]
    assert 0 < bright < dark < 1
    # from equation 9 of Chiang 2016 by hand, for roughness 0.3
    assert dark == pytest.approx((np.log(0.1) / 5.888) ** 2, rel=1e-3)


def test_config_builds_and_its_cameras_see_the_ball():
    config = compose(["scene=hairball", "budget=smoke"]).scene
    scene = instantiate(config)
    assert scene.strand_count == 200 and scene.name == "hairball"
    asset = scene.asset()
    lit = asset.load({})
    for split in ("train", "far"):
        for view in scene.views(split, 4, 32):
            assert len(asset.capture(lit, view)) > 32
    with pytest.raises((PrtError, InstantiationException), match="strands"):
        instantiate(OmegaConf.merge(OmegaConf.create(OmegaConf.to_container(config)), {"strands": 0}))


def test_files_that_cannot_be_written_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(
        strands_module.tempfile, "TemporaryDirectory", lambda: (_ for _ in ()).throw(OSError(28, "No space"))
    )
    with pytest.raises(PrtError, match="cannot write 200 strands"):
        hairball().hair()

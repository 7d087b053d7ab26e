"""Secondary rays in wavelet-neural: which pixels they change, what they need, what is wrong to ask."""

import dataclasses
import types

import pytest
import torch
from mirror_scenes import BELOW, VIEW, MirrorScene, bounced
from test_wavelet_neural import make

from prt.errors import PrtError
from prt.methods.mirrored_training import with_mirrored
from prt.methods.wavelet_mirrors import MirrorCode, Mirrors
from prt.methods.wavelet_shading import WaveletCode
from prt.scene.capture import capture
from prt.trace.record import record

RESOLUTION = 8


def untrained(scene=None, **settings):
    torch.manual_seed(0)
    method = make(**settings)
    method.build(((-2, 0, -1), (2, 2, 2)), RESOLUTION, torch.rand(6 * RESOLUTION**2) + 0.1, "cpu")
    with torch.no_grad():
        method.net.grid.table.normal_()
        for layer in method.net.mlp.layers:
            layer.bias.normal_()
    if scene is not None:
        method.mirrors.use(scene)
    return method


def lighting(seed):
    return torch.rand((6, RESOLUTION, RESOLUTION, 3), generator=torch.Generator().manual_seed(seed)) * 2


@pytest.fixture(scope="module")
def scene():
    return MirrorScene(4)


@pytest.fixture(scope="module")
def gbuffer(scene):
    return capture(scene.load(), VIEW)


def test_only_pixels_of_mirrors_change(scene, gbuffer):
    plain, traced = untrained(), untrained(scene, secondary={"roughness": BELOW})
    is_mirror = gbuffer.roughness[:, 0] < BELOW
    assert 20 < is_mirror.sum() < len(gbuffer) - 20
    without = plain.shade(gbuffer, plain.light(lighting(1)))
    first, again = (traced.shade(gbuffer, traced.light(lighting(1))) for _ in range(2))
    assert torch.equal(first[~is_mirror], without[~is_mirror])
    assert (first[is_mirror] - without[is_mirror]).abs().min(1).values.gt(0).all()
    assert torch.equal(first, again), "equal seeds, equal images"


def test_a_code_keeps_its_lighting(scene, gbuffer):
    method = untrained(scene, secondary={"roughness": BELOW})
    one = method.light(lighting(1))
    expected = method.shade(gbuffer, one)
    other = method.light(lighting(2))
    assert not torch.equal(method.shade(gbuffer, other), expected)
    assert torch.equal(method.shade(gbuffer, one), expected)


def test_points_of_no_view_are_traced_from_where_they_are(scene, gbuffer):
    method = untrained(scene, secondary={"roughness": BELOW, "rays": 64})
    code = method.light(lighting(1))
    points = gbuffer.rows(torch.arange(len(gbuffer)))
    assert points.view is None
    image, same = method.shade(gbuffer, code), method.shade(points, code)
    is_mirror = gbuffer.roughness[:, 0] < BELOW
    assert torch.equal(image[~is_mirror], same[~is_mirror])
    # a pixel's rays start all over it, a point's at the point
    assert same[is_mirror].mean() == pytest.approx(float(image[is_mirror].mean()), rel=0.15)
    lost = dataclasses.replace(points, position=points.position + 0.3)
    assert torch.equal(method.shade(lost, code), untrained().shade(lost, code)), "no surface is there"


def test_with_an_ideal_network_a_mirror_is_the_reference(scene, gbuffer):
    """``mended`` with the renderer's indirect light for the network's."""
    mirrors = Mirrors({"roughness": BELOW, "rays": 64})
    mirrors.use(scene)
    code = mirrors.coded(WaveletCode(*[torch.zeros(0)] * 4, None), lighting(3))
    values = torch.full((len(gbuffer), 3), -1.0)
    points = gbuffer.rows(torch.arange(len(gbuffer)))
    image = mirrors.mended(values, points, code, lambda at: bounced(mirrors.mi_scene, at, 3, 32, 1))
    is_mirror = points.roughness[:, 0] < BELOW
    truth = bounced(mirrors.mi_scene, points, 4, 2000, 2)
    assert (image[~is_mirror] == -1).all()
    assert (image - truth)[is_mirror].norm() / truth[is_mirror].norm() < 0.1
    assert image[is_mirror].mean() == pytest.approx(float(truth[is_mirror].mean()), rel=0.03)


def test_off_needs_no_scene_and_keeps_nothing(gbuffer):
    method = untrained()
    code = method.light(lighting(1))
    assert not isinstance(code, MirrorCode)
    assert method.timed_parts(lighting(1), gbuffer) == {}


def test_rays_and_network_are_timed_apart(scene, gbuffer):
    method = untrained(scene, secondary={"roughness": BELOW})
    parts = method.timed_parts(lighting(1), gbuffer)
    assert list(parts) == ["trace", "network"]
    for part in parts.values():
        part()


def test_a_view_without_mirrors(scene, gbuffer):
    method = untrained(scene, secondary={"roughness": 0.01})
    parts = method.timed_parts(lighting(1), gbuffer)
    parts["trace"]()
    parts["network"]()
    plain = untrained()
    shaded = method.shade(gbuffer, method.light(lighting(1)))
    assert torch.equal(shaded, plain.shade(gbuffer, plain.light(lighting(1))))


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"roughnes": 0.1}, "secondary.roughnes is no setting"),
        ({"roughness": 1.5}, "secondary.roughness=1.5"),
        ({"roughness": True}, "secondary.roughness=True"),
        ({"roughness": float("nan")}, "secondary.roughness=nan"),
        ({"rays": 0}, "secondary.rays=0"),
        ({"rays": 2.5}, "secondary.rays=2.5"),
        ({"light_samples": -1}, "secondary.light_samples=-1"),
        ({"bounces": 5000}, "secondary.bounces=5000"),
    ],
)
def test_wrong_settings_are_refused(settings, named):
    with pytest.raises(PrtError, match=named):
        make(secondary=settings)


def test_wrong_training_on_mirrors_is_refused():
    with pytest.raises(PrtError, match=r"method\.mirrored=-0\.1"):
        make(mirrored=-0.1)
    with pytest.raises(PrtError, match="does not go with method.training.lightings_per_view"):
        make(mirrored=0.1, training={"lightings_per_view": 2})


def test_rays_without_a_scene_are_refused():
    with pytest.raises(PrtError, match=r"secondary\.roughness=0\.15 traces rays and needs a scene"):
        untrained(secondary={"roughness": BELOW}).light(lighting(1))


def test_codes_of_another_setting_are_refused(scene, gbuffer):
    code = untrained().light(lighting(1))
    with pytest.raises(PrtError, match="call light"):
        untrained(scene, secondary={"roughness": BELOW}).shade(gbuffer, code)


def test_what_is_seen_in_a_mirror_is_taught_as_it_is():
    """The rows that are added are the indirect transport of the places that the mirror shows."""
    scene = MirrorScene(5, sigma=0.02)
    mi_scene = scene.load()
    view = dataclasses.replace(VIEW, width=24, height=24)
    gbuffer = capture(mi_scene, view)
    transport = record(mi_scene, view, 2048, 5, RESOLUTION, 1).component("indirect")
    transport = transport.rows(gbuffer.hit.nonzero()[:, 0])
    data = Data(
        gbuffer,
        transport,
        torch.zeros(len(gbuffer), dtype=torch.long),
        {"specular": torch.rand(len(gbuffer)), "view_variance": torch.rand(len(gbuffer))},
    )
    more = with_mirrored(data, mi_scene, BELOW)
    added = len(more.gbuffer) - len(gbuffer)
    assert 10 < added <= (gbuffer.roughness[:, 0] < BELOW).sum()
    assert (
        more.transport.pixels == len(more.point_view) == len(more.importance["specular"]) == len(more.gbuffer)
    )
    assert torch.equal(more.gbuffer.position[: len(gbuffer)], gbuffer.position)
    assert torch.equal(more.transport.weight[: len(transport.weight)], transport.weight)

    points = more.gbuffer.rows(torch.arange(len(gbuffer), len(more.gbuffer)))
    assert (points.roughness >= BELOW).all() and (points.position[:, 1] > 0).all()
    light = lighting(1)
    mirrors = Mirrors({"roughness": BELOW})
    mirrors.use(scene)
    mirrors.show(light)
    truth = bounced(mirrors.mi_scene, points, 4, 1000, 3)
    ours = more.transport.relight(light.reshape(1, -1, 3))[0, len(gbuffer) :]
    assert ours.mean() == pytest.approx(float(truth.mean()), rel=0.05)
    # pixels at edges show two surfaces, as those of a camera do
    assert (ours - truth).norm(dim=1).median() / truth.norm(dim=1).median() < 0.15


def test_without_mirrors_nothing_is_added(gbuffer):
    data = types.SimpleNamespace(gbuffer=gbuffer)
    assert with_mirrored(data, None, 0.01) is data


@dataclasses.dataclass
class Data:
    gbuffer: object
    transport: object
    point_view: torch.Tensor
    importance: dict

import math

import pytest
import torch

from prt.light import cubemap as cm


def energy(cubemap):
    return (cubemap.double() * cm.texel_solid_angles(cubemap.shape[1], torch.float64)[..., None]).sum(
        (0, 1, 2)
    )


def equirect_energy(image):
    return (image.double() * cm.equirect_solid_angles(*image.shape[:2], torch.float64)[..., None]).sum((0, 1))


def test_face_layout_is_the_documented_one():
    R = 8
    d = cm.texel_directions(R)
    i, j = 2, 5
    u, v = 2 * (j + 0.5) / R - 1, 2 * (i + 0.5) / R - 1
    expected = [(1, -v, -u), (-1, -v, u), (u, 1, v), (u, -1, -v), (u, -v, 1), (-u, -v, -1)]
    for face, direction in enumerate(expected):
        direction = torch.tensor(direction)
        torch.testing.assert_close(d[face, i, j], direction / direction.norm())


@pytest.mark.parametrize("R", [1, 2, 16, 33])
def test_directions_find_their_own_texel(R):
    d = cm.texel_directions(R).reshape(-1, 3)
    assert torch.equal(cm.direction_to_texel(d * 7.5, R), torch.arange(6 * R * R))


def test_solid_angles_are_exact():
    R = 16
    angles = cm.texel_solid_angles(R, torch.float64)
    assert angles.sum().item() == pytest.approx(4 * math.pi, rel=1e-12)
    # against a fine midpoint rule: (2/n)^2 / (1 + u^2 + v^2)^(3/2)
    n = 16 * R
    c = 2 * (torch.arange(n, dtype=torch.float64) + 0.5) / n - 1
    fine = (2 / n) ** 2 / (1 + c[:, None] ** 2 + c[None, :] ** 2) ** 1.5
    coarse = fine.reshape(R, 16, R, 16).sum((1, 3))
    torch.testing.assert_close(angles[3], coarse, rtol=1e-4, atol=0)


def test_lookup_is_piecewise_constant():
    R = 4
    cubemap = torch.rand((6, R, R, 3), generator=torch.Generator().manual_seed(0))
    fine = cm.texel_directions(R * 4).reshape(-1, 3)
    seen = cm.lookup(cubemap, fine).reshape(6, R, 4, R, 4, 3)
    assert torch.equal(seen, cubemap[:, :, None, :, None].expand_as(seen))


@pytest.mark.parametrize("size", [(32, 64), (33, 47), (256, 512)])
def test_one_pixel_sun_keeps_its_energy(size):
    image = torch.full((*size, 3), 0.2)
    image[size[0] // 3, size[1] // 5] = 3.6e5
    out = cm.from_equirect(image, 8)
    torch.testing.assert_close(energy(out), equirect_energy(image), rtol=1e-5, atol=0)


def test_constant_image_stays_constant():
    out = cm.from_equirect(torch.full((64, 128, 3), 2.0), 16)
    assert (out / 2 - 1).abs().max() < 0.05 and (out / 2 - 1).abs().mean() < 2e-3


def test_large_images_are_halved_without_losing_energy():
    image = torch.rand((256, 512, 3), generator=torch.Generator().manual_seed(1)) ** 8 * 100
    out = cm.from_equirect(image, 8)
    assert 512 >= 32 * 8
    torch.testing.assert_close(energy(out), equirect_energy(image), rtol=1e-5, atol=0)


def test_equirect_features_lie_where_their_directions_say():
    H, W, R = 64, 128, 16
    d = cm.equirect_directions(H, W)
    out = cm.from_equirect(d + 2.0, R)
    torch.testing.assert_close(out, cm.texel_directions(R) + 2.0, atol=0.03, rtol=0)


@pytest.mark.parametrize("size", [(1, 1), (4, 8)])
def test_an_image_coarser_than_the_cubemap(size):
    image = torch.rand((*size, 3), generator=torch.Generator().manual_seed(4))
    torch.testing.assert_close(energy(cm.from_equirect(image, 16)), equirect_energy(image), rtol=1e-5, atol=0)


def test_rotation_by_right_angle_is_exact_and_goes_the_documented_way():
    R = 8
    cubemap = torch.rand((6, R, R, 3), generator=torch.Generator().manual_seed(2))
    turned = cm.rotate(cubemap, cm.yaw(90))
    d = cm.texel_directions(R)
    expected = cm.lookup(cubemap, (d @ cm.yaw(90).float()).reshape(-1, 3)).reshape(cubemap.shape)
    torch.testing.assert_close(turned, expected, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(
        cm.yaw(90) @ torch.tensor([0.0, 0, 1]).double(), torch.tensor([1.0, 0, 0]).double()
    )


@pytest.mark.parametrize("degrees", [37.0, 120.0, 240.0])
def test_rotation_keeps_energy_and_constants(degrees):
    R = 16
    cubemap = torch.full((6, R, R, 3), 0.1)
    cubemap[4, 3, 3] = 1e6
    turned = cm.rotate(cubemap, cm.yaw(degrees))
    torch.testing.assert_close(energy(turned), energy(cubemap), rtol=1e-5, atol=0)
    flat = cm.rotate(torch.ones((6, R, R, 3)), cm.yaw(degrees))
    assert (flat - 1).abs().max() < 0.01 and (flat - 1).abs().mean() < 1e-3


def test_three_turns_of_120_degrees_come_back_blurred_but_in_place():
    R = 16
    smooth = cm.texel_directions(R) + 1.5
    out = smooth
    for _ in range(3):
        out = cm.rotate(out, cm.yaw(120))
    torch.testing.assert_close(out, smooth, atol=0.08, rtol=0)


def test_mirror_swaps_the_x_faces():
    R = 4
    cubemap = torch.rand((6, R, R, 3), generator=torch.Generator().manual_seed(3))
    out = cm.mirror(cubemap)
    assert torch.equal(cm.mirror(out), cubemap)
    assert torch.equal(out[0], cubemap[1].flip(1))


def test_mean_radiance_is_weighted_by_solid_angle():
    R = 4
    batch = torch.stack([torch.full((6, R, R, 3), 3.0), torch.zeros((6, R, R, 3))])
    batch[1, 0] = 6.0
    torch.testing.assert_close(cm.mean_radiance(batch), torch.tensor([[3.0] * 3, [1.0] * 3]))


def test_orientation_matches_mitsubas_envmap():
    from prt.scene.mitsuba_setup import mitsuba

    mi = mitsuba()
    if "scalar" in mi.variant():
        pytest.skip("needs a vectorised Mitsuba variant")
    H, W, R = 64, 128, 8
    image = cm.equirect_directions(H, W) + 2.0
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(image.numpy())})
    d = cm.texel_directions(R).reshape(-1, 3)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*(-d.T).numpy())
    seen = torch.tensor(emitter.eval(si).numpy().T)
    ours = cm.from_equirect(image, R).reshape(-1, 3)
    # a texel is 11 degrees wide and a feature moved by half of one would differ by 0.1
    torch.testing.assert_close(ours, seen, atol=0.15, rtol=0)
    assert (ours - seen).abs().mean() < 0.03

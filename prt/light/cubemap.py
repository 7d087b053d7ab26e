"""Cubemaps of radiance: ``(6, R, R, 3)``, linear RGB, constant within a texel (docs/architecture.md).

Faces +x, -x, +y, -y, +z, -z in the OpenGL layout. Whatever turns another map into a cubemap does it through a
sparse overlap matrix: entry (t, p) is the solid angle, in steradians, that target texel t shares with source
pixel p. The matrix is balanced so that its columns add up to the pixels' solid angles (energy is kept, even
of a sun in one pixel) and its rows, within the sampling's error, to the texels' (a constant map stays so).
"""

import functools
import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

#: per face the images of (1, u, v): direction = axes[0] + u axes[1] + v axes[2]
_AXES = torch.tensor(
    [
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
        [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
        [[0, 0, -1], [-1, 0, 0], [0, -1, 0]],
    ],
    dtype=torch.float32,
)
#: sub-pixels across a texel that overlap matrices are estimated from
_SAMPLES_ACROSS = 6
#: rounds of balancing an overlap matrix
_BALANCING_ROUNDS = 60


def face_directions(
    face: Int[Tensor, "*B"], u: Float[Tensor, "*B"], v: Float[Tensor, "*B"]
) -> Float[Tensor, "*B 3"]:
    """Unit directions of places (u, v) in [-1, 1]^2 on faces."""
    axes = _AXES.to(u)[face]
    direction = axes[..., 0, :] + u[..., None] * axes[..., 1, :] + v[..., None] * axes[..., 2, :]
    return direction / direction.norm(dim=-1, keepdim=True)


def texel_directions(R: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "6 R R 3"]:
    """Unit directions of the texel centres."""
    centre = 2 * (torch.arange(R, dtype=dtype) + 0.5) / R - 1
    face = torch.arange(6)[:, None, None].expand(6, R, R)
    return face_directions(face, centre[None, None, :].expand(6, R, R), centre[None, :, None].expand(6, R, R))


def texel_solid_angles(R: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "6 R R"]:
    """Exact solid angles of the texels, in steradians; their sum is 4 pi."""
    edge = 2 * torch.arange(R + 1, dtype=torch.float64) / R - 1
    x, y = edge[:, None], edge[None, :]
    # solid angle of the rectangle from the face's centre to (x, y)
    corner = torch.atan2(x * y, torch.sqrt(x * x + y * y + 1))
    angle = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    return angle.to(dtype).expand(6, R, R).contiguous()


def direction_to_face(
    d: Float[Tensor, "N 3"],
) -> tuple[Int[Tensor, "N"], Float[Tensor, "N"], Float[Tensor, "N"]]:
    """Face of each direction (of any length), and where it meets the face: u and v in [-1, 1]."""
    size = d.abs()
    # explicit comparisons, not argmax: ties on an edge go to the first of x, y, z on every device
    on_x = (size[..., 0] >= size[..., 1]) & (size[..., 0] >= size[..., 2])
    axis = torch.where(on_x, 0, torch.where(size[..., 1] >= size[..., 2], 1, 2))
    major = d.gather(-1, axis[..., None])[..., 0]
    face = 2 * axis + (major < 0)
    axes = _AXES.to(d)[face]
    scale = major.abs().clamp_min(torch.finfo(d.dtype).tiny)
    u = (d * axes[..., 1, :]).sum(-1) / scale
    v = (d * axes[..., 2, :]).sum(-1) / scale
    return face, u, v


def direction_to_texel(d: Float[Tensor, "N 3"], R: int) -> Int[Tensor, "N"]:
    """Flat index ``(face * R + row) * R + column`` of the texel each direction (of any length) falls in."""
    face, u, v = direction_to_face(d)
    column = ((u + 1) * (0.5 * R)).floor().long().clamp(0, R - 1)
    row = ((v + 1) * (0.5 * R)).floor().long().clamp(0, R - 1)
    return (face * R + row) * R + column


def lookup(cubemap: Float[Tensor, "6 R R C"], d: Float[Tensor, "N 3"]) -> Float[Tensor, "N C"]:
    """Radiance in directions ``d``: the value of the texel, no interpolation."""
    flat = cubemap.reshape(-1, cubemap.shape[-1])
    return flat[direction_to_texel(d, cubemap.shape[1])]


def mean_radiance(cubemap: Float[Tensor, "*B 6 R R C"]) -> Float[Tensor, "*B C"]:
    """Mean over the sphere, weighted by solid angle."""
    weight = texel_solid_angles(cubemap.shape[-2], torch.float64).to(cubemap.device) / (4 * math.pi)
    return (cubemap.double() * weight[..., None]).sum((-4, -3, -2)).to(cubemap.dtype)


def equirect_directions(H: int, W: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "H W 3"]:
    """Directions of the pixel centres of an equirectangular image.

    Mitsuba's ``envmap`` without ``to_world``: the top row is +y; u = 0 (the left edge) looks to -z,
    u = 1/4 to +x, u = 1/2 to +z.
    """
    theta = (torch.arange(H, dtype=dtype) + 0.5) * (math.pi / H)
    phi = (torch.arange(W, dtype=dtype) + 0.5) * (2 * math.pi / W)
    theta, phi = theta[:, None].expand(H, W), phi[None, :].expand(H, W)
    return torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], -1)


def equirect_solid_angles(H: int, W: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "H W"]:
    """Exact solid angles of the pixels of an equirectangular image; their sum is 4 pi."""
    edge = torch.cos(torch.arange(H + 1, dtype=torch.float64) * (math.pi / H))
    return ((edge[:-1] - edge[1:]) * (2 * math.pi / W))[:, None].expand(H, W).to(dtype).contiguous()


def from_equirect(
    image: Float[Tensor, "H W 3"], R: int, supersample: int | None = None
) -> Float[Tensor, "6 R R 3"]:
    """The cubemap of an equirectangular image, energy kept (the sum of radiance times solid angle).

    Args:
        image: linear radiance; orientation as in :func:`equirect_directions`.
        supersample: parts along each side of a pixel; by default enough for 6 across the smallest texel, and
            images with far more pixels than texels are first halved (also keeping energy).
    """
    image = image.double()
    while supersample is None and image.shape[1] >= 32 * R and not (image.shape[0] % 2 or image.shape[1] % 2):
        image = _halve(image)
    H, W = image.shape[:2]
    finest = max(2 * math.pi / W, math.pi / H)
    step = supersample or max(1, math.ceil(_SAMPLES_ACROSS * finest * R / 0.877))
    return _apply(_equirect_overlap(H, W, R, step), image.reshape(H * W, 3), R)


def rotate(cubemap: Float[Tensor, "6 R R 3"], matrix: Float[Tensor, "3 3"]) -> Float[Tensor, "6 R R 3"]:
    """The environment turned by a rotation: light from d then comes from ``matrix @ d``. Energy is kept."""
    R = cubemap.shape[1]
    key = tuple(float(x) for x in matrix.double().reshape(-1))
    return _apply(_rotation_overlap(key, R), cubemap.reshape(-1, 3).double(), R)


def yaw(degrees: float) -> Float[Tensor, "3 3"]:
    """Rotation about +y, counter-clockwise seen from above: 90 degrees takes +z to +x."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return torch.tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]], dtype=torch.float64)


def mirror(cubemap: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
    """The environment reflected in the plane x = 0."""
    R = cubemap.shape[1]
    flipped = texel_directions(R) * torch.tensor([-1.0, 1.0, 1.0])
    return lookup(cubemap, flipped.reshape(-1, 3)).reshape(cubemap.shape)


def _halve(image: Float[Tensor, "H W 3"]) -> Float[Tensor, "H2 W2 3"]:
    H, W = image.shape[:2]
    weight = equirect_solid_angles(H, W, torch.float64)[..., None]
    blocks = (image * weight).reshape(H // 2, 2, W // 2, 2, 3).sum((1, 3))
    return blocks / weight.reshape(H // 2, 2, W // 2, 2, 1).sum((1, 3))


#: non-zero entries of an overlap matrix: target texels, source pixels, shared solid angles
Overlap = tuple[Tensor, Tensor, Tensor]


def _apply(overlap: Overlap, radiance: Float[Tensor, "P 3"], R: int) -> Float[Tensor, "6 R R 3"]:
    texel, pixel, angle = overlap
    energy = torch.zeros((6 * R * R, 3), dtype=torch.float64)
    energy.index_add_(0, texel, angle[:, None] * radiance.cpu()[pixel])
    energy = energy.reshape(6, R, R, 3) / texel_solid_angles(R, torch.float64)[..., None]
    return energy.to(torch.float32).to(radiance.device)


@functools.lru_cache(maxsize=4)
def _equirect_overlap(H: int, W: int, R: int, step: int) -> Overlap:
    """Overlap of texels and equirectangular pixels, from ``step`` x ``step`` parts of every pixel."""
    directions = equirect_directions(H * step, W * step, torch.float64).reshape(-1, 3)
    angle = equirect_solid_angles(H * step, W * step, torch.float64).reshape(-1)
    row, column = torch.arange(H * step) // step, torch.arange(W * step) // step
    pixel = (row[:, None] * W + column[None, :]).reshape(-1)
    from_pixels = direction_to_texel(directions, R), pixel, angle
    d, texel, angle = _texel_parts(R)
    row = (torch.acos(d[:, 1].clamp(-1, 1)) * (H / math.pi)).long().clamp(0, H - 1)
    column = (torch.atan2(d[:, 0], -d[:, 2]) * (W / (2 * math.pi))).floor().long() % W
    from_texels = texel, row * W + column, angle
    return _overlap(from_pixels, from_texels, R, equirect_solid_angles(H, W, torch.float64).reshape(-1))


@functools.lru_cache(maxsize=8)
def _rotation_overlap(matrix: tuple[float, ...], R: int) -> Overlap:
    """Overlap of texels and rotated texels."""
    turn = torch.tensor(matrix, dtype=torch.float64).reshape(3, 3)
    d, texel, angle = _texel_parts(R)
    forth = direction_to_texel(d @ turn.T, R), texel, angle
    back = texel, direction_to_texel(d @ turn, R), angle
    return _overlap(forth, back, R, texel_solid_angles(R, torch.float64).reshape(-1))


def _texel_parts(R: int) -> tuple[Tensor, Tensor, Tensor]:
    """Directions, flat texel indices and solid angles of the parts of all texels."""
    fine = R * _SAMPLES_ACROSS
    place = torch.arange(fine) // _SAMPLES_ACROSS
    texel = (torch.arange(6)[:, None, None] * R + place[None, :, None]) * R + place[None, None, :]
    angle = texel_solid_angles(fine, torch.float64)
    return texel_directions(fine, torch.float64).reshape(-1, 3), texel.reshape(-1), angle.reshape(-1)


def _overlap(from_pixels: Overlap, from_texels: Overlap, R: int, pixel_sums: Tensor) -> Overlap:
    """The balanced mean of two estimates: where parts of pixels fall, and where parts of texels come from."""
    P = pixel_sums.numel()
    texel, pixel, angle = (torch.cat(both) for both in zip(from_pixels, from_texels, strict=True))
    pairs, which = torch.unique(texel * P + pixel, return_inverse=True)
    texel, pixel = pairs // P, pairs % P
    value = torch.bincount(which, 0.5 * angle, pairs.numel())
    texel_sums = texel_solid_angles(R, torch.float64).reshape(-1)
    return texel, pixel, _balance(texel, pixel, value, texel_sums, pixel_sums)


def _balance(
    texel: Tensor, pixel: Tensor, value: Tensor, texel_sums: Tensor, pixel_sums: Tensor
) -> Float[Tensor, "E"]:
    """``value`` scaled per texel and per pixel, in turn, towards the sums given; the pixels' hold exactly.

    Where sampling missed the slivers that link a texel to its neighbours' pixels not all sums can hold; those
    texels' stay wrong by the error of the sampling (a few per cent), and no energy is lost.
    """
    for _ in range(_BALANCING_ROUNDS):
        rows = torch.bincount(texel, value, texel_sums.numel())
        value = value * (texel_sums / rows)[texel]
        value = value * (pixel_sums / torch.bincount(pixel, value, pixel_sums.numel()))[pixel]
    return value

"""Shadowed direct light of an environment, ray-traced: no harmonics, nothing stored.

Diffuse and Phong materials as in :mod:`prt.trace.sh_shading`, sampled by the material and by the
environment's texels, combined by the balance heuristic (Veach 1997).
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.light.cubemap import direction_to_texel, face_directions, texel_solid_angles
from prt.scene.frames import perpendicular
from prt.scene.lightmap_points import OFFSET
from prt.trace.surface import Surface, shadowed

#: rays traced at a time; bounds the memory
RAYS = 1 << 20


def direct_light(
    surface: Surface,
    position: Float[Tensor, "N 3"],
    normal: Float[Tensor, "N 3"],
    reflected: Float[Tensor, "N 3"],
    diffuse: Float[Tensor, "N 3"],
    specular: Float[Tensor, "N 3"],
    exponent: Float[Tensor, "N"],
    lighting: Float[Tensor, "6 R R 3"],
    samples: int,
    seed: int,
) -> Float[Tensor, "N 3"]:
    """Linear radiance of points.

    Args:
        reflected: the viewing direction mirrored about the normal.
        diffuse, specular: reflectances; the Phong lobe is ``(s + 2) / (2 pi) cos^s``.
        samples: directions a point, half of them chosen by the material, half by the light.
        seed: equal seeds draw equal directions.
    """
    generator = torch.Generator().manual_seed(seed)
    light = _Texels(lighting)
    half = max(samples // 2, 1)
    out = []
    for rows in torch.arange(len(position)).split(max(RAYS // (2 * half), 1)):
        many = rows.repeat_interleave(2 * half)
        by_light = (torch.arange(2 * half) < half).repeat(len(rows))
        n, r, s = normal[many], reflected[many], exponent[many]
        gloss = specular[many].sum(1) / (specular[many] + diffuse[many]).sum(1).clamp_min(1e-12)
        d = torch.empty_like(n)
        d[by_light] = light.draw(int(by_light.sum()), generator)
        d[~by_light] = _by_material(n[~by_light], r[~by_light], s[~by_light], gloss[~by_light], generator)
        cosine = (d * n).sum(1).clamp_min(0)
        lobe = (s + 1) / (2 * math.pi) * (d * r).sum(1).clamp_min(0) ** s
        pdf = 0.5 * light.pdf(d) + 0.5 * ((1 - gloss) * cosine / math.pi + gloss * lobe)
        used = (cosine > 0) & (pdf > 0)
        origin = position[many] + OFFSET * surface.extent * n
        free = torch.zeros_like(used)
        free[used] = ~shadowed(surface, origin[used], d[used])
        phong = (lobe * (s + 2) / (s + 1))[:, None]
        value = (diffuse[many] / math.pi + specular[many] * phong) * cosine[:, None] * light.radiance(d)
        value = torch.where(free[:, None], value / pdf.clamp_min(1e-30)[:, None], 0.0)
        out.append(value.view(len(rows), 2 * half, 3).mean(1))
    return torch.cat([torch.zeros((0, 3)), *out])


def _by_material(
    normal: Tensor, reflected: Tensor, exponent: Tensor, gloss: Tensor, generator: torch.Generator
) -> Float[Tensor, "N 3"]:
    """Directions in proportion to the cosine about the normal, or to the lobe about the reflected one."""
    u = torch.rand((3, len(normal)), generator=generator)
    glossy = u[2] < gloss
    axis = torch.where(glossy[:, None], reflected, normal)
    height = (1 - u[0]) ** torch.where(glossy, 1 / (exponent + 1), 0.5)
    ring = (1 - height**2).clamp_min(0).sqrt()
    tangent, other = perpendicular(axis)
    x, y = ring * (2 * math.pi * u[1]).cos(), ring * (2 * math.pi * u[1]).sin()
    return x[:, None] * tangent + y[:, None] * other + height[:, None] * axis


class _Texels:
    """Directions in proportion to the brightness of an environment's texels, even on the face within."""

    def __init__(self, lighting: Float[Tensor, "6 R R 3"]):
        self.flat, self.R = lighting.reshape(-1, 3), lighting.shape[1]
        self.area = texel_solid_angles(self.R).flatten()
        power = self.flat.sum(1).clamp_min(0) * self.area
        # every texel may be drawn: a black environment too has directions
        power = power + 0.05 * power.mean() + 1e-12
        self.share = power / power.sum()
        self.steps = self.share.double().cumsum(0)

    def draw(self, count: int, generator: torch.Generator) -> Float[Tensor, "N 3"]:
        uniform = torch.rand(count, generator=generator, dtype=torch.float64) * self.steps[-1]
        texel = torch.searchsorted(self.steps, uniform).clamp(max=len(self.steps) - 1)
        inside = torch.rand((2, count), generator=generator)
        return self._place(texel, inside)

    def _place(self, texel: Int[Tensor, "N"], inside: Float[Tensor, "2 N"]) -> Float[Tensor, "N 3"]:
        column, row, face = texel % self.R, texel // self.R % self.R, texel // self.R**2
        u, v = 2 * (column + inside[0]) / self.R - 1, 2 * (row + inside[1]) / self.R - 1
        return face_directions(face, u, v)

    def pdf(self, d: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
        """Per steradian. Places are even on the face, so the density has the face's own Jacobian."""
        texel = direction_to_texel(d, self.R)
        # dw = 4 / R^2 du dv / (1 + u^2 + v^2)^(3/2); the largest component of a unit vector is that root
        jacobian = d.abs().amax(1) ** 3 * 4 / self.R**2
        return self.share[texel] / jacobian

    def radiance(self, d: Float[Tensor, "N 3"]) -> Float[Tensor, "N 3"]:
        return self.flat[direction_to_texel(d, self.R)]

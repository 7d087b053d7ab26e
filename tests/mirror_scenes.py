"""A small scene with a near-mirror, and the renderer's own indirect light at any point of it."""

import numpy as np
import torch

from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.trace.reference import component_integrators

#: surfaces of a lower sigma are mirrors
BELOW = 0.15
VIEW = View((0.6, 1.6, 3.0), (0.0, 0.3, 0.0), fov=40.0, width=12, height=12)


def twosided(bsdf):
    return {"type": "twosided", "bsdf": bsdf}


def diffuse(value):
    return twosided({"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}})


def metal(sigma):
    return twosided({"type": "roughconductor", "distribution": "ggx", "material": "Ag", "alpha": sigma**2})


def floor(bsdf):
    to_world = mitsuba().ScalarTransform4f().rotate([1, 0, 0], -90).scale(1.5)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def box(bsdf, at, half):
    return {"type": "cube", "to_world": mitsuba().ScalarTransform4f().translate(at).scale(half), "bsdf": bsdf}


class MirrorScene(Scene):
    """A near-mirror floor, and above it a box, diffuse by default, before a glossy wall."""

    def __init__(self, max_depth=4, sigma=0.05, above=None, others=()):
        super().__init__("mirror", {"train": [lambda places: []], "far": [lambda places: []]}, max_depth)
        self.sigma, self.above, self.others = sigma, above, dict(others)

    def description(self):
        colour = {"type": "rgb", "value": [0.5, 0.6, 0.3]}
        at_back = mitsuba().ScalarTransform4f().translate([0, 1, -1]).scale([1.5, 1, 1])
        glossy = twosided({"type": "principled", "base_color": colour, "roughness": 0.4})
        return {
            "floor": floor(metal(self.sigma)),
            "box": box(self.above or diffuse(0.7), [0.1, 0.75, 0.1], 0.35),
            "wall": {"type": "rectangle", "to_world": at_back, "bsdf": glossy},
            **self.others,
        }

    def fingerprint(self):
        return {"scene": "mirror"}


def bounced(mi_scene, points: GBuffer, max_depth: int, samples: int, seed: int) -> torch.Tensor:
    """Indirect radiance of points by the renderer's path integrator: rays that start just before them."""
    import drjit as dr

    mi = mitsuba()
    count = len(points) * samples
    row = dr.arange(mi.UInt32, count) // samples
    origin, d = points.position + 2e-3 * points.wo, -points.wo

    def spread(kind, rows):
        return dr.gather(kind, kind(np.ascontiguousarray(rows.numpy().T)), row)

    ray = mi.RayDifferential3f(mi.Ray3f(spread(mi.Point3f, origin), spread(mi.Vector3f, d)))
    light = {}
    for name, integrator in component_integrators(max_depth).items():
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, count)
        value, _, _ = integrator.sample(mi_scene, sampler, ray, None, True)
        light[name] = torch.from_numpy(np.array(value).T.copy()).view(len(points), samples, 3).mean(1)
    return light["full"] - light["direct"]

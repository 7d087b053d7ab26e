"""An asset under changing light rigs: lightmaps, camera images and shadows, all from one loaded scene."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prt.light.local import LightRig
from prt.scene.lightmap_points import OFFSET, Sites
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View
from prt.trace.cubemap_emitter import checked, emitter_class
from prt.trace.reference import COMPONENTS, component_integrators, render_components
from prt.trace.rig_emitter import rig_emitter_class

#: Rays traced at a time: bounds the memory.
WAVEFRONT = 1 << 22
#: the additive recurrence of the plastic number: evenly spread pairs
R2 = (0.7548776662466927, 0.5698402909980532)
#: and that of the golden ratio, evenly spread numbers
GOLDEN = 0.6180339887498949


class LitAsset:
    """An asset in one pose, with the emitters that the rigs shown to it need.

    Args:
        asset: see docs/architecture.md; ``asset.stores`` decides what a lightmap holds.
        pose: keyframe.
        max_depth: surface bounces (of a medium: scattering events) of the full light.
    """

    def __init__(self, asset: Any, pose: int = 0, max_depth: int | None = None):
        self.asset, self.pose = asset, pose
        self.max_depth = asset.scene.max_depth if max_depth is None else max_depth
        self._scenes: dict[tuple[bool, int], Any] = {}
        self.dark = asset.load({}, pose)
        self._step = OFFSET * asset.radius
        mi = mitsuba()
        if asset.integrator == "volpath":
            full = mi.load_dict({"type": "volpath", "max_depth": self.max_depth + 1, "hide_emitters": True})
            self.integrators = {"full": full}
        else:
            self.integrators = component_integrators(self.max_depth)
            # the texel itself is the first bounce
            self.arriving = mi.load_dict({"type": "path", "max_depth": self.max_depth, "hide_emitters": True})

    def lit(self, rig: LightRig) -> Any:
        """The ``mi.Scene`` under this rig; one is kept for each combination of kinds of emitters."""
        sky = None if rig.environment is None else checked(rig.environment)
        key = (bool(rig.lights) or sky is None, 0 if sky is None else sky.shape[1])
        if key not in self._scenes:
            for register in (rig_emitter_class, emitter_class):
                register()
            emitters = {}
            if key[0]:
                emitters["rig"] = {"type": "prt_rig"}
            if key[1]:
                emitters["sky"] = {"type": "prt_cubemap", "resolution": key[1]}
            scene = self.asset.load(emitters, self.pose)
            if key[1]:
                scene.environment().set_bounds(self.asset.centre, 1.001 * self.asset.radius)
            self._scenes[key] = scene
        scene = self._scenes[key]
        for emitter in scene.emitters():
            if isinstance(emitter, rig_emitter_class()):
                emitter.set_lights(rig.lights, self.asset.radius)
            elif sky is not None:
                emitter.set_radiance(sky)
        return scene

    # ---- images

    def render(self, rig: LightRig, view: View, spp: int, seed: int) -> dict[str, Float[Tensor, "H W 3"]]:
        """Path-traced ``full``, ``direct`` and ``indirect``; in a medium all light counts as indirect."""
        if "direct" in self.integrators:
            return render_components(self.lit(rig), self.integrators, view, spp, seed)
        both = self.integrators | {"direct": self.integrators["full"]}
        full = render_components(self.lit(rig), both, view, spp, seed)["full"]
        return {name: torch.zeros_like(full) if name == "direct" else full for name in COMPONENTS}

    # ---- lightmaps

    def lightmap(self, rig: LightRig, sites: Sites, spp: int, seed: int) -> Float[Tensor, "C 3"]:
        """Indirect light of the covered texels (Belcour 2022, section 4.1: a path tracer per texel).

        ``incident`` assets: the mean radiance that arrives from surfaces, cosine weighted (irradiance over
        pi). ``outgoing`` ones: the mean radiance sent on, cosine weighted, less what bounced once.

        Args:
            sites: of the asset in this pose; their texels, ascending, are the C covered ones.
            spp: paths a texel.
            seed: equal seeds trace the same paths under every rig, so that lightmaps differ by their light
                alone and not by their noise.
        """
        count = torch.bincount(sites.texel, minlength=sites.size[0] * sites.size[1])
        count = count[count > 0]
        first = count.cumsum(0) - count
        most = max(1, WAVEFRONT // spp)
        estimate = self._arriving if self.asset.stores == "incident" else self._leaving
        parts = []
        for number, start in enumerate(range(0, len(count), most)):
            stop = min(start + most, len(count))
            chunk = int(np.random.SeedSequence([seed & 0xFFFFFFFF, number]).generate_state(1)[0])
            rays = TexelRays(sites, first[start:stop], count[start:stop], spp, chunk)
            parts.append(estimate(rig, rays))
        return torch.cat(parts).clamp_min(0)

    def _arriving(self, rig: LightRig, rays: "TexelRays") -> Float[Tensor, "C 3"]:
        """Mean radiance from surfaces: what a path tracer sees from the texel."""
        mi = mitsuba()
        p, n, d = rays.draw()
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(p + self._step * n), d))
        return rays.mean(self.arriving.sample(self.lit(rig), rays.sampler(), ray)[0])

    def _leaving(self, rig: LightRig, rays: "TexelRays") -> Float[Tensor, "C 3"]:
        """Mean radiance sent on, less direct light along the same paths: no noise of its own in that."""
        mi = mitsuba()
        scene, total = self.lit(rig), torch.zeros((rays.texels, 3))
        for sign, name in ((1.0, "full"), (-1.0, "direct")):
            if name in self.integrators:
                p, n, d = rays.draw()
                ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(p + self._step * d), -d))
                total += sign * rays.mean(self.integrators[name].sample(scene, rays.sampler(), ray)[0])
        return total

    # ---- shadows

    def occluded(
        self, origin: Float[Tensor, "N 3"], direction: Float[Tensor, "N 3"], distance: Float[Tensor, "N"]
    ) -> Bool[Tensor, "N"]:
        """Whether anything of the asset lies on the way; ``distance`` may be infinite."""
        mi = mitsuba()
        ray = mi.Ray3f(mi.Point3f(_columns(origin)), mi.Vector3f(_columns(direction)))
        ray.maxt = mi.Float(np.minimum(distance.numpy() * (1 - OFFSET), 1e30).astype(np.float32))
        return torch.from_numpy(np.array(self.dark.ray_test(ray)))


class TexelRays:
    """``spp`` places and cosine-distributed directions for each of some texels; equal seeds, equal rays."""

    def __init__(self, sites: Sites, first: Tensor, count: Tensor, spp: int, seed: int):
        self.sites, self.first, self.count, self.spp, self.seed = sites, first, count, spp, seed
        self.texels = len(first)

    def sampler(self) -> Any:
        """Random numbers for what follows the first ray, the same at every call."""
        sampler = mitsuba().load_dict({"type": "independent"})
        sampler.seed(self.seed, self.texels * self.spp)
        return sampler

    def draw(self) -> tuple[Any, Any, Any]:
        """Points, unit normals and directions, texel after texel."""
        import drjit as dr

        mi = mitsuba()
        spp = dr.opaque(mi.UInt32, self.spp)
        index = dr.arange(mi.UInt32, self.texels * self.spp)
        texel, sample = index // spp, index % spp
        rng = mi.load_dict({"type": "independent"})
        rng.seed(self.seed ^ 0x5BD1E995, self.texels)
        turn, offset = rng.next_2d(), rng.next_1d()
        dr.eval(turn, offset)
        # an even sequence over directions and another over places, turned at random texel by texel
        u = dr.gather(mi.Point2f, turn, texel) + mi.Float(sample) * mi.Point2f(*R2)
        u -= dr.floor(u)
        along = dr.gather(mi.Float, offset, texel) + mi.Float(sample) * GOLDEN
        along -= dr.floor(along)
        many = dr.gather(mi.UInt32, mi.UInt32(self.count.numpy().astype(np.uint32)), texel)
        first = dr.gather(mi.UInt32, mi.UInt32(self.first.numpy().astype(np.uint32)), texel)
        site = first + dr.minimum(mi.UInt32(along * mi.Float(many)), many - 1)
        n = dr.normalize(_gathered(self.sites.normal, site))
        d = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(u))
        return _gathered(self.sites.position, site), n, d

    def mean(self, value: Any) -> Float[Tensor, "C 3"]:
        """Of the estimates of each texel; those that are not finite count as zero."""
        import drjit as dr

        mi = mitsuba()
        value = mi.Color3f(dr.select(dr.isfinite(value), value, 0))
        total = np.array(dr.block_reduce(dr.ReduceOp.Add, value, self.spp)).T
        return torch.from_numpy(np.ascontiguousarray(total)).float() / self.spp


def _columns(values: Float[Tensor, "N 3"]) -> np.ndarray:
    return np.ascontiguousarray(values.numpy().T, dtype=np.float32)


def _gathered(values: Float[Tensor, "S 3"], index: Any) -> Any:
    import drjit as dr

    mi = mitsuba()
    return dr.gather(mi.Vector3f, mi.Vector3f(_columns(values)), index)

"""Task ``relight_direct``: static surface, any view, environments of few bands; predicted is direct light.

Dhawal 2022. The lighting is an environment in ``order^2`` coefficients of spherical harmonics, the surface
diffuse or glossy (Phong), with shadows and without interreflection. Each material is a split of its own.
"""

import dataclasses
import functools
import hashlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.metrics.registry import evaluate
from prt.progress import track
from prt.scene.gbuffer import GBuffer
from prt.scene.lightmap_points import AtlasGBuffer
from prt.tasks.test_item import TestItem, floor_of
from prt.trace import sh_shading
from prt.trace.band_error import band_errors, fewest
from prt.trace.direct_light import direct_light
from prt.trace.surface import MeshSurface, Surface, SurfacePoints
from prt.trace.texture_transfer import texture_transfer
from prt.trace.transfer import MOST_BANDS, bake

#: raise when the content of a cache changes for equal settings
TRANSFER_VERSION = 1
VIEW_VERSION = 1
TRUTH_VERSION = 1
MATERIALS = ("diffuse", "glossy")
REFERENCES = ("cast", "texture", "truth")
#: added to the seed of references, so that none shares its directions with what a method is given
REFERENCE_SEED = 7000
#: added to the seed of the points held out
HELD_OUT_SEED = 4000
#: training views, their pixels a side, and the seed that ``order: auto`` judges by
CHOICE_VIEWS, CHOICE_SIZE, CHOICE_SEED = 4, 64, 5000


@dataclasses.dataclass
class TransferPoints:
    """Points on the surface with their transfer vectors, order^2 coefficients each."""

    points: SurfacePoints
    transfer: Float[Tensor, "N K"]
    bounds: tuple[tuple[float, ...], tuple[float, ...]]


class RelightDirect:
    """The task; settings as in ``conf/task/relight_direct.yaml``.

    Args:
        scene, lighting: a scene of meshes or a signed distance field, and an environment set.
        resolution: R of the cubemap that the coefficients are taken from.
        order: bands of the lighting and of the transfer; ``order^2`` coefficients. ``auto`` takes the fewest
            with which radiance in training views under training lights is within ``order_target`` of the
            ray-traced truth, in every material.
        order_target: root mean square error over the root mean square of the truth.
        windowing: damping of its upper bands against ringing, 0 for none
            (:func:`prt.light.sh_products.window`).
        materials: splits that are tested, ``diffuse`` and ``glossy``; each gives the whole surface one
            reflectance, the sum of the diffuse and specular one of its own materials.
        exponent: of the Phong lobe.
        train_points: evenly by area, whose transfer a method may learn from; one in ten more is held out.
        directions: rays of each.
        texels: of the atlas of a mesh, a side, and of the texture of ``reference: texture``; 0 for none,
            where no method needs one.
        views, size: test views along the far trajectories, and their pixels a side.
        reference: what ``psnr`` and its like compare with, always under the lighting in few bands but for the
            last. ``cast``: transfer cast for every pixel. ``texture``: transfer in a texture, the baseline of
            the paper. ``truth``: ray-traced under the whole environment.
        reference_directions: rays of each transfer vector of a reference, both halves together.
        split_views: the first views, whose error is split by the other references too.
        truth_samples: directions a pixel of the ray-traced truth, both halves together.
    """

    name = "relight_direct"
    components = ("direct",)
    #: nothing here is Monte Carlo noise that a denoiser knows
    denoise_after = False

    def __init__(
        self, scene: Any, lighting: Any, name: str, resolution: int, order: int | str, windowing: float,
        materials: list[str], exponent: float, train_points: int, directions: int, texels: int, views: int,
        size: int, reference: str, reference_directions: int, split_views: int, truth_samples: int,
        order_target: float = 0.2, seed: int = 0,
    ):  # fmt: skip
        if not hasattr(lighting, "test") or not hasattr(lighting, "prior"):
            raise PrtError("task=relight_direct needs environments: lighting=hdri or procedural")
        for setting, value, least in (
            ("order", 1 if order == "auto" else order, 1),
            ("train_points", train_points, 1), ("directions", directions, 1),
            ("views", views, 1), ("size", size, 1), ("texels", texels, 0),
            ("reference_directions", reference_directions, 2),
            ("split_views", split_views, 0), ("truth_samples", truth_samples, 4),
        ):  # fmt: skip
            if value < least:
                raise PrtError(f"task.{setting}={value} must be at least {least}")
        if not exponent >= 0:
            raise PrtError(f"task.exponent={exponent} must be 0 or more (Phong exponent)")
        for part in materials:
            if part not in MATERIALS:
                raise PrtError(f"task.materials names {part!r}; choose from {', '.join(MATERIALS)}")
        if reference == "texture" and texels == 0:
            raise PrtError("task.reference=texture needs an atlas; set task.texels=1024")
        if reference not in REFERENCES:
            raise PrtError(f"task.reference={reference!r} is not one of {', '.join(REFERENCES)}")
        self.scene, self.lighting, self.resolution = scene, lighting, resolution
        self._order, self.windowing = order, windowing
        self.order_target = order_target
        self.materials, self.exponent = list(materials), exponent
        self.train_points, self.directions, self.texels = train_points, directions, texels
        self.views, self.size, self.split_views = views, size, split_views
        self.reference, self.reference_directions = reference, reference_directions
        self.truth_samples, self.seed = truth_samples, seed

    @functools.cached_property
    def surface(self) -> Surface:
        """What the scene's surface is made of.

        Raises:
            PrtError: for ``reference: texture`` on a surface that has no atlas.
        """
        if not hasattr(self.scene, "distance"):
            return MeshSurface(self.scene, self.texels)
        if self.reference == "texture":
            raise PrtError(
                f"task.reference=texture needs an atlas, and scene={self.scene.name} is a signed distance "
                "field; set task.reference=cast"
            )
        from prt.trace.sdf_surface import SdfSurface

        return SdfSurface(self.scene)

    @functools.cached_property
    def order(self) -> int:
        """Bands of the lighting and of the transfer.

        Raises:
            PrtError: for ``auto``, where no number up to the most is enough.
        """
        if self._order != "auto":
            return int(self._order)
        errors = self.band_errors()
        enough = fewest(errors, self.order_target)
        if enough is None:
            best = min(errors, key=lambda order: errors[order])
            raise PrtError(
                f"task.order=auto: no number of bands up to {MOST_BANDS} meets task.order_target="
                f"{self.order_target}; the best, {best}, has {errors[best]:.3g}; raise the target or set "
                "task.order"
            )
        return enough

    @functools.cache  # noqa: B019
    def band_errors(self) -> dict[int, float]:
        """Relative error of so many bands in a few small training views, the larger one of both materials."""
        _, lightings = self.lighting.train()
        views = self.scene.views("train", CHOICE_VIEWS, CHOICE_SIZE)
        seen = [(self.surface.capture(view), lightings[i % len(lightings)]) for i, view in enumerate(views)]
        errors: dict[int, float] = {}
        for material in self.materials:
            dressed = [(self.dressed(gbuffer, material), light) for gbuffer, light in seen]
            found = band_errors(
                self.surface, dressed, range(1, MOST_BANDS + 1), self.directions, self.truth_samples,
                self.windowing, CHOICE_SEED,
            )  # fmt: skip
            errors = {order: max(error, errors.get(order, 0.0)) for order, error in found.items()}
        return errors

    # ---- what a method may learn from

    def training(self) -> TransferPoints:
        """Points spread over the surface and their transfer; cast on first use, then cached on disk."""
        return self._points(self.train_points, self.seed, "transfer of training points")

    def held_out(self) -> TransferPoints:
        """A tenth as many points that are not among them: what the fit itself is judged on."""
        count = max(self.train_points // 10, 1)
        return self._points(count, HELD_OUT_SEED + self.seed, "transfer of points held out")

    @functools.cache  # noqa: B019  (lives as long as the run)
    def _points(self, count: int, seed: int, label: str) -> TransferPoints:
        surface = self.surface
        settings = {
            "surface": surface.fingerprint(), "count": count, "directions": self.directions,
            "order": self.order, "seed": seed,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            points = surface.sample(count, seed)
            transfer = bake(surface, points.position, points.normal, self.order, self.directions, seed, label)
            return {"position": points.position, "normal": points.normal, "transfer": transfer}

        found = cached("transfer", TRANSFER_VERSION, settings, build)
        return TransferPoints(
            SurfacePoints(found["position"], found["normal"]), found["transfer"], surface.bounds
        )

    def texture(self, seed: int, directions: int | None = None) -> Float[Tensor, "T K"]:
        """Transfer of the texels of a mesh's atlas, row by row; cached on disk."""
        surface = self.surface
        assert isinstance(surface, MeshSurface)
        settings = {
            "surface": surface.fingerprint(), "texels": self.texels, "order": self.order, "seed": seed,
            "directions": directions or self.directions,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            many = settings["directions"]
            return {"texels": texture_transfer(surface, self.order, many, seed, "transfer of texels")}

        return cached("texture", TRANSFER_VERSION, settings, build)["texels"]

    # ---- what it is judged on

    def tests(self) -> list[TestItem]:
        """Test views with references in each material; cached on disk view by view."""
        return self._tests

    @functools.cached_property
    def _tests(self) -> list[TestItem]:
        names, lightings = self.lighting.test()
        views = self.scene.views("far", self.views, self.size)
        items = []
        for number, view in enumerate(track(views, f"references, {self.scene.name}", len(views))):
            seen = self._seen(view, number < self.split_views or self.reference != "texture")
            which = number % len(names)
            for material in self.materials:
                gbuffer = self.dressed(seen.gbuffer, material)
                halves = self._halves(seen, gbuffer, lightings[which], material, self.reference)
                images = [gbuffer.image(half) for half in halves]
                floor = floor_of(*images)
                items.append(TestItem(
                    material, f"view{number:02d}", names[which], lightings[which], gbuffer,
                    {"direct": (images[0] + images[1]) / 2}, {"direct": floor}, torch.zeros_like(images[0]),
                ))  # fmt: skip
        return items

    def dressed(self, gbuffer: GBuffer, material: str) -> GBuffer:
        """The G-buffer with its whole reflectance made diffuse, or that of a Phong lobe."""
        colour = (gbuffer.diffuse + gbuffer.specular).clamp(0, 1)
        black, one = torch.zeros_like(colour), torch.ones_like(gbuffer.roughness)
        if material == "diffuse":
            return dataclasses.replace(gbuffer, diffuse=colour, specular=black, roughness=one)
        rough = sh_shading.roughness_of(self.exponent) * one
        return dataclasses.replace(gbuffer, diffuse=black, specular=colour, roughness=rough)

    def _seen(self, view: Any, cast: bool) -> "_Seen":
        """A view's G-buffer and, where asked for, two halves of the transfer of its pixels."""
        surface = self.surface
        settings = {
            "surface": surface.fingerprint(), "view": dataclasses.asdict(view), "order": self.order,
            "directions": self.reference_directions if cast else 0, "seed": self.seed,
            "texels": self.texels if isinstance(surface, MeshSurface) else 0,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            gbuffer = surface.capture(view)
            found = gbuffer.tensors()
            for half in (0, 1) if cast else ():
                found[f"transfer.{half}"] = bake(
                    surface, gbuffer.position, gbuffer.normal, self.order,
                    max(self.reference_directions // 2, 1), REFERENCE_SEED + 2 * self.seed + half,
                )  # fmt: skip
            return found

        found = cached("view", VIEW_VERSION, settings, build)
        kind = AtlasGBuffer if isinstance(surface, MeshSurface) and self.texels else GBuffer
        transfer = [found[f"transfer.{half}"] for half in (0, 1)] if cast else None
        return _Seen(kind.from_tensors(found, view), transfer)

    def _halves(
        self, seen: "_Seen", gbuffer: GBuffer, lighting: Tensor, material: str, reference: str
    ) -> list[Float[Tensor, "N 3"]]:
        """Two independent estimates of a view's radiance, by the reference named."""
        if reference == "truth":
            return [self._truth(gbuffer, lighting, half, material) for half in (0, 1)]
        code = sh_shading.encode(lighting, self.order, self.windowing)
        transfer = self._texture_transfer(gbuffer) if reference == "texture" else seen.transfer
        assert transfer is not None
        return [sh_shading.shade(part, gbuffer, code) for part in transfer]

    def _texture_transfer(self, gbuffer: GBuffer) -> list[Float[Tensor, "N K"]]:
        from prt.scene.texture_lookup import bilinear

        size = self.surface.asset.size  # pyright: ignore[reportAttributeAccessIssue]
        many = max(self.reference_directions // 2, 1)
        return [bilinear(self._reference_texture(half, many), size, gbuffer.uv) for half in (0, 1)]

    @functools.cache  # noqa: B019
    def _reference_texture(self, half: int, directions: int) -> Float[Tensor, "T K"]:
        return self.texture(REFERENCE_SEED + 2 * self.seed + half, directions)

    def truth(
        self, gbuffer: GBuffer, lighting: Float[Tensor, "6 R R 3"], samples: int, seed: int
    ) -> Float[Tensor, "N 3"]:
        """Ray-traced radiance of the points of a dressed G-buffer, under the whole lighting."""
        return direct_light(
            self.surface, gbuffer.position, gbuffer.normal, gbuffer.wr, gbuffer.diffuse, gbuffer.specular,
            sh_shading.exponent_of(gbuffer.roughness), lighting, samples, seed,
        )  # fmt: skip

    def _truth(self, gbuffer: GBuffer, lighting: Tensor, half: int, material: str) -> Float[Tensor, "N 3"]:
        settings = {
            "surface": self.surface.fingerprint(), "view": dataclasses.asdict(gbuffer.view), "half": half,  # pyright: ignore
            "lighting": hashlib.sha256(lighting.numpy().tobytes()).hexdigest(), "material": material,
            "exponent": self.exponent, "samples": self.truth_samples, "seed": self.seed,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            seed = REFERENCE_SEED + 2 * self.seed + half
            return {"radiance": self.truth(gbuffer, lighting, max(self.truth_samples // 2, 2), seed)}

        return cached("direct", TRUTH_VERSION, settings, build)["radiance"]

    # ---- scoring

    def compose(self, item: TestItem, image: Tensor, component: str) -> dict[str, Tensor]:
        """The one component there is."""
        if component != "direct":
            raise PrtError(f"task {self.name} scores methods that predict direct light, not {component}")
        return {"direct": image}

    def error_split(self, item: TestItem, image: Tensor, method: Any) -> dict[str, float]:
        """Where an image's error comes from; all but ``negative/share`` for the first views only.

        ``psnr/cast``: against transfer cast for every pixel, the error of storage or network alone.
        ``psnr/truth``: against the ray-traced truth, all errors together. ``psnr/truncation``: of the cast
        transfer against the truth, what few bands cost whatever stores them.
        """
        hit = item.gbuffer.hit
        found = {"negative/share": float((image.reshape(-1, 3)[hit] < 0).any(dim=1).float().mean())}
        if int(item.view_name[4:]) >= self.split_views:
            return found
        assert item.gbuffer.view is not None
        seen = self._seen(item.gbuffer.view, True)
        cast, truth = (
            sum(self._halves(seen, item.gbuffer, item.lighting, item.split, kind)) / 2  # pyright: ignore
            for kind in ("cast", "truth")
        )
        cast, truth = item.gbuffer.image(cast), item.gbuffer.image(truth)
        found["psnr/cast"] = evaluate(image, cast, ["psnr"])["psnr"]
        found["psnr/truth"] = evaluate(image, truth, ["psnr"])["psnr"]
        found["psnr/truncation"] = evaluate(cast, truth, ["psnr"])["psnr"]
        return found


@dataclasses.dataclass
class _Seen:
    gbuffer: GBuffer
    transfer: list[Tensor] | None

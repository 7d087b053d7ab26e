"""Task ``relight_indirect``: static scene, any view, any environment; predicted is indirect radiance."""

import dataclasses
import functools
import hashlib
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.metrics.image import PSNR_CAP
from prt.metrics.tonemap import exposure_of, to_srgb
from prt.progress import track
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.tasks import importance
from prt.tasks.test_item import TestItem, floor_of
from prt.trace.denoise import denoise
from prt.trace.record import record
from prt.trace.reference import render
from prt.trace.transport import Transport

#: raise when the content of a cache changes for equal settings
TRANSPORT_VERSION = 1
REFERENCE_VERSION = 1
UNSEEN = "no training view of scene {!r} sees the scene; check scene.cameras"


@dataclasses.dataclass
class Training:
    """The N visible points of all training views with their recorded indirect transport.

    Attributes:
        importance: strategy to per-point weight, (N,) each (``prt.tasks.importance``).
    """

    gbuffer: GBuffer
    transport: Transport
    point_view: Int[Tensor, "N"]
    views: list[View]
    importance: dict[str, Tensor]

    @property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Corners of the box of all training points: what is seen of the scene, not all of its ground."""
        return self.gbuffer.position.amin(dim=0).tolist(), self.gbuffer.position.amax(dim=0).tolist()

    @property
    def pixel_size(self) -> float:
        """Median width of a training pixel at its point, across the line of sight, in world units."""
        return median_width(self.gbuffer.position, self.point_view, self.views)


def median_width(position: Float[Tensor, "N 3"], point_view: Int[Tensor, "N"], views: list[View]) -> float:
    """Median width of a pixel at the point it shows, across the line of sight, in world units."""
    origins = torch.tensor([view.origin for view in views])[point_view]
    widths = torch.tensor([2 * view.half_width / view.width for view in views])
    return float(((position - origins).norm(dim=1) * widths[point_view]).median())


class RelightIndirect:
    """The task; settings as in ``conf/task/relight_indirect.yaml``.

    Args:
        scene, lighting: a :class:`Scene` and an environment set.
        resolution: R of the cubemap.
        train_views, train_size, train_spp: training views, pixels a side, recorded paths a pixel.
        near_views, far_views, test_size: test views of each split and their pixels a side.
        lightings_per_view: test lightings of each test view, taken in turn.
        reference_spp: samples a pixel of a reference, both halves together.
        reference_denoise: denoise the references (Open Image Denoise with albedo and normal).
        direct_spp: samples a pixel of the direct light that is added to a prediction; it is denoised.
        split_spp: recorded paths a pixel of the test views, for the error split.
    """

    name = "relight_indirect"
    components = ("full", "indirect")

    def __init__(
        self,
        scene: Scene,
        lighting: Any,
        name: str,
        resolution: int,
        train_views: int,
        train_size: int,
        train_spp: int,
        near_views: int,
        far_views: int,
        test_size: int,
        lightings_per_view: int,
        reference_spp: int,
        reference_denoise: bool,
        direct_spp: int,
        split_spp: int,
        seed: int = 0,
    ):
        if resolution < 2 or resolution & (resolution - 1):
            raise PrtError(
                f"task.resolution={resolution} must be a power of two (Haar wavelets on cubemap faces)"
            )
        for setting, value in dict(
            train_views=train_views,
            train_size=train_size,
            train_spp=train_spp,
            test_size=test_size,
            lightings_per_view=lightings_per_view,
            reference_spp=reference_spp,
            direct_spp=direct_spp,
        ).items():
            if value < 1:
                raise PrtError(f"task.{setting}={value} must be at least 1")
        self.scene, self.lighting, self.resolution = scene, lighting, resolution
        self.train_view_count, self.train_size, self.train_spp = train_views, train_size, train_spp
        self.test_counts = {"near": near_views, "far": far_views}
        self.test_size, self.lightings_per_view = test_size, lightings_per_view
        self.reference_spp, self.reference_denoise = reference_spp, reference_denoise
        self.direct_spp, self.split_spp, self.seed = direct_spp, split_spp, seed

    # ---- training data

    def train_lightings(self) -> Float[Tensor, "n T 3"]:
        """Training environments, flat."""
        return self._train_lightings

    @functools.cached_property
    def _train_lightings(self) -> Tensor:
        return self.lighting.train()[1].flatten(1, 3)

    def prior(self) -> Float[Tensor, "T 3"]:
        """Mean training environment, flat."""
        return self.train_lightings().mean(dim=0)

    def training(self) -> Training:
        """The training points; recorded on first use, then cached on disk view by view."""
        return self._training

    @functools.cached_property
    def _training(self) -> Training:
        views = self.scene.views("train", self.train_view_count, self.train_size)
        label = f"record transport, {self.scene.name}"
        parts = [
            self.recorded(view, self.train_spp, self.seed + 1 + i)
            for i, view in enumerate(track(views, label, len(views)))
        ]
        gbuffers = [gbuffer for gbuffer, _ in parts]
        transports = [
            whole.component("indirect").rows(gbuffer.hit.nonzero()[:, 0]) for gbuffer, whole in parts
        ]
        point_view = torch.repeat_interleave(
            torch.arange(len(views)), torch.tensor([len(g) for g in gbuffers])
        )
        gbuffer, transport = GBuffer.concatenate(gbuffers), Transport.concatenate(transports)
        if len(gbuffer) == 0:
            raise PrtError(UNSEEN.format(self.scene.name))
        lit = transport.relight(self.prior()[None])[0]
        edges = [
            importance.high_frequency(g.image(part), g.hit)
            for g, part in zip(gbuffers, lit.split([len(g) for g in gbuffers]), strict=True)
        ]
        weights = {
            "specular": importance.specular(gbuffer),
            "high_frequency": torch.cat(edges),
            "view_variance": importance.view_variance(gbuffer.position, lit, point_view),
        }
        return Training(gbuffer, transport, point_view, views, weights)

    @functools.cached_property
    def pixel_size(self) -> float:
        """That of :meth:`training`, known without recording transport: the views are only looked at."""
        views = self.scene.views("train", self.train_view_count, self.train_size)
        seen = [capture(self.mitsuba_scene, view).position for view in views]
        if not sum(len(position) for position in seen):
            raise PrtError(UNSEEN.format(self.scene.name))
        owner = torch.repeat_interleave(torch.arange(len(views)), torch.tensor([len(p) for p in seen]))
        return median_width(torch.cat(seen), owner, views)

    def recorded(self, view: View, spp: int, seed: int) -> tuple[GBuffer, Transport]:
        """G-buffer and transport of every pixel of a view, from the cache where it is there."""
        needs_prior = self.scene.record == "nee"
        settings = {
            "scene": self.scene.fingerprint(),
            "view": dataclasses.asdict(view),
            "spp": spp,
            "seed": seed,
            "max_depth": self.scene.max_depth,
            "resolution": self.resolution,
            "prior": self.lighting.fingerprint() if needs_prior else None,
        }

        def build() -> dict[str, Tensor]:
            gbuffer = capture(self.mitsuba_scene, view)
            prior = self.prior().view(6, self.resolution, self.resolution, 3) if needs_prior else None
            transport = record(
                self.mitsuba_scene, view, spp, self.scene.max_depth, self.resolution, seed, prior=prior
            )
            return gbuffer.tensors() | {
                f"transport.{name}": getattr(transport, name)
                for name in ("offsets", "texel", "weight", "bounces")
            }

        found = cached("transport", TRANSPORT_VERSION, settings, build)
        gbuffer = GBuffer.from_tensors(found, view)
        parts = {name: found[f"transport.{name}"] for name in ("offsets", "texel", "weight", "bounces")}
        return gbuffer, Transport(self.resolution, **parts)

    @functools.cached_property
    def mitsuba_scene(self):
        return self.scene.load()

    # ---- test data

    def tests(self) -> list[TestItem]:
        """Test views and lightings with references; rendered on first use, cached on disk item by item."""
        return self._tests

    @functools.cached_property
    def _tests(self) -> list[TestItem]:
        names, lightings = self.lighting.test()
        pairs = []
        for split, count in self.test_counts.items():
            views = self.scene.views(split, count, self.test_size, train_count=self.train_view_count)
            for i, view in enumerate(views):
                for j in range(self.lightings_per_view):
                    pairs.append((split, i, view, (i * self.lightings_per_view + j) % len(names)))
        label = f"references, {self.scene.name}"
        return [
            self.test_item(split, f"{split}{i:02d}", view, names[which], lightings[which])
            for split, i, view, which in track(pairs, label, len(pairs))
        ]

    def test_item(
        self, split: str, view_name: str, view: View, lighting_name: str, lighting: Tensor
    ) -> TestItem:
        settings = {
            "scene": self.scene.fingerprint(),
            "view": dataclasses.asdict(view),
            "max_depth": self.scene.max_depth,
            "lighting": hashlib.sha256(lighting.numpy().tobytes()).hexdigest(),
            "spp": self.reference_spp,
            "denoise": self.reference_denoise,
            "direct_spp": self.direct_spp,
            "seed": self.seed,
        }
        found = cached(
            "reference", REFERENCE_VERSION, settings, lambda: self.render_references(view, lighting)
        )
        gbuffer = GBuffer.from_tensors(found, view)
        references = {
            name: (found[f"{name}.0"] + found[f"{name}.1"]) / 2 for name in ("full", "indirect", "direct")
        }
        floor = {name: floor_of(found[f"{name}.0"], found[f"{name}.1"]) for name in references}
        return TestItem(
            split, view_name, lighting_name, lighting, gbuffer, references, floor, found["direct.other"]
        )

    def render_references(self, view: View, lighting: Tensor) -> dict[str, Tensor]:
        """Two independent halves of the reference, and the direct light with a third seed."""
        gbuffer = capture(self.mitsuba_scene, view)
        guides, found = gbuffer.guides(), gbuffer.tensors()
        for half in (0, 1):
            seed = 1000 + 2 * self.seed + half
            images = render(
                self.scene, view, lighting, max(self.reference_spp // 2, 1), self.scene.max_depth, seed
            )
            for name, image in images.items():
                found[f"{name}.{half}"] = denoise(image, **guides) if self.reference_denoise else image
        direct = render(self.scene, view, lighting, self.direct_spp, 1, 5000 + self.seed)["direct"]
        found["direct.other"] = denoise(direct, **guides)
        return found

    def compose(self, item: TestItem, image: Tensor, component: str) -> dict[str, Tensor]:
        """Every component that is scored, from a method's image of one component."""
        if component == "indirect":
            return {"indirect": image, "full": image + item.direct}
        raise PrtError(f"task {self.name} scores methods that predict indirect light, not {component}")

    def error_split(self, item: TestItem, image: Tensor, method: Any) -> dict[str, float]:
        """``psnr/truncation``, ``psnr/fit``, ``psnr/noise``: the indirect image's error parts, in dB.

        The truncated truth is the reference less the recorded transport of the lighting's lost part. Records
        are noisy, so each squared error is the product of two estimates from independent records.
        """
        reference = item.references["indirect"]
        parts = {"psnr/noise": item.noise_floor["indirect"]}
        # rays that meet the whole lighting have no error of its truncation to tell apart
        traced = getattr(method, "traces_lighting", False)
        if hasattr(method, "truncated") and not traced and item.gbuffer.view is not None:
            lost = (item.lighting - method.truncated(item.lighting)).reshape(1, -1, 3)
            exposure = exposure_of(reference.numpy())
            whole, fitted = to_srgb(reference, exposure), to_srgb(image, exposure)
            kept = []
            for half in (0, 1):
                _, transport = self.recorded(item.gbuffer.view, self.split_spp, 9000 + 2 * self.seed + half)
                missing = transport.component("indirect").relight(lost)[0].view(reference.shape)
                kept.append(to_srgb(reference - missing, exposure))
            parts["psnr/truncation"] = product_psnr(whole - kept[0], whole - kept[1])
            parts["psnr/fit"] = product_psnr(fitted - kept[0], fitted - kept[1])
        return parts


def product_psnr(first: np.ndarray, second: np.ndarray) -> float:
    """PSNR in dB of an error of which there are two estimates with independent noise."""
    return float(min(-10 * np.log10(max(float(np.mean(first * second)), 1e-12)), PSNR_CAP))

"""Task ``local_lights``: static or keyframed asset, the lights of a scenario vary; predicted is the indirect
lightmap, judged in texture space and on camera frames (Belcour 2022)."""

import dataclasses
import functools
import math
import time
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.light.local import LightRig
from prt.light.scenario import Scenario
from prt.progress import track
from prt.scene.lightmap_points import AtlasGBuffer
from prt.scene.scene import Scene
from prt.scene.view import View
from prt.tasks.test_item import TestItem, floor_of
from prt.trace import lightmap_filter
from prt.trace.denoise import denoise
from prt.trace.rig import LitAsset

#: raise when the content of a cache changes for equal settings
LIGHTMAP_VERSION = 1
FRAME_VERSION = 1
LIGHTMAP = "lightmap"
#: added to the seed of references, so that none shares its paths with the baked lightmaps
REFERENCE_SEED = 7000


@dataclasses.dataclass
class Database:
    """What is baked (section 4.1): N configurations with their indirect lightmaps.

    Attributes:
        rigs: the configurations.
        lightmaps: their C covered texels, linear.
        covered: which texels of the H x W lightmap these are.
        fill: for every texel the covered one that stands in it (seams padded), an index in [0, C).
        size: (H, W).
        seconds: that path tracing (and denoising) all lightmaps took, when they were made.
    """

    rigs: list[LightRig]
    lightmaps: Float[Tensor, "N C 3"]
    covered: Bool[Tensor, "T"]
    fill: Int[Tensor, "T"]
    size: tuple[int, int]
    seconds: float


class LocalLights:
    """The task; settings as in ``conf/task/local_lights.yaml``.

    Args:
        scene, lighting: a :class:`Scene` and a :class:`Scenario`.
        texels: of the lightmap, a side (a hair asset has its own size).
        train_count: configurations baked.
        test_count: test configurations of the same scenario.
        others: which of the scenario's other scenarios are tested too; null: all.
        other_count: test configurations of each of them.
        spp: paths a texel of a baked lightmap.
        common_random_numbers: trace all lightmaps along the same paths: their noise is then a property of the
            transport and not of each configuration, and takes no basis elements.
        denoise: filter baked lightmaps (:func:`prt.trace.lightmap_filter.filtered`).
        reference_spp: paths a texel of a test lightmap, both halves together.
        reference_denoise: filter each half of the references alike (lightmaps but hair's; frames with their
            G-buffer).
        frames: test configurations of each split that are also judged on a camera frame.
        frame_size, frame_spp: pixels a side; samples a pixel of the reference, both halves together.
        frame_supersample: G-buffer samples along each side of a pixel.
        path_steps: steps of a slowly moving light (split ``path``), 0 for none; its references take a
            quarter of the paths, the same for all steps: what changes between two is not their noise.
    """

    name = "local_lights"
    components = ("indirect", "full")
    #: what the runner may do to images after a method: nothing, lightmaps are no camera images
    denoise_after = False

    def __init__(
        self, scene: Scene, lighting: Any, name: str, texels: int, train_count: int, test_count: int,
        others: list[str] | None, other_count: int, spp: int, common_random_numbers: bool, denoise: bool,
        reference_spp: int, reference_denoise: bool, frames: int, frame_size: int, frame_spp: int,
        frame_supersample: int, path_steps: int, seed: int = 0,
    ):  # fmt: skip
        if not isinstance(lighting, Scenario):
            raise PrtError(
                "task=local_lights needs a lighting scenario: lighting=spots, points, directional, "
                "spots_inside or environments"
            )
        for setting, value, least in (
            ("train_count", train_count, 1), ("test_count", test_count, 1), ("other_count", other_count, 0),
            ("spp", spp, 1), ("reference_spp", reference_spp, 2), ("frames", frames, 0),
            ("frame_size", frame_size, 8), ("frame_spp", frame_spp, 2),
            ("frame_supersample", frame_supersample, 1), ("path_steps", path_steps, 0),
        ):  # fmt: skip
            if value < least:
                raise PrtError(f"task.{setting}={value} must be at least {least}")
        unknown = [name for name in others or () if name not in lighting.others]
        if unknown:
            raise PrtError(
                f"task.others names {unknown[0]!r}; the scenario has {', '.join(lighting.others) or 'none'}"
            )
        self.scene, self.lighting, self.asset = scene, lighting, scene.asset(texels)
        self.train_count, self.test_count, self.other_count = train_count, test_count, other_count
        self.others = list(lighting.others) if others is None else list(others)
        self.spp, self.common_random_numbers, self.denoise = spp, common_random_numbers, denoise
        self.reference_spp, self.reference_denoise = reference_spp, reference_denoise
        self.frames = frames
        self.frame_size, self.frame_spp, self.frame_supersample = frame_size, frame_spp, frame_supersample
        self.path_steps, self.seed = path_steps, seed

    @functools.cache  # noqa: B019  (lives as long as the run)
    def lit(self, pose: int) -> LitAsset:
        """The asset in a pose, ready for any rig."""
        return LitAsset(self.asset, pose)

    def rigs(self, split: str, count: int) -> tuple[list[str], list[LightRig]]:
        """Configurations of a split; see :meth:`Scenario.rigs`."""
        asset = self.asset
        return self.lighting.rigs(split, count, asset.centre, asset.radius, asset.half_extents, asset.poses)

    # ---- what a method may learn from

    def database(self, count: int | None = None) -> Database:
        """The baked configurations, the first ``count`` of them; cached on disk one by one."""
        count = self.train_count if count is None else count
        _, rigs = self.rigs("train", count)
        maps, seconds = [], 0.0
        for number, rig in enumerate(track(rigs, f"bake lightmaps, {self.scene.name}", len(rigs))):
            seed = self.seed if self.common_random_numbers else self.seed + 1 + number
            values, spent = self._lightmap(rig, self.spp, seed, self.denoise)
            maps.append(values)
            seconds += spent
        asset = self.asset
        return Database(rigs, torch.stack(maps), asset.covered, asset.fill, asset.size, seconds)

    def baked_twice(
        self, rig: LightRig, spp: int, seed: int
    ) -> tuple[Float[Tensor, "C 3"], Float[Tensor, "C 3"]]:
        """A configuration's lightmap with two seeds, not denoised: what they share is no noise."""
        first, second = (self._lightmap(rig, spp, 2 * seed + half, False)[0] for half in (0, 1))
        return first, second

    def _lightmap(self, rig: LightRig, spp: int, seed: int, filtered: bool) -> tuple[Tensor, float]:
        settings = {
            "asset": self._fingerprint, "rig": rig.fingerprint(), "spp": spp, "seed": seed,
            "denoise": self._filter if filtered else False, "max_depth": self.scene.max_depth,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            started = time.perf_counter()
            values = self.lit(rig.pose).lightmap(rig, self._sites(rig.pose), spp, seed)
            if settings["denoise"]:
                values = lightmap_filter.filtered(self.asset, values, self._sites(rig.pose))
            return {"values": values, "seconds": torch.tensor(time.perf_counter() - started)}

        found = cached("lightmap", LIGHTMAP_VERSION, settings, build)
        return found["values"], float(found["seconds"])

    @property
    def _filter(self) -> Any:
        """Names the filter of lightmaps in cache keys."""
        return True if self.asset.filterable else f"nearest {lightmap_filter.NEIGHBOURS}"

    @functools.cached_property
    def _fingerprint(self) -> dict[str, Any]:
        return self.asset.fingerprint()

    @functools.cache  # noqa: B019
    def _sites(self, pose: int):
        return self.asset.sites(pose)

    # ---- what it is judged on

    def tests(self) -> list[TestItem]:
        """Test configurations with references, in texture space and from cameras; cached one by one."""
        return self._tests

    def timed_item(self) -> TestItem:
        """What is timed: a camera frame where there is one."""
        return next((item for item in self._tests if item.view_name != LIGHTMAP), self._tests[0])

    @functools.cached_property
    def _tests(self) -> list[TestItem]:
        counts = {"same": self.test_count} | dict.fromkeys(self.others, self.other_count)
        counts["path"] = self.path_steps
        jobs = []
        for split, count in counts.items():
            names, rigs = self.rigs(split, count) if count else ([], [])
            jobs += [(split, name, rig, None) for name, rig in zip(names, rigs, strict=True)]
            if split != "path" and count:
                views = self.scene.views("far", max(min(self.frames, count), 1), self.frame_size)
                jobs += [
                    (split, names[i], rigs[i], (f"frame{i:02d}", views[i]))
                    for i in range(min(self.frames, count))
                ]
        label = f"references, {self.scene.name}"
        return [
            self._texel_item(split, name, rig)
            if frame is None
            else self._frame_item(split, name, rig, *frame)
            for split, name, rig, frame in track(jobs, label, len(jobs))
        ]

    def _texel_item(self, split: str, name: str, rig: LightRig) -> TestItem:
        gbuffer = self._texel_gbuffer(rig.pose)
        spp = max(self.reference_spp // (8 if split == "path" else 2), 1)
        seeds = [REFERENCE_SEED + 2 * self.seed + half for half in (0, 1)]
        # a mean over neighbouring strands is a method's to make, not the truth's
        clean = self.reference_denoise and self.asset.filterable
        halves = [gbuffer.image(self._lightmap(rig, spp, seed, clean)[0]) for seed in seeds]
        return TestItem(
            split, LIGHTMAP, name, rig, gbuffer, {"indirect": (halves[0] + halves[1]) / 2},
            {"indirect": floor_of(*halves)}, torch.zeros_like(halves[0]),
        )  # fmt: skip

    @functools.cache  # noqa: B019
    def _texel_gbuffer(self, pose: int) -> AtlasGBuffer:
        return self.asset.texel_gbuffer(pose)

    def _frame_item(self, split: str, name: str, rig: LightRig, view_name: str, view: View) -> TestItem:
        settings = {
            "asset": self._fingerprint, "rig": rig.fingerprint(), "view": dataclasses.asdict(view),
            "spp": self.frame_spp, "seed": self.seed, "max_depth": self.scene.max_depth,
            "supersample": self.frame_supersample, "denoise": self.reference_denoise,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            lit, many = self.lit(rig.pose), self.frame_supersample
            fine = view.resized(view.width * many, view.height * many)
            gbuffer = self.asset.capture(lit.dark, fine, rig.pose)
            gbuffer.supersample = many
            found = gbuffer.tensors()
            for half in (0, 1):
                seed = REFERENCE_SEED + 2 * self.seed + half
                for part, image in lit.render(rig, view, max(self.frame_spp // 2, 1), seed).items():
                    found[f"{part}.{half}"] = self._cleaned(image, gbuffer)
            return found

        found = cached("frame", FRAME_VERSION, settings, build)
        many = self.frame_supersample
        fine = view.resized(view.width * many, view.height * many)
        gbuffer = AtlasGBuffer.from_tensors(found, fine)
        gbuffer.supersample = many
        pairs = {part: (found[f"{part}.0"], found[f"{part}.1"]) for part in ("full", "indirect", "direct")}
        references = {part: (a + b) / 2 for part, (a, b) in pairs.items()}
        floors = {part: floor_of(a, b) for part, (a, b) in pairs.items()}
        # direct light is not predicted: what is added is the reference's own
        return TestItem(split, view_name, name, rig, gbuffer, references, floors, references["direct"])

    def _cleaned(self, image: Tensor, gbuffer: AtlasGBuffer) -> Tensor:
        """A half of a reference frame, denoised with its G-buffer where that says what the surface is."""
        if not self.reference_denoise:
            return image
        return denoise(image, **(gbuffer.guides() if self.asset.filterable else {}))

    def compose(self, item: TestItem, image: Tensor, component: str) -> dict[str, Tensor]:
        """Every component that is scored, from a method's image of indirect light."""
        if component == "full":  # a lightmap holds no direct light to compare with
            return {} if item.view_name == LIGHTMAP else {"full": image}
        if component != "indirect":
            raise PrtError(
                f"task {self.name} scores methods that predict indirect light, or full light, not {component}"
            )
        full = {} if item.view_name == LIGHTMAP else {"full": image + item.direct}
        return {"indirect": image, **full}

    def error_split(self, item: TestItem, image: Tensor, method: Any) -> dict[str, float]:
        """Beside the metrics, in texture space: relative error, negative texels, and the basis' own error.

        ``rmse/bound`` is what is left of the reference when it is projected into the method's basis (Figure
        14, dashed): no transfer from direct light can do better.
        """
        if item.view_name != LIGHTMAP or method.component.value != "indirect":
            return {}
        hit = item.gbuffer.hit
        reference = item.references["indirect"].reshape(-1, 3)[hit]
        predicted = image.reshape(-1, 3)[hit]
        size = float(reference.norm()) or 1.0
        found = {
            "rmse/relative": float((predicted - reference).norm()) / size,
            "negative/share": float((predicted < 0).any(dim=1).float().mean()),
        }
        if hasattr(method, "project"):
            whole = item.references["indirect"]
            bound = item.gbuffer.image(method.project(reference, item.lighting))
            found["rmse/bound"] = float((bound - whole).double().square().mean().sqrt())
            wrong = float((image - whole).double().square().mean().sqrt())
            found["rmse/over_bound"] = wrong / found["rmse/bound"] if found["rmse/bound"] > 0 else math.nan
        return found

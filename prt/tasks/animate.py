"""Task ``animate``: lights, materials and objects of a scene move with a vector v in [0, 1]^n, and the view
is free; predicted is the full radiance (Su 2024)."""

import dataclasses
import functools
import itertools
import math
from collections import Counter
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.light.own import OwnLights
from prt.metrics.registry import evaluate
from prt.progress import track
from prt.scene.capture import capture
from prt.scene.gbuffer import GBuffer
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene
from prt.scene.stage import Stage
from prt.scene.view import View
from prt.tasks.test_item import TestItem, floor_of
from prt.trace.denoise import denoise
from prt.trace.reference import render_parts

#: raise when the content of the cache changes for equal settings
FRAME_VERSION = 1
#: added to seeds of references, so that no method shares their random numbers
REFERENCE_SEED = 9_000_000
#: how far outside of the cube the states of the split ``outside`` lie
BEYOND = 0.25
#: splits whose states are drawn: they are seen by the same cameras, and so can be compared
RANDOM = ("inside", "corners", "outside")


class Animate:
    """The task; settings as in ``conf/task/animate.yaml``.

    Args:
        scene: a :class:`Scene` with lights of its own, and an animation (without one, n = 0).
        lighting: :class:`OwnLights`.
        states: test states, uniform in the cube, each seen from a view of its own (split ``inside``).
        corners: test states at corners of the cube, seen from the same views.
        outside: test states with one variable beyond the cube by a quarter of its range; the same views.
        path_steps: states along a line through the cube from one view, for flicker; 0 for none.
        given: further test states, listed (split ``given``), each from a further view.
        size: pixels a side.
        spp: paths a pixel of a reference, both halves together.
        reference_denoise: denoise each half of a reference with its G-buffer; ``mape/noise`` is what is left.
        path_spp: of the references along the path, the same random numbers for all.
        max_depth: surface bounces of references and of path tracing. The equation that radiosity solves has
            all of them: eight are 4 % too dark in a white box.
        seed: of test states and references.

    Raises:
        PrtError: for a setting out of range or a lighting that is not the scene's own.
    """

    name = "animate"
    components = ("full",)
    #: the image a method makes is what it shows; path tracing has its own denoised variant
    denoise_after = False

    def __init__(
        self, scene: Scene, lighting: Any, name: str, states: int, corners: int, outside: int,
        path_steps: int, given: list[list[float]] | None, size: int, spp: int, path_spp: int,
        reference_denoise: bool, max_depth: int, seed: int = 0,
    ):  # fmt: skip
        if not isinstance(lighting, OwnLights):
            raise PrtError(
                "task=animate takes the scene's own lights: lighting=own (the default with this task)"
            )
        for setting, value, least in (
            ("states", states, 0), ("corners", corners, 0), ("outside", outside, 0),
            ("path_steps", path_steps, 0), ("size", size, 8), ("spp", spp, 2), ("path_spp", path_spp, 2),
            ("max_depth", max_depth, 1),
        ):  # fmt: skip
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise PrtError(f"task.{setting}={value!r} must be an integer of at least {least}")
        self.scene, self.lighting, self.seed = scene, lighting, seed
        self.states, self.corners, self.outside, self.path_steps = states, corners, outside, path_steps
        self.given = [list(map(float, v)) for v in given or []]
        self.size, self.spp, self.path_spp, self.max_depth = size, spp, path_spp, max_depth
        self.reference_denoise = bool(reference_denoise)
        self._noise: dict[tuple[str, str, str], float] = {}

    # ---- the scene

    @functools.cached_property
    def stage(self) -> Stage:
        """The live scene that methods move and trace."""
        return Stage(self.scene)

    @property
    def dimension(self) -> int:
        """n."""
        return self.stage.animation.dimension

    @functools.cached_property
    def bounds(self) -> tuple[list[float], list[float]]:
        """Corners of a box that holds the geometry in all states: of a few that reach furthest, and a little
        more."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        n = self.dimension
        ends = [np.zeros(n), np.ones(n), *np.eye(n), *(1 - np.eye(n))] if n else [np.zeros(0)]
        for v in ends:
            self.stage.set(v.tolist())
            box = self.stage.mi_scene.bbox()
            low, high = np.minimum(low, list(box.min)), np.maximum(high, list(box.max))
        more = 1e-3 * np.linalg.norm(high - low)
        return (low - more).tolist(), (high + more).tolist()

    def walk_views(self) -> list[View]:
        """Views from which methods may find out what can be seen; none is tested."""
        return self.scene.views("train", 8, 48)

    def training_views(self, count: int, size: int) -> list[View]:
        """Views of images that a method may ask to be rendered for training."""
        return self.scene.views("train", count, size)

    def render(self, v: Float[Tensor, "n"], view: View, spp: int, seed: int) -> Float[Tensor, "H W 3"]:
        """A path-traced image with everything that is seen, lamps and background too."""
        self.stage.set(v)
        found = render_parts(self.stage.mi_scene, {"full": self._integrator}, view, spp, seed)
        return torch.from_numpy(found["full"]).float()

    @functools.cached_property
    def _integrator(self) -> Any:
        # D surface bounces are Mitsuba's max_depth D + 1
        return mitsuba().load_dict({"type": "path", "max_depth": self.max_depth + 1})

    # ---- what is judged

    def test_states(self) -> list[tuple[str, str, list[float]]]:
        """Split, name and v of every test state.

        Those inside are the same for any number of them; corners and states outside go through the
        variables in turn.
        """
        n, found = self.dimension, []
        rng = np.random.default_rng([self.seed, n])
        found += [("inside", f"v{i:02d}", rng.random(n).tolist()) for i in range(self.states)]
        corner_rng = np.random.default_rng([self.seed, n, 1])
        corners = [tuple(row) for row in itertools.product((0.0, 1.0), repeat=n)] if n <= 6 else []
        for i in range(self.corners if n else 0):
            if corners:
                v = corners[int(corner_rng.integers(len(corners)))]
                corners.remove(v)
            else:
                v = tuple(corner_rng.integers(0, 2, n).astype(float))
            found.append(("corners", f"corner{i:02d}", list(v)))
        for i in range(self.outside if n else 0):
            v = rng.random(n)
            v[i % n] = 1 + BEYOND if (i // n) % 2 == 0 else -BEYOND
            found.append(("outside", f"outside{i:02d}", v.tolist()))
        for i in range(self.path_steps if n else 0):
            share = 0.2 + 0.02 * i
            found.append(("path", f"step{i:02d}", [share] * n))
        for i, v in enumerate(self.given):
            if len(v) != n:
                raise PrtError(f"task.given[{i}] has {len(v)} values; the scene has {n} variables")
            found.append(("given", f"given{i:02d}", v))
        return found

    def check_tests(self) -> None:
        """Find mistakes in the settings of the test states before anything is fitted.

        Raises:
            PrtError: for states of another number of values than the scene has variables, or none at all.
        """
        if not self.test_states():
            raise PrtError("task=animate has no test states; raise task.states")

    def tests(self) -> list[TestItem]:
        """Test states with references; cached one by one."""
        return self._tests

    @functools.cached_property
    def _tests(self) -> list[TestItem]:
        self.check_tests()
        states = self.test_states()
        counts = Counter(split for split, _, _ in states)
        alike = max(counts[split] for split in RANDOM)
        views = self.scene.views("far", max(alike + counts["given"], 1), self.size)
        seen: Counter[str] = Counter()
        jobs = []
        for split, name, v in states:
            # random states of every kind are seen by the same cameras, given ones by further ones
            place = 0 if split == "path" else seen[split] + (alike if split == "given" else 0)
            seen[split] += 1
            jobs.append((split, name, v, f"view{place:02d}", views[place]))
        return [self._item(*job) for job in track(jobs, f"references, {self.scene.name}", len(jobs))]

    @functools.cached_property
    def _fingerprint(self) -> dict[str, Any]:
        return self.scene.lit_fingerprint()

    def _rendered(self, split: str, v: list[float], view: View) -> dict[str, Tensor]:
        """G-buffer and two halves of the reference of a test item, from the cache where they are there."""
        spp = self.path_spp if split == "path" else self.spp
        settings = {
            "scene": self._fingerprint, "v": v, "view": dataclasses.asdict(view), "spp": spp,
            "seed": self.seed, "max_depth": self.max_depth, "denoise": self.reference_denoise,
        }  # fmt: skip

        def build() -> dict[str, Tensor]:
            self.stage.set(v)
            gbuffer = capture(self.stage.mi_scene, view)
            found = gbuffer.tensors()
            for half in (0, 1):
                seed = REFERENCE_SEED + 2 * self.seed + half
                image = self.render(torch.tensor(v), view, max(spp // 2, 1), seed)
                found[f"half.{half}"] = (
                    denoise(image, **gbuffer.guides()) if self.reference_denoise else image
                )
            return found

        return cached("animated_frame", FRAME_VERSION, settings, build)

    def _item(self, split: str, name: str, v: list[float], view_name: str, view: View) -> TestItem:
        found = self._rendered(split, v, view)
        gbuffer = GBuffer.from_tensors(found, view)
        # the background is no part of a reference, nor of a method's image
        shown = gbuffer.hit.reshape(view.height, view.width, 1)
        halves = [found[f"half.{half}"] * shown for half in (0, 1)]
        # two halves differ by twice the error of their mean
        noise = evaluate(halves[0], halves[1], ["mape"])["mape"] / 2
        self._noise[split, view_name, name] = noise if math.isfinite(noise) else math.nan
        reference = (halves[0] + halves[1]) / 2
        return TestItem(
            split, view_name, name, torch.tensor(v, dtype=torch.float32), gbuffer, {"full": reference},
            {"full": floor_of(*halves)}, torch.zeros_like(reference),
        )  # fmt: skip

    def compose(self, item: TestItem, image: Tensor, component: str) -> dict[str, Tensor]:
        """Methods give all that is scored.

        Raises:
            PrtError: for a method that predicts anything but full radiance.
        """
        if component != "full":
            raise PrtError(f"task {self.name} scores methods that predict full radiance, not {component}")
        return {"full": image}

    def error_split(self, item: TestItem, image: Tensor, method: Any) -> dict[str, float]:
        """The reference's own noise; along a path also the error of the change from the frame before."""
        found = {"mape/noise": self._noise[item.split, item.view_name, item.lighting_name]}
        if item.split == "path":
            along = [other for other in self._tests if other.split == "path"]
            place = [other.lighting_name for other in along].index(item.lighting_name)
            if place > 0:
                before = along[place - 1]
                gbuffer = before.gbuffer
                values = method.shade(gbuffer, method.light(before.lighting)).detach().float().cpu()
                change = image - gbuffer.image(values)
                own = item.references["full"] - before.references["full"]
                found["rmse/step"] = float((change - own).double().square().mean().sqrt())
        return found

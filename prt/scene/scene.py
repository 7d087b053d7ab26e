"""A scene: geometry, materials and camera trajectories; no light."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from prt.errors import PrtError
from prt.scene.animation import Animation
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.view import View

#: from places in [0, 1) along the path to views
Trajectory = Callable[[Sequence[float]], list[View]]
SPLITS = ("train", "near", "far")


class Scene:
    """Base of all scenes; a subclass says how its Mitsuba description is made.

    Args:
        name: one word, used in folder names.
        cameras: for ``train`` and ``far``, a list of trajectories (functions from places in [0, 1) to views);
            ``near`` views are held-out views on the training trajectories.
        max_depth: surface bounces that are traced.
        record: ``bsdf`` where paths find their way out by themselves, ``nee`` where the recorder must add
            next-event samples from the lighting prior (rooms lit through openings).
    """

    #: keyframes of an animated scene; 1 where nothing moves
    poses: int = 1
    #: ``volume`` where light passes through the surface into a medium that scatters it, which takes a
    #: volumetric integrator; None where surfaces only reflect or refract
    medium: str | None = None
    #: what moves in task animate; nothing where a scene names nothing
    animation: Animation = Animation()

    def __init__(
        self,
        name: str,
        cameras: dict[str, list[Trajectory]],
        max_depth: int = 6,
        record: Literal["bsdf", "nee"] = "bsdf",
    ):
        if record not in ("bsdf", "nee"):
            raise PrtError(f"scene.record={record!r} is not one of bsdf, nee")
        if not isinstance(max_depth, int) or max_depth < 2:
            raise PrtError(f"scene.max_depth={max_depth!r} must be an integer of at least 2 (indirect light)")
        self.name, self.max_depth, self.record = name, max_depth, record
        missing = [split for split in ("train", "far") if not (cameras and cameras.get(split))]
        if missing:
            raise PrtError(
                f"scene.cameras has no trajectory for {', '.join(missing)}; list at least one under each"
            )
        # Hydra hands over its own containers: keep plain ones
        self.cameras = {str(split): list(paths) for split, paths in cameras.items()}

    def description(self) -> dict[str, Any]:
        """The scene as a Mitsuba dict without emitters, sensors or integrator."""
        raise NotImplementedError

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON data that determines geometry and materials."""
        raise NotImplementedError

    def posed(self, pose: int) -> "Scene":
        """The scene at keyframe ``pose``; itself at 0. Shapes, faces and their order are the same in all.

        Raises:
            PrtError: if there is no such keyframe.
        """
        if pose not in range(self.poses):
            has = "only pose 0" if self.poses == 1 else f"poses 0 to {self.poses - 1}"
            raise PrtError(f"pose={pose!r}: scene {self.name} has {has}; choose one of them")
        return self

    def load(self, emitter: dict[str, Any] | None = None):
        """The ``mi.Scene`` with exactly this emitter, or with none."""
        return self.load_with({} if emitter is None else {"lighting": emitter})

    def load_with(self, emitters: dict[str, dict[str, Any]]):
        """The ``mi.Scene`` with exactly these emitters, by name.

        Names are free: a shape of the same name gives way, for shapes of a file are called as they like.
        """
        mi = mitsuba()
        content: dict[str, Any] = {"type": "scene"}
        for key, shape in self.description().items():
            while key in emitters or key in content:
                key += "_shape"
            content[key] = shape
        return mi.load_dict({**content, **emitters})

    # ---- task animate: the scene with the lights that are its own

    def lights(self) -> dict[str, Any]:
        """Emitters, and shapes that emit, by name: part of the scene in task animate only."""
        return {}

    def load_lit(self):
        """The ``mi.Scene`` with its own lights; parameters of shapes are named after the shapes.

        Raises:
            PrtError: for a scene without lights of its own.
        """
        lights = self.lights()
        if not lights:
            raise PrtError(
                f"scene {self.name} has no lights of its own, which task=animate needs; choose "
                "cornell_animated, many, or a Mitsuba file with emitters (scene=mitsuba)"
            )
        content = {"type": "scene", **self.description(), **lights}
        for name, part in content.items():
            if hasattr(part, "set_id"):
                part.set_id(name)
        return mitsuba().load_dict(content)

    def lit_fingerprint(self) -> dict[str, Any]:
        """Plain JSON data that determines what every state looks like."""
        return {"scene": self.fingerprint(), "animation": self.animation.fingerprint()}

    def asset(self, texels: int) -> Any:
        """The scene as an asset that a lightmap of about ``texels`` a side is baked for."""
        from prt.scene.asset import SurfaceAsset

        return SurfaceAsset(self, texels)

    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Corners of the bounding box of the geometry, world units."""
        if not hasattr(self, "_bounds"):
            box = self.load().bbox()
            self._bounds = tuple(box.min), tuple(box.max)
        return self._bounds

    def views(self, split: str, count: int, size: int, train_count: int | None = None) -> list[View]:
        """``count`` square views of ``size`` pixels, spread evenly over the split's trajectories.

        ``near`` views lie on the training trajectories halfway between two neighbouring training views, for
        a training set of ``train_count`` views, so none was trained on.
        """
        if split not in SPLITS:
            raise PrtError(f"unknown split {split!r}; choose from {', '.join(SPLITS)}")
        trajectories = self.cameras["far" if split == "far" else "train"]
        many = len(trajectories)
        views: list[View] = []
        for i, trajectory in enumerate(trajectories):
            share = share_of(count, i, many)
            places = [(j + 0.5) / share for j in range(share)]
            if split == "near":
                if train_count is None:
                    raise ValueError("near views are placed between training views: train_count is needed")
                trained = share_of(train_count, i, many)
                places = [(int(place * trained) + 1.0) / trained % 1.0 for place in places]
            views += trajectory(places)
        return [view.resized(size, size) for view in views]


def share_of(count: int, part: int, parts: int) -> int:
    """How many of ``count`` things fall to part number ``part`` when spread evenly."""
    return count // parts + (part < count % parts)


def file_digest(path: Path) -> str:
    """SHA-256 of a file, for fingerprints."""
    return hashlib.sha256(path.read_bytes()).hexdigest()

"""Photographed environment maps from folders of ``.hdr`` and ``.exr`` files.

Split by source map, never by rotation: a share of every training folder is held out, and test lights come
from what is held out and from folders used for testing only. The training side is then turned (Raghavan
2023, section 5: by 120 and 240 degrees), mirrored, and mixed in pairs at random exposures, because few maps
are at hand where the paper had a thousand.
"""

import functools
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light import lamps
from prt.light.cubemap import from_equirect, mirror, rotate, yaw
from prt.light.environments import CachedEnvironments
from prt.light.image_file import SUFFIXES, read_image
from prt.light.lamps import checked_lamps
from prt.light.sanitise import sanitise
from prt.paths import data_file
from prt.progress import track

#: exposures of the two maps of a mix differ by up to this many stops
MIX_STOPS = 2.0


class HdriFolders(CachedEnvironments):
    """Environments from image files.

    Args:
        resolution: R of the cubemaps.
        train_folders, test_folders: folders below ``PRT_DATA``, absolute, or relative to the current folder.
        path: a file or folder of the user's; where given, its maps are the test lights, all of them.
        train_count: training environments; None for every map with its rotations and mirror images, no mixes.
            Fewer than that: unrotated maps come first. More: the rest are mixes of two.
        test_count: test environments, taken in turn from the test folders.
        held_out: share of the maps of a training folder that is kept for testing.
        rotations: yaw angles in degrees of the training environments.
        mirror: also their mirror images.
        lamps: further training environments with one lamp or sun added (``prt.light.lamps``).
        seed: of split and mixes.
        normalise, clamp, mend: see :class:`CachedEnvironments`.

    Raises:
        PrtError: for missing data, too few maps, or a setting out of range.
    """

    def __init__(
        self,
        resolution: int,
        train_folders: Sequence[str] = ("hdri/indoor",),
        test_folders: Sequence[str] = ("hdri/indoor", "hdri/outdoor"),
        path: str | None = None,
        train_count: int | None = None,
        test_count: int = 8,
        held_out: float = 0.2,
        rotations: Sequence[float] = (0, 120, 240),
        mirror: bool = True,
        lamps: int = 0,
        seed: int = 0,
        normalise: bool = True,
        clamp: float | None = None,
        mend: bool = False,
    ):
        super().__init__(resolution, normalise, clamp, mend)
        if train_count is not None and train_count < 1:
            raise PrtError(f"lighting.train_count={train_count} must be at least 1, or null")
        if test_count < 1:
            raise PrtError(f"lighting.test_count={test_count} must be at least 1")
        if not 0 < held_out < 1:
            raise PrtError(f"lighting.held_out={held_out} must lie between 0 and 1")
        if not rotations:
            raise PrtError("lighting.rotations is empty; give [0] for no rotation")
        self.train_folders, self.test_folders = list(train_folders), list(test_folders)
        self.path = Path(path).expanduser() if path else None
        self.train_count, self.test_count, self.held_out = train_count, test_count, held_out
        self.rotations, self.mirror, self.seed = [float(x) for x in rotations], mirror, seed
        self.lamps = checked_lamps(lamps)

    # ---- which maps

    @functools.cached_property
    def train_maps(self) -> list[Path]:
        """Source maps of the training environments."""
        return [path for folder in self.train_folders for path in self._split(folder)[1]]

    @functools.cached_property
    def test_maps(self) -> list[Path]:
        """Source maps of the test environments."""
        if self.path is not None:
            if not self.path.exists():
                raise PrtError(
                    f"lighting.path={self.path} does not exist; give an .hdr or .exr file or a folder"
                )
            return images_in(self.path) if self.path.is_dir() else [self.path]
        trained = {path.stem for path in self.train_maps}
        queues = []
        for folder in self.test_folders:
            maps = self._split(folder)[0] if folder in self.train_folders else self._shuffled(folder)
            queues.append([path for path in maps if path.stem not in trained])
        available = sum(len(queue) for queue in queues)
        if available < self.test_count:
            raise PrtError(
                f"lighting.test_count={self.test_count}, but only {available} maps of "
                f"{', '.join(self.test_folders)} are not trained on; "
                "lower it, raise lighting.held_out or add folders"
            )
        chosen: list[Path] = []
        for turn in range(self.test_count):
            chosen += [queue[turn] for queue in queues if turn < len(queue)]
        return chosen[: self.test_count]

    def _shuffled(self, folder: str) -> list[Path]:
        """The maps of a folder in an order that depends on nothing but their names and the seed."""

        def rank(path: Path) -> str:
            return hashlib.sha256(f"{self.seed}:{path.name}".encode()).hexdigest()

        return sorted(images_in(folder_of(folder)), key=rank)

    def _split(self, folder: str) -> tuple[list[Path], list[Path]]:
        """The maps of a training folder: held out, and trained on."""
        maps = self._shuffled(folder)
        held = math.ceil(self.held_out * len(maps))
        if held == len(maps):
            raise PrtError(f"folder {folder!r} holds {len(maps)} maps, too few to train and to hold some out")
        return maps[:held], maps[held:]

    # ---- environments

    @functools.cached_property
    def _variants(self) -> list[tuple[Path, float, bool]]:
        """Every (map, rotation, mirrored) of the training side: unmirrored and unrotated first."""
        sides = (False, True) if self.mirror else (False,)
        return [(path, turn, side) for side in sides for turn in self.rotations for path in self.train_maps]

    @property
    def _mixes(self) -> int:
        return max((self.train_count or 0) - len(self._variants), 0)

    def names(self, split: str) -> list[str]:
        if split == "test":
            stems = [path.stem for path in self.test_maps]
            return [
                f"{path.parent.name}_{path.stem}" if stems.count(path.stem) > 1 else path.stem
                for path in self.test_maps
            ]
        single = [
            path.stem + (f"_yaw{turn:g}" if turn else "") + ("_mirror" if side else "")
            for path, turn, side in self._variants
        ]
        single = (single + [f"mix{i:04d}" for i in range(self._mixes)])[: self.train_count]
        return single + [f"lamp{i:04d}" for i in range(self.lamps)]

    def describe(self) -> str:
        turns = ", ".join(f"{turn:g}" for turn in self.rotations)
        count = min(len(self._variants), self.train_count or len(self._variants))
        return (
            f"{len(self.train_maps)} training maps turned by {turns} degrees{' and mirrored' * self.mirror}: "
            f"{count} environments, {self._mixes} mixes of two and {self.lamps} with a lamp added; "
            f"{len(self.test_maps)} test maps held out; "
            f"{'unit mean radiance' if self.normalise else 'own exposure'}"
        )

    def split_fingerprint(self, split: str) -> dict[str, Any]:
        maps = self.train_maps if split == "train" else self.test_maps
        content = {"maps": [[path.stem, hashlib.sha256(path.read_bytes()).hexdigest()] for path in maps]}
        if split == "train":
            content |= {
                "count": self.train_count,
                "rotations": self.rotations,
                "mirror": self.mirror,
                "seed": self.seed,
            } | lamps.fingerprint(self.lamps)
        return content

    def build(self, split: str) -> Float[Tensor, "n 6 R R 3"]:
        maps = self.train_maps if split == "train" else self.test_maps
        label = f"read environment maps ({split})"
        source = {path: self._read(path) for path in track(maps, label, len(maps))}
        if split == "test":
            return torch.stack([source[path] for path in maps])
        singles = []
        for path, turn, side in self._variants:
            turned = rotate(source[path], yaw(turn)) if turn else source[path]
            singles.append(mirror(turned) if side else turned)
        plain = torch.stack([*singles, *self._mixed(singles)][: self.train_count])
        return torch.cat([plain, lamps.with_lamps(plain, self.lamps, self.seed)])

    def _read(self, path: Path) -> Float[Tensor, "6 R R 3"]:
        return from_equirect(sanitise(read_image(path), path.stem, self.mend), self.resolution)

    def _mixed(self, singles: list[Tensor]) -> list[Tensor]:
        """Sums of environments of two maps, each normalised, at exposures up to ``MIX_STOPS`` apart."""
        generator = torch.Generator().manual_seed(self.seed)
        maps, out = len(self.train_maps), []
        for _ in range(self._mixes):
            first = int(torch.randint(len(singles), (1,), generator=generator))
            # another map: the variants repeat the maps in the same order
            other = int(torch.randint(max(maps - 1, 1), (1,), generator=generator)) + 1
            block = int(torch.randint(len(singles) // maps, (1,), generator=generator))
            second = block * maps + (first + other) % maps
            stops = (2 * float(torch.rand((), generator=generator)) - 1) * MIX_STOPS
            pair = [one / one.mean().clamp_min(1e-12) for one in (singles[first], singles[second])]
            out.append(pair[0] + 2.0**stops * pair[1])
        return out


def folder_of(name: str) -> Path:
    """A folder by absolute path, relative to the current folder, or below ``PRT_DATA``."""
    path = Path(name).expanduser()
    return path if path.is_dir() else data_file(name)


def images_in(folder: Path) -> list[Path]:
    """The environment maps directly in a folder, by name.

    Raises:
        PrtError: if there are none.
    """
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not found:
        raise PrtError(f"no environment map ({', '.join(SUFFIXES)}) in {folder}")
    return found

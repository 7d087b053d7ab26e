"""Sets of environments: what lights the scene in training, and what it is tested under.

Whatever they are made from, all are sanitised, then scaled to unit mean radiance (over sphere and RGB), so
that no map counts more than another in training; ``normalise=false`` keeps the maps' own exposure.
"""

from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from prt.cache import cached
from prt.errors import PrtError
from prt.light.cubemap import mean_radiance
from prt.light.sanitise import sanitise


@runtime_checkable
class EnvironmentSet(Protocol):
    """Named environments, split so that no test light shares its source with a training light."""

    resolution: int

    def train(self) -> tuple[list[str], Float[Tensor, "n 6 R R 3"]]:
        """Training environments."""
        ...

    def test(self) -> tuple[list[str], Float[Tensor, "m 6 R R 3"]]:
        """Test environments, unseen in training."""
        ...

    def prior(self) -> Float[Tensor, "6 R R 3"]:
        """Mean training environment."""
        ...

    def describe(self) -> str:
        """One line for reports: what the environments are made from."""
        ...

    def fingerprint(self) -> dict[str, Any]:
        """Plain JSON: everything that determines the training environments (for cache keys)."""
        ...


class CachedEnvironments:
    """Base of environment sets: sanitises, clamps, normalises and caches what a subclass builds.

    Args:
        resolution: R of the cubemaps.
        normalise: scale every environment to unit mean radiance; a black one stays black.
        clamp: largest radiance allowed, in multiples of the map's mean; None for no limit. Loses energy.
        mend: replace NaN, infinite and negative values with a warning, where otherwise they are an error.
    """

    #: raise when the content changes for equal settings
    version = 1

    def __init__(
        self, resolution: int, normalise: bool = True, clamp: float | None = None, mend: bool = False
    ):
        if resolution < 2 or resolution & (resolution - 1):
            raise PrtError(
                f"lighting.resolution={resolution} must be a power of two, at least 2 (task.resolution)"
            )
        if clamp is not None and not clamp > 1:
            raise PrtError(
                f"lighting.clamp={clamp} must be above 1 (multiples of a map's mean radiance), or null"
            )
        self.resolution, self.normalise, self.clamp, self.mend = resolution, normalise, clamp, mend
        self._made: dict[str, Tensor] = {}

    def names(self, split: str) -> list[str]:
        """The environments of ``train`` or ``test``, in order."""
        raise NotImplementedError

    def describe(self) -> str:
        """One line for reports: what the environments are made from."""
        raise NotImplementedError

    def build(self, split: str) -> Float[Tensor, "n 6 R R 3"]:
        """Make them; called on a cache miss."""
        raise NotImplementedError

    def split_fingerprint(self, split: str) -> dict[str, Any]:
        """Plain JSON that determines what :meth:`build` makes."""
        raise NotImplementedError

    def train(self) -> tuple[list[str], Float[Tensor, "n 6 R R 3"]]:
        """Names and radiance of the training environments."""
        return self.names("train"), self._load("train")

    def test(self) -> tuple[list[str], Float[Tensor, "m 6 R R 3"]]:
        """Names and radiance of the test environments."""
        return self.names("test"), self._load("test")

    def prior(self) -> Float[Tensor, "6 R R 3"]:
        """Mean of the training environments."""
        return self._load("train").mean(0)

    def fingerprint(self) -> dict[str, Any]:
        """Determines the training environments; the test environments have their own key."""
        return self._settings("train")

    def finish(self, cubemap: Float[Tensor, "6 R R 3"], name: str) -> Float[Tensor, "6 R R 3"]:
        """Sanitise, clamp and normalise one environment."""
        cubemap = sanitise(cubemap, name, self.mend)
        mean = mean_radiance(cubemap).mean()
        if mean <= 0:
            return cubemap
        if self.clamp is not None:
            cubemap = cubemap.clamp(max=self.clamp * float(mean))
            mean = mean_radiance(cubemap).mean()
        return cubemap / mean if self.normalise else cubemap

    def _settings(self, split: str) -> dict[str, Any]:
        return {
            "set": type(self).__name__,
            "version": self.version,
            "split": split,
            "resolution": self.resolution,
            "normalise": self.normalise,
            "clamp": self.clamp,
            "mend": self.mend,
            **self.split_fingerprint(split),
        }

    def _load(self, split: str) -> Tensor:
        if split not in self._made:
            content = cached(
                "environments", self.version, self._settings(split), lambda: self._finished(split)
            )
            self._made[split] = content["radiance"]
        return self._made[split]

    def _finished(self, split: str) -> dict[str, Tensor]:
        raw = self.build(split)
        names = self.names(split)
        return {
            "radiance": torch.stack([self.finish(one, name) for one, name in zip(raw, names, strict=True)])
        }

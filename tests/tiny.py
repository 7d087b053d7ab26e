"""The real task, scenes, lightings and methods at sizes that take a second: what robustness tests run on."""

from pathlib import Path

import torch

from prt.bench.exr import write_exr

RESOLUTION = 8
#: overrides of the real configuration; with :func:`lights` they need no data and trace no rooms
TASK = [
    "scene=cornell_glossy", "budget=smoke", "device=cpu", f"task.resolution={RESOLUTION}",
    "task.train_views=4", "task.train_size=8", "task.train_spp=8", "task.near_views=1", "task.far_views=1",
    "task.test_size=16", "task.reference_spp=4", "task.direct_spp=2", "task.split_spp=4",
    "run.denoise=false", "run.metrics=[psnr,ssim,mae]",
]  # fmt: skip


def write_maps(folder: Path) -> Path:
    """Three training and two test environment maps, 8 x 16 pixels, as EXR files below ``folder``."""
    generator = torch.Generator().manual_seed(11)
    for name in ("train/a", "train/b", "train/c", "test/d", "test/e"):
        write_exr(folder / f"{name}.exr", torch.rand((8, 16, 3), generator=generator) ** 4 + 0.05)
    return folder


def lights(maps: Path, path: Path | str = "null") -> list[str]:
    """Overrides that light with the maps of :func:`write_maps`; ``path`` is what tests are lit by instead."""
    return [
        "lighting=hdri", f"lighting.train_folders=[{maps}/train]",
        f"lighting.test_folders=[{maps}/test]", "lighting.train_count=null", "lighting.test_count=2",
        "lighting.rotations=[0]", f"lighting.path={path}",
    ]  # fmt: skip


def random_cubemap(seed: int = 0, resolution: int = RESOLUTION) -> torch.Tensor:
    """A many-coloured lighting of strong contrast and unit mean."""
    radiance = torch.rand((6, resolution, resolution, 3), generator=torch.Generator().manual_seed(seed)) ** 3
    return radiance / radiance.mean()


class Log:
    """A :class:`prt.methods.base.FitLog` in memory; ``stop_at`` raises there, as an interruption would."""

    def __init__(self, every: int = 1, stop_at: int = 0, kept=None):
        self.every, self.stop_at, self.kept, self.losses = every, stop_at, kept, []

    def start(self, steps, label):
        self.steps = steps

    def step(self, step, **values):
        if step == self.stop_at:
            raise InterruptedError
        self.losses.append(values["loss"])

    def checkpoint_due(self, step):
        return step % self.every == 0 or step == self.steps

    def save(self, step, state):
        import copy

        self.kept = (step, copy.deepcopy(state))

    def resume(self):
        return self.kept

"""A task and a method small enough to run, kill and resume in milliseconds, without Mitsuba."""

import dataclasses
import os
import signal
import time
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from prt.errors import PrtError
from prt.methods.base import Component
from prt.scene.gbuffer import GBuffer
from prt.scene.view import View

SIZE = 8


class FakeScene:
    def __init__(self, name: str = "fake", missing: str | None = None):
        self.name = name
        if missing:
            raise PrtError(f"data file not found: expected {missing}; set PRT_DATA")


class FakeLighting:
    def __init__(self, resolution: int):
        self.resolution = resolution


@dataclasses.dataclass
class FakeItem:
    split: str
    view_name: str
    lighting_name: str
    lighting: Tensor
    gbuffer: GBuffer
    references: dict[str, Tensor]
    noise_floor: dict[str, float]


class FakeTask:
    name = "fake"

    def __init__(self, scene: Any, lighting: Any, resolution: int, items: int = 4, bake_seconds: float = 0.0):
        self.scene, self.lighting, self.resolution = scene, lighting, resolution
        self.items, self.bake_seconds = items, bake_seconds

    def training(self) -> Tensor:
        time.sleep(self.bake_seconds)
        return torch.linspace(-1, 1, 64).reshape(-1, 1)

    def tests(self) -> list[FakeItem]:
        found = []
        for i in range(self.items):
            generator = torch.Generator().manual_seed(i)
            lighting = torch.rand((6, self.resolution, self.resolution, 3), generator=generator)
            view = View((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), width=SIZE, height=SIZE)
            hit = torch.ones(SIZE * SIZE, dtype=torch.bool)
            hit[:5] = False
            count = int(hit.sum())
            fields = {name: torch.rand((count, 3), generator=generator) for name in GBuffer.FIELDS}
            fields["roughness"], fields["uv"] = torch.full((count, 1), 0.5), torch.zeros((count, 2))
            gbuffer = GBuffer(**fields, hit=hit, view=view)
            indirect = gbuffer.image(0.5 + gbuffer.position)
            references = {"indirect": indirect, "full": indirect + 1.0}
            floor = {"indirect": 40.0, "full": 50.0}
            split = "near" if i % 2 else "far"
            found.append(
                FakeItem(split, f"{split}{i:02d}", f"light{i}", lighting, gbuffer, references, floor)
            )
        return found

    def compose(self, item: FakeItem, image: Tensor, component: str) -> dict[str, Tensor]:
        return {component: image, "full": image + 1.0}

    def error_split(self, item: FakeItem, image: Tensor, method: Any) -> dict[str, float]:
        return {"psnr/truncation": 30.0, "negative/share": 0.25}


class FakeMethod:
    """Fits y = sin(3 x) with a tiny network; every random number comes from a generator kept in the state.

    Args:
        nan_at: the step at which the reported loss is NaN, 0 for never.
        fail: raise this text in fit.
    """

    component = Component.INDIRECT
    tasks = frozenset({"fake"})

    def __init__(
        self,
        steps: int = 40,
        width: int = 8,
        rate: float = 0.01,
        sleep: float = 0.0,
        nan_at: int = 0,
        fail: str = "",
        shape: int = 3,
    ):
        self.steps, self.width, self.rate, self.sleep = steps, width, rate, sleep
        self.nan_at, self.fail, self.shape = nan_at, fail, shape
        self.net = torch.nn.Sequential(torch.nn.Linear(1, width), torch.nn.Tanh(), torch.nn.Linear(width, 1))

    def fit(self, task: Any, log: Any, seed: int, device: str) -> None:
        if self.fail:
            raise RuntimeError(self.fail)
        x = task.training()
        torch.manual_seed(seed)
        for layer in (self.net[0], self.net[2]):
            layer.reset_parameters()
        generator = torch.Generator().manual_seed(seed)
        optimiser = torch.optim.Adam(self.net.parameters(), lr=self.rate)
        first, kept = 0, log.resume()
        if kept is not None:
            first, state = kept
            self.net.load_state_dict(state["net"])
            optimiser.load_state_dict(state["optimiser"])
            generator.set_state(state["generator"])
        log.start(self.steps, "fake")
        for step in range(first + 1, self.steps + 1):
            time.sleep(self.sleep)
            rows = torch.randint(len(x), (16,), generator=generator)
            noise = torch.rand(1)  # from the global generator: the runner keeps that too
            loss = (self.net(x[rows]) - torch.sin(3 * x[rows])).square().mean() + 0.01 * noise.sum()
            extra = {"late": float(step)} if step > self.steps // 2 else {}
            log.step(step, loss=float("nan") if step == self.nan_at else loss.item(), **extra)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if log.checkpoint_due(step):
                state = {"net": self.net.state_dict(), "optimiser": optimiser.state_dict()}
                log.save(step, {**state, "generator": generator.get_state()})

    def light(self, lighting: Tensor) -> Tensor:
        return lighting.mean()

    def shade(self, gbuffer: GBuffer, code: Tensor, v: Any = None) -> Tensor:
        time.sleep(self.sleep)
        with torch.no_grad():
            shift = self.net(gbuffer.position[:, :1])
            return (gbuffer.position + shift * code + 0.1 * torch.rand(len(gbuffer), 3))[:, : self.shape]

    def nbytes(self) -> int:
        return sum(p.numel() * 4 for p in self.net.parameters())

    def save(self, path: Path) -> None:
        save_file({name: value.contiguous() for name, value in self.net.state_dict().items()}, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        self.net.load_state_dict(load_file(path))


class MortalMethod(FakeMethod):
    """Kills its own process in mid-fit, once: where the file ``marker`` is not there yet."""

    def __init__(self, marker: str, dies_at: int = 25, **settings: Any):
        super().__init__(**settings)
        self.marker, self.dies_at = Path(marker), dies_at

    def fit(self, task: Any, log: Any, seed: int, device: str) -> None:
        whole = log.step

        def step(number: int, **values: float) -> None:
            whole(number, **values)
            if number == self.dies_at and not self.marker.exists():
                self.marker.touch()
                os.kill(os.getpid(), signal.SIGKILL)

        log.step = step
        super().fit(task, log, seed, device)


class OtherMethod(FakeMethod):
    """A method for another task."""

    tasks = frozenset({"somewhere_else"})


#: what a test writes into its own conf folder
CONF = {
    "task/fake": "{_target_: fakes.FakeTask, resolution: '${by_budget:{smoke:2,laptop:4}}', items: 4, "
    "bake_seconds: 0.0}",
    "scene/fake": "{_target_: fakes.FakeScene, name: fake, missing: null}",
    "scene/fake2": "{_target_: fakes.FakeScene, name: fake2, missing: null}",
    "lighting/fake": "{_target_: fakes.FakeLighting, resolution: '${task.resolution}'}",
    "method/fake": "{_target_: fakes.FakeMethod, steps: 40, width: 8, rate: 0.01, sleep: 0.0, "
    "nan_at: 0, fail: ''}",
    "method/other": "{_target_: fakes.OtherMethod}",
    "method/nowhere": "{_target_: fakes.Nowhere}",
}
CHOICE = ["task=fake", "scene=fake", "lighting=fake", "method=fake", "budget=smoke", "device=cpu",
          "run.denoise=false", "run.metrics=[psnr,mae]"]  # fmt: skip


def write_conf(folder: Path) -> Path:
    """A user's own conf folder with the fakes."""
    for name, text in CONF.items():
        path = folder / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    return folder


def run_child(overrides: list[str], conf: str) -> None:
    """Compose and carry out one run; the target of a process that a test kills."""
    from prt.bench.compose import compose
    from prt.bench.run import run

    os.environ["PRT_CONF_DIRS"] = conf
    torch.set_num_threads(1)
    run(compose(overrides))

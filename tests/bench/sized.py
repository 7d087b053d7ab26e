"""Methods of several sizes whose right size is known, for ``prt select``."""

from pathlib import Path
from typing import Any

import fakes
import torch
from fakes import FakeMethod, FakeTask
from safetensors.torch import load_file, save_file
from torch import Tensor

#: error of the radiance by size: better and better, then no more
ERROR = {1: 0.3, 2: 0.1, 4: 0.03, 8: 0.01, 16: 0.01, 32: 0.01, 64: 0.01}
RANK = 3


class SizedMethod(FakeMethod):
    """Right but for noise of a size that ``width`` decides; as large as its width."""

    def fit(self, task: Any, log: Any, seed: int, device: str) -> None:
        pass

    def shade(self, gbuffer: Any, code: Tensor, v: Any = None) -> Tensor:
        generator = torch.Generator().manual_seed(int(1000 * float(code)))
        sign = torch.randint(2, (len(gbuffer), 3), generator=generator) * 2.0 - 1
        return 0.5 + gbuffer.position + ERROR[self.width] * sign

    def nbytes(self) -> int:
        return 1000 * self.width


class RankedTask(FakeTask):
    """Light transport of rank 3: every pixel's row is a mixture of three patterns of the lighting."""

    def training(self) -> Tensor:
        generator = torch.Generator().manual_seed(0)
        patterns = torch.rand((RANK, 6 * self.resolution**2), generator=generator)
        return torch.rand((200, RANK), generator=generator) @ patterns

    def tests(self) -> list:
        items = super().tests()
        rows = self.training()
        for item in items:
            lit = rows[: len(item.gbuffer)] @ item.lighting.reshape(-1, 3)
            item.references["indirect"] = item.gbuffer.image(lit)
            item.references["full"] = item.references["indirect"] + 1.0
        return items


class RankedMethod(FakeMethod):
    """The rows of transport in their ``terms`` best patterns."""

    def __init__(self, terms: int):
        super().__init__()
        self.terms = terms

    def fit(self, task: Any, log: Any, seed: int, device: str) -> None:
        rows = task.training()
        _, _, vectors = torch.linalg.svd(rows, full_matrices=False)
        self.basis = vectors[: self.terms].contiguous()
        self.coefficients = (rows @ self.basis.T).contiguous()

    def light(self, lighting: Tensor) -> Tensor:
        return self.basis @ lighting.reshape(-1, 3)

    def shade(self, gbuffer: Any, code: Tensor, v: Any = None) -> Tensor:
        return self.coefficients[: len(gbuffer)] @ code

    def nbytes(self) -> int:
        return 4 * (self.basis.numel() + self.coefficients.numel())

    def save(self, path: Path) -> None:
        save_file({"basis": self.basis, "coefficients": self.coefficients}, path)

    def load(self, path: Path, task: Any, device: str) -> None:
        found = load_file(path)
        self.basis, self.coefficients = found["basis"], found["coefficients"]


CONF = {
    "method/sized": "{_target_: sized.SizedMethod, width: 8, _ladder_: [method.width=1, method.width=2, "
    "method.width=4, method.width=8, method.width=16, method.width=32, method.width=64]}",
    "method/ranked": "{_target_: sized.RankedMethod, terms: 1, _ladder_: [method.terms=1, method.terms=2, "
    "method.terms=3, method.terms=4, method.terms=5]}",
    "method/odd": "{_target_: sized.SizedMethod, width: 8, _ladder_: [large]}",
    "task/ranked": "{_target_: sized.RankedTask, resolution: 4, items: 8}",
}


def use(place: Path, monkeypatch: Any) -> None:
    """Work in ``place``, with configurations of these methods beside those of :mod:`fakes`."""
    write_conf(fakes.write_conf(place / "conf"))
    monkeypatch.setenv("PRT_CONF_DIRS", str(place / "conf"))
    monkeypatch.chdir(place)


def write_conf(folder: Path) -> None:
    """Beside those of :mod:`fakes`."""
    for name, text in CONF.items():
        (folder / f"{name}.yaml").write_text(text + "\n")

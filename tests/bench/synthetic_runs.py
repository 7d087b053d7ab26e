"""Run folders with the documented layout and made-up figures, for tests of tables, claims and charts."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from prt.bench.exr import write_exr
from prt.bench.results import Cell
from prt.bench.run_folder import METRIC_COLUMNS, RunFolder

VIEWS, LIGHTS = ("view0", "view1", "view2"), ("studio", "forest")
GAIN = {"wavelet_neural": 4.0, "neural_prt": 0.0, "path_traced": -6.0, "path_traced_denoised": 1.0}
SHADE = {"wavelet_neural": 0.08, "neural_prt": 0.02, "path_traced": 0.07, "path_traced_denoised": 0.09}


def reference(size: int = 32) -> np.ndarray:
    """A smooth, coloured, non-black linear image."""
    y, x = np.mgrid[0:size, 0:size] / size
    return np.stack([0.2 + x, 0.3 + 0.5 * y, 0.25 + 0.3 * np.sin(6 * x) ** 2], axis=-1)


def make_run(
    root: Path,
    scene: str,
    method: str,
    seed: int = 0,
    variant: str = "",
    psnr: float = 26.0,
    lpips: float | None = 0.2,
    state: str = "done",
    floor: float = 60.0,
    spread: float = 0.2,
    images: bool = False,
    denoise: bool = True,
    splits: Sequence[str] = ("near", "far"),
    views: Sequence[str] = VIEWS,
    extra: dict[str, float] | None = None,
    parts: dict[str, float] | None = None,
    bake: float | None = None,
    shade: float | None = None,
) -> Cell:
    """One run folder; figures of an image are ``psnr`` + the method's gain + small fixed differences.

    ``extra`` are further figures of every indirect image, ``parts`` seconds of a method's own parts.
    """
    run = RunFolder(root / "relight_indirect" / scene / method / f"{variant or 'plain'}{seed}")
    cell = Cell(scene, method, variant, seed, "laptop", run)
    if state == "absent":
        return cell
    run.path.mkdir(parents=True)
    (run.path / "config.yaml").write_text(
        "task: {name: relight_indirect, test_size: 32}\nlighting: {name: fake}\n"
    )
    machine = {
        "device": "cpu",
        "device_name": "Test CPU",
        "threads": 2,
        "commit": "0123456789abcdef",
        "dirty": False,
    }
    (run.path / "provenance.json").write_text(json.dumps(machine | {"system": "Linux", "python": "3.11.0"}))
    if state == "failed":
        run.fail("loss became NaN at step 12; lower the learning rate", "traceback")
        return cell
    rng = np.random.default_rng(len(scene) * 7 + seed)
    rows = []
    for split in splits:
        for view in views:
            for light in LIGHTS:
                noise = spread * rng.standard_normal()
                for component in ("full", "indirect"):
                    base = psnr + GAIN.get(method, 0.0) + noise + (3 if component == "full" else 0)
                    for denoised in (False, True)[: 1 + denoise]:
                        value = base + 0.8 * denoised
                        figures = {"psnr": value, "ssim": 1 - 3 / value, "flip": 2 / value}
                        figures["lpips"] = float("nan") if lpips is None else lpips * 26 / value
                        place = (split, view, light, component, "true" if denoised else "false")
                        rows += [(*place, name, repr(float(v))) for name, v in figures.items()]
                        if images:
                            noisy = reference() * (1 + 10 ** (-value / 20) * rng.standard_normal((32, 32, 1)))
                            path = run.image_file(split, view, light, component, denoised)
                            write_exr(path, torch.from_numpy(noisy.astype(np.float32)))
                    rows.append((split, view, light, component, "false", "noise_floor", repr(floor)))
                rows.append((split, view, light, "indirect", "false", "psnr/truncation", repr(44.0 + noise)))
                rows += [(split, view, light, "indirect", "false", name, repr(value * (1 + 0.01 * noise)))
                         for name, value in (extra or {}).items()]  # fmt: skip
    with (run.path / "metrics.csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([METRIC_COLUMNS, *rows])

    def repeated(median: float) -> dict[str, float]:
        return {"median": median, "p95": 1.2 * median, "repetitions": 30}

    timing = {
        "light": repeated(0.004),
        "shade": repeated(shade or SHADE.get(method, 0.05)),
        "gbuffer": repeated(0.003),
    }
    timing |= {"denoise": repeated(0.01)} if denoise else {}
    timing |= {"fit": 480.0 + seed, "bytes": 2_000_000, "device": "cpu", "threads": 2, "pixels": 16384}
    timing |= {name: repeated(value) for name, value in (parts or {}).items()}
    timing |= {"parts": list(parts)} if parts else {}
    timing |= {} if bake is None else {"bake": bake}
    (run.path / "timing.json").write_text(json.dumps(timing))
    (run.path / "DONE").write_text("now\n")
    return cell


def fake_references(cell, split, view, lighting):
    """What TaskReferences would read from the task."""
    return {"full": reference(), "indirect": reference()}

"""Judging a fitted method on the test items of its task: images, metrics, times.

Item by item, and resumable: an item counts as done once its rows stand in metrics.csv.
"""

from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from prt.bench.exr import write_exr
from prt.bench.results import TIME_SCOPES, direction_of
from prt.bench.run_folder import RunFolder
from prt.errors import PrtError
from prt.metrics.registry import evaluate
from prt.metrics.timing import time_repeated
from prt.progress import Bar
from prt.scene.gbuffer import GBuffer

Row = tuple[str, ...]


def evaluate_run(folder: RunFolder, cfg: DictConfig, task: Any, method: Any) -> None:
    """Fill metrics.csv and images/ for every item of ``task.tests()``, going on after those that are done."""
    items, rows = task.tests(), folder.metric_rows()
    if not items:
        raise PrtError("the task has no test items; raise task.near_views or task.far_views")
    done = {row[:3] for row in rows}
    with Bar(f"evaluate {cfg.choice.method}", len(items), sum(key(item) in done for item in items)) as bar:
        for number, item in enumerate(items):
            if key(item) in done:
                continue
            torch.manual_seed(cfg.seed + number)  # a resumed evaluation draws what an uninterrupted one drew
            rows += evaluate_item(folder, cfg, task, method, item)
            folder.write_metrics(rows)
            bar.advance()


def key(item: Any) -> Row:
    """What names a test item in metrics.csv."""
    return str(item.split), str(item.view_name), str(item.lighting_name)


def evaluate_item(folder: RunFolder, cfg: DictConfig, task: Any, method: Any, item: Any) -> list[Row]:
    """Render one test item, keep its images, return its rows."""
    component, names = method.component.value, list(cfg.run.metrics)
    image = render(method, item, str(cfg.device))
    rows = []
    for part, picture in task.compose(item, image, component).items():
        versions = {False: picture} | ({True: denoised(picture, item.gbuffer)} if denoises(cfg, task) else {})
        for flag, version in versions.items():
            if cfg.run.images.save:
                write_exr(folder.image_file(*key(item), part, flag), version)
            rows += image_rows(item, part, flag, version, names)
        rows.append(row(item, part, False, "noise_floor", item.noise_floor[part]))
    if hasattr(task, "error_split"):
        for name, value in task.error_split(item, image, method).items():
            direction_of(name)  # a name nobody defines would be found only by the report, after hours
            rows.append(row(item, component, False, name, value))
    return rows


def denoises(cfg: DictConfig, task: Any) -> bool:
    """Whether images are judged denoised as well: asked for, and images of a kind a denoiser knows."""
    return bool(cfg.run.denoise) and getattr(task, "denoise_after", True)


def render(method: Any, item: Any, device: str) -> Float[Tensor, "H W 3"]:
    """The method's image of an item, in the method's own component.

    Raises:
        PrtError: if ``shade`` returns another shape than (N, 3).
    """
    gbuffer = item.gbuffer.to(device)
    radiance = method.shade(gbuffer, method.light(item.lighting.to(device))).detach().float().cpu()
    if radiance.shape != (len(gbuffer), 3):
        raise PrtError(
            f"{type(method).__name__}.shade returned shape {tuple(radiance.shape)} "
            f"for {len(gbuffer)} points; it must return one RGB radiance per point, (N, 3)"
        )
    return item.gbuffer.image(radiance)


def image_rows(item: Any, component: str, flag: bool, image: Tensor, names: list[str]) -> list[Row]:
    """The rows of one image: every metric against the reference of its component."""
    values = evaluate(image, item.references[component], names)
    return [row(item, component, flag, name, value) for name, value in values.items()]


def row(item: Any, component: str, flag: bool, metric: str, value: float) -> Row:
    return *key(item), component, "true" if flag else "false", metric, repr(float(value))


def denoised(image: Float[Tensor, "H W 3"], gbuffer: GBuffer) -> Float[Tensor, "H W 3"]:
    """Open Image Denoise with guides; pixels that were not finite stay so, that no metric misses them."""
    from prt.trace.denoise import denoise

    bad = ~image.isfinite().all(dim=-1, keepdim=True)
    clean = denoise(torch.where(bad, torch.zeros_like(image), image), **gbuffer.guides())
    return torch.where(bad, torch.full_like(clean, torch.nan), clean)


def time_run(folder: RunFolder, cfg: DictConfig, task: Any, method: Any) -> None:
    """Time light, shade, the method's own parts, denoise and gbuffer on one test item, into timing.json.

    The item is ``task.timed_item()`` where the task has that, else the first. A method with
    ``timed_parts(lighting, gbuffer) -> dict[str, Callable]`` has each of them timed by itself; their names
    are kept in ``parts``, in the method's own order. One with ``sized_parts() -> dict[str, int]`` has the
    bytes of its parts kept in ``sizes``.

    Raises:
        PrtError: if a part has the name of something else in timing.json.
    """
    item = task.timed_item() if hasattr(task, "timed_item") else task.tests()[0]
    device = str(cfg.device)
    gbuffer, lighting = item.gbuffer.to(device), item.lighting.to(device)
    code = method.light(lighting)
    image = item.gbuffer.image(method.shade(gbuffer, code).detach().float().cpu())
    work = {"light": lambda: method.light(lighting), "shade": lambda: method.shade(gbuffer, code)}
    parts = method.timed_parts(lighting, gbuffer) if hasattr(method, "timed_parts") else {}
    machine = {"device": device, "threads": torch.get_num_threads()}
    taken = {*TIME_SCOPES, *machine, "frame", "fit", "bake", "bytes", "pixels", "parts"} & set(parts)
    if taken:
        raise PrtError(
            f"{type(method).__name__}.timed_parts names {', '.join(sorted(taken))}, which means something "
            "else in timing.json; rename it"
        )
    work |= parts
    if denoises(cfg, task):
        work["denoise"] = lambda: denoised(image, item.gbuffer)
    with Bar(f"time {', '.join(work)}, gbuffer", len(work) + 1) as bar:
        found = {}
        for name, function in work.items():
            found[name] = time_repeated(function, cfg.run.repetitions, device=device).to_dict()
            bar.advance()
        scene, view = getattr(task, "mitsuba_scene", None), getattr(item.gbuffer, "view", None)
        if scene is not None and view is not None:
            found["gbuffer"] = time_gbuffer(scene, view, cfg.run.repetitions)
    if parts:
        found["parts"] = list(parts)
    if hasattr(method, "sized_parts"):
        found["sizes"] = method.sized_parts()
    folder.add_timing(**found, **machine, bytes=int(method.nbytes()), pixels=len(gbuffer))


def time_gbuffer(scene: Any, view: Any, repetitions: int) -> dict[str, Any]:
    """Time the primary rays of one view."""
    from prt.scene.capture import capture

    capture(scene, view)
    import drjit

    return time_repeated(lambda: capture(scene, view), repetitions, synchronise=drjit.sync_thread).to_dict()

"""Frame rates of learnt transfer (Dhawal 2022, tables 2 to 4), and how large a network a scene needs.

Called by ``prt table dhawal2022/table2`` and the like. A frame rate does not depend on what the weights are,
so the networks timed here are not trained.
"""

from collections.abc import Callable
from typing import Any

import torch

from prt.errors import PrtError
from prt.methods import gl_context
from prt.methods.base import Silent
from prt.methods.learnt_sh import LearntSh, held_out_error
from prt.methods.network_glsl import sdf_source
from prt.methods.sdf_shader import SdfShader
from prt.methods.transfer_shader import TransferShader
from prt.metrics.timing import device_name, time_repeated
from prt.nn.transfer_network import TransferNetwork
from prt.scene.gbuffer import GBuffer
from prt.trace import sh_shading
from prt.trace.band_error import band_errors, fewest
from prt.trace.sh_shading import ShCode
from prt.trace.transfer import bake

NAME = "learnt_sh"
#: of directions that are no one else's
NOISE_SEED = 9000


def row(metric: str, value: float, variant: str, split: str = "", device: str = "", n: int = 1,
        lo: float | None = None) -> dict[str, Any]:  # fmt: skip
    """A row of ``results.csv``; times and sizes are of the whole method, all else is of direct light."""
    component = "" if metric.startswith(("time/", "bytes/")) else "direct"
    found = {"method": NAME, "device": device, "variant": variant, "metric": metric, "split": split}
    return {**found, "component": component, "value": float(value), "lo": lo, "hi": None, "n": n}


def frame_rate(
    draw: Callable[[], Any], finish: Callable[[], Any] | None, repetitions: int
) -> tuple[float, float]:
    """Frames per second: by the median frame, and by the 95th percentile."""
    taken = time_repeated(draw, repetitions, synchronise=finish)
    return 1 / taken.median, 1 / taken.p95


def network_of(
    task: Any, method: dict[str, Any], neurons: int, layers: int
) -> tuple[LearntSh, TransferNetwork]:
    """The method in this size with an untrained network over the task's surface."""
    model = LearntSh(**{**method, "neurons": neurons, "layers": layers})
    low, high = task.surface.bounds
    generator = torch.Generator().manual_seed(0)
    return model, model.network((list(low), list(high)), task.order**2, generator).eval()


def torch_rates(
    network: TransferNetwork, gbuffers: dict[str, GBuffer], code: ShCode, repetitions: int, variant: str,
    ahead: Callable[[], Any] | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Network and shading in torch on packed hits, on the CPU and where there is one on the GPU.

    Args:
        ahead: what a frame begins with (sphere tracing); on the CPU only.
    """
    rows = []
    for device in ["cpu", *(["cuda"] if torch.cuda.is_available() and ahead is None else [])]:
        net = network.to(device)
        light = ShCode(code.coefficients.to(device), code.matrix.to(device))
        named = (
            device_name(device) if device == "cuda" else f"{device_name()}, {torch.get_num_threads()} threads"
        )
        for material, gbuffer in gbuffers.items():
            here = gbuffer.to(device)

            @torch.no_grad()
            def frame(here: Any = here, net: Any = net, light: Any = light) -> Any:
                if ahead is not None:
                    ahead()
                return sh_shading.shade(net(here.position, here.normal), here, light)

            finish = torch.cuda.synchronize if device == "cuda" else None
            median, slow = frame_rate(frame, finish, repetitions)
            rows.append(row("frames/torch", median, variant, material, named, lo=slow))
    network.to("cpu")
    return rows


def mesh_frames(
    task: Any, method: dict[str, Any], sizes: list[list[int]], repetitions: int = 30
) -> list[dict[str, Any]]:
    """Table 4: frames a second of the fragment shader and of torch, over a G-buffer that is there already.

    A size that does not fit in a shader has no row for it, as in the paper's table.

    Raises:
        PrtError: where there is no OpenGL.
    """
    need_gl()
    items = {item.split: item for item in reversed(task.tests())}
    code = sh_shading.encode(next(iter(items.values())).lighting, task.order, task.windowing)
    rows = []
    for neurons, layers in sizes:
        variant = f"neurons={neurons},layers={layers}"
        _, network = network_of(task, method, neurons, layers)
        rows.append(row("bytes/model", network.nbytes(), variant))
        gbuffers = {material: item.gbuffer for material, item in items.items()}
        rows += torch_rates(network, gbuffers, code, repetitions, variant)
        for material, gbuffer in gbuffers.items():
            try:
                with TransferShader(network, task.order, material) as shader:
                    shader.set_gbuffer(gbuffer)
                    median, slow = frame_rate(lambda s=shader: s.draw(code), shader.finish, repetitions)
                    named = shader.device_name()
                    rows.append(row("frames/glsl", median, variant, material, named, lo=slow))
                    rows.append(row("time/compile", shader.compile_seconds, variant, material, named))
            except PrtError as error:
                print(f"    {variant}, {material}: {error}")
    return rows


def sdf_frames(
    task: Any, method: dict[str, Any], sizes: list[list[int]], repetitions: int = 30
) -> list[dict[str, Any]]:
    """Tables 2 and 3: frames a second, sphere tracing included, of the fragment shader and of torch.

    ``rays/exhausted``: pixels of the shader's image whose ray met the step limit.

    Raises:
        PrtError: for a scene that is no signed distance field or has no GLSL, or where there is no OpenGL.
    """
    need_gl()
    source = sdf_glsl(task.scene)
    items = {item.split: item for item in reversed(task.tests())}
    view = next(iter(items.values())).gbuffer.view
    assert view is not None
    code = sh_shading.encode(next(iter(items.values())).lighting, task.order, task.windowing)
    albedo = [float(part) for part in task.scene.albedo]
    rows = []
    for neurons, layers in sizes:
        variant = f"neurons={neurons},layers={layers}"
        _, network = network_of(task, method, neurons, layers)
        gbuffers = {material: item.gbuffer for material, item in items.items()}
        rows += torch_rates(
            network, gbuffers, code, max(repetitions // 6, 5), variant, lambda: task.surface.capture(view)
        )
        for material in gbuffers:
            black = [0.0] * 3
            colours = (albedo, black) if material == "diffuse" else (black, albedo)
            rough = 1.0 if material == "diffuse" else sh_shading.roughness_of(task.exponent)
            try:
                with SdfShader(source, task.surface.bounds, network, task.order, *colours, rough,
                               material=material) as shader:  # fmt: skip
                    median, slow = frame_rate(lambda s=shader: s.draw(view, code), shader.finish, repetitions)
                    exhausted, named = shader.render(view, code)[2], shader.device_name()
            except PrtError as error:
                print(f"    {variant}, {material}: {error}")
                continue
            rows.append(row("frames/glsl", median, variant, material, named, lo=slow))
            rows.append(row("rays/exhausted", exhausted, variant, material, named))
    return rows


def sdf_glsl(scene: Any) -> str:
    """GLSL of a scene's distance.

    Raises:
        PrtError: for a scene that has none.
    """
    if getattr(scene, "sdf", None) is not None:
        return scene.sdf.glsl()
    network = getattr(scene, "network", None)
    if network is None:
        raise PrtError(
            f"scene={scene.name} has no GLSL: its distance is plain torch code, or it is a mesh; write it as "
            "a prt.scene.sdf.Sdf, or take renderer=torch"
        )
    return sdf_source(network.layers(), network.activation, network.parameter)


def need_gl() -> None:
    """Raises PrtError where there is no OpenGL, with what to install."""
    problem = gl_context.available()
    if problem:
        raise PrtError(problem)


def capacity(
    task: Any, method: dict[str, Any], sizes: list[list[int]], targets: list[float], orders: list[int],
    views: int = 3,
) -> list[dict[str, Any]]:  # fmt: skip
    """Error on points held out against the size of the network, and the smallest that meets each target.

    What the paper leaves open (section 6): "to empirically determine the optimal size of the network".
    ``error/noise`` is the noise of the cast transfer itself: what no network gets below. Beside it the error
    of bands (:func:`bands`).
    """
    rows, met = bands(task, orders, views, targets), []
    points = task.held_out().points
    other = bake(task.surface, points.position, points.normal, task.order, task.directions, NOISE_SEED)
    truth = task.held_out().transfer
    # both estimates have the same noise
    rows.append(row("error/noise", float((other - truth).norm() / truth.norm()) / 2**0.5, ""))
    for neurons, layers in sizes:
        model = LearntSh(**{**method, "neurons": neurons, "layers": layers})
        model.fit(task, Silent(), 0, "cpu")
        variant = f"neurons={neurons},layers={layers}"
        error = held_out_error(task, model)
        rows += [row("error/held_out", error, variant), row("bytes/model", model.nbytes(), variant)]
        met.append((model.nbytes(), error, neurons, layers))
    for target in targets:
        fitting = [entry for entry in met if entry[1] <= target]
        if fitting:  # none: the curve shows why
            size, _, neurons, layers = min(fitting)
            rows.append(row("neurons/chosen", neurons, f"target={target:g}"))
            rows.append(row("layers/chosen", layers, f"target={target:g}"))
            rows.append(row("bytes/chosen", size, f"target={target:g}"))
    return rows


def bands(task: Any, orders: list[int], views: int, targets: list[float]) -> list[dict[str, Any]]:
    """Error of radiance by the number of bands (:func:`prt.trace.band_error.band_errors`), and the fewest
    that meet each target, over the first ``views`` test views."""
    rows = []
    for split in task.materials:
        items = [i for i in task.tests() if i.split == split and int(i.view_name[4:]) < views]
        errors = band_errors(
            task.surface, [(item.gbuffer, item.lighting) for item in items], orders,
            task.reference_directions, task.truth_samples, task.windowing, NOISE_SEED,
        )  # fmt: skip
        rows += [row("error/bands", error, f"order={order}", split) for order, error in errors.items()]
        for target in targets:
            enough = fewest(errors, target)
            if enough is not None:
                rows.append(row("order/chosen", enough, f"order_target={target:g}", split))
    return rows

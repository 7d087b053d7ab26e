"""``prt doctor``: what works on this machine, what is missing, and how to get it."""

import importlib.util
import os
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch

from prt.bench.provenance import PACKAGES, package_version
from prt.errors import PrtError
from prt.paths import DATA_HELP, cache_folder, data_folder

#: what needs no package of its own to run, but adds something
EXTRAS = {
    "hydra_plugins.hydra_ray_launcher": (
        "hydra-ray-launcher",
        "pip install 'prt[ray]' (launcher=ray: runs on a Ray cluster)",
    ),
    "hydra_plugins.hydra_submitit_launcher": (
        "hydra-submitit-launcher",
        "pip install 'prt[submitit]' (launcher=local, slurm: runs as processes, or on Slurm)",
    ),
    "viser": ("viser", "pip install 'prt[view]' (prt view: runs in the browser)"),
    "imageio_ffmpeg": ("imageio-ffmpeg", "pip install 'prt[export]' (prt export: MP4)"),
    "torchvision": ("torchvision", "pip install torchvision lpips (LPIPS weights without PRT_DATA)"),
}
#: folders of PRT_DATA and what they serve
DATA = {
    "hdri": "measured environment maps (lighting=hdri)",
    "lpips": "weights of LPIPS",
    "meshes": "scenes four_animals and armadillo",
    "scenes": "scenes kitchen, diffuse_kitchen and bathroom",
}


@dataclass(frozen=True)
class Finding:
    """One line of the report: ``ok``, ``missing`` (something optional) or ``broken`` (something required)."""

    state: str
    what: str
    detail: str


def main() -> int:
    """Print every check; 0 unless something required is broken, then 1."""
    findings = []
    for title, check in CHECKS.items():
        print(title, flush=True)
        for finding in guarded(check):
            print(f"  {finding.state:<8}{finding.what:<18} {finding.detail}".rstrip(), flush=True)
            findings.append(finding)
    broken = [finding.what for finding in findings if finding.state == "broken"]
    missing = [finding.what for finding in findings if finding.state == "missing"]
    if missing:
        print(f"missing, not required: {', '.join(missing)}")
    print(f"broken: {', '.join(broken)}" if broken else "everything required works")
    return 1 if broken else 0


def guarded(check: Callable[[], list[Finding]]) -> list[Finding]:
    """A check that fails is a finding, not a crash."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return check()
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        return [Finding("broken", check.__name__.replace("_", " "), text)]


def packages() -> list[Finding]:
    found = [
        Finding(
            "ok" if sys.version_info >= (3, 10) else "broken",
            "python",
            f"{sys.version.split()[0]} at {sys.executable}; 3.10 or newer is needed",
        )
    ]
    for name in PACKAGES:
        version = package_version(name)
        if version:
            found.append(Finding("ok", name, version))
        elif name == "karellen-llvm-core":  # only one of the ways to get an LLVM
            found.append(
                Finding(
                    "missing", name, f"pip install {name} (an LLVM for Mitsuba where the system has none)"
                )
            )
        else:
            found.append(Finding("broken", name, f"not installed; pip install {name}, or reinstall prt"))
    return found


def rendering() -> list[Finding]:
    """The variant and its LLVM, and an image of four pixels."""
    from prt.scene.mitsuba_setup import find_llvm, mitsuba

    mi = mitsuba()
    variant = mi.variant()
    found = [Finding("ok", "variant", f"{variant} (PRT_MITSUBA_VARIANT chooses another)")]
    if variant.startswith("scalar"):
        found.append(
            Finding(
                "missing",
                "LLVM",
                "no usable libLLVM: slow, no transport recorder; pip install karellen-llvm-core",
            )
        )
    elif variant.startswith("llvm"):
        found.append(Finding("ok", "LLVM", str(find_llvm())))
    camera = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {"type": "perspective", "to_world": camera,
                   "film": {"type": "hdrfilm", "width": 16, "height": 16}},
        "ball": {"type": "sphere"},
        "light": {"type": "constant"},
    })  # fmt: skip
    started = time.perf_counter()
    image = torch.as_tensor(mi.render(scene, spp=4).numpy())
    seconds = time.perf_counter() - started
    if not image.isfinite().all() or image.max() <= 0:
        return [
            *found,
            Finding(
                "broken",
                "render",
                "a lit sphere came out black or not finite; try PRT_MITSUBA_VARIANT=scalar_rgb",
            ),
        ]
    return [*found, Finding("ok", "render", f"a sphere in {seconds:.2f} s, compilation included")]


def denoiser() -> list[Finding]:
    from prt.trace.denoise import denoise

    image = torch.full((16, 16, 3), 0.5)
    error = float((denoise(image) - image).abs().max())
    state = "ok" if error < 0.1 else "broken"
    return [Finding(state, "Open Image Denoise", f"a grey image comes back within {error:.1e}")]


def glsl() -> list[Finding]:
    """The renderer of ``svd_transfer`` that draws with OpenGL."""
    from prt.methods.blend_shader import device_name

    try:
        return [Finding("ok", "GLSL renderer", f"works with {device_name()}")]
    except PrtError as error:  # optional: svd_transfer blends with torch as well
        return [Finding("missing", "GLSL renderer", str(error))]


def computing() -> list[Finding]:
    found = [
        Finding(
            "ok",
            "CPU",
            f"{os.cpu_count()} cores, torch uses {torch.get_num_threads()} threads (OMP_NUM_THREADS)",
        )
    ]
    if torch.cuda.is_available():
        found.append(Finding("ok", "CUDA", torch.cuda.get_device_name()))
    else:
        found.append(Finding("missing", "CUDA", "torch sees no CUDA device; everything runs on the CPU"))
    return found


def data() -> list[Finding]:
    folder = data_folder()
    if folder is None:
        return [Finding("missing", "PRT_DATA", f"not set; {DATA_HELP}")]
    if not folder.is_dir():
        return [Finding("missing", "PRT_DATA", f"{folder} is no folder; {DATA_HELP}")]
    found = [Finding("ok", "PRT_DATA", str(folder))]
    for name, use in DATA.items():
        part = folder / name
        count = sum(1 for path in part.rglob("*") if path.is_file()) if part.is_dir() else 0
        detail = f"{count} files: {use}" if count else f"expected in {part}: {use}; {DATA_HELP}"
        found.append(Finding("ok" if count else "missing", name, detail))
    return found


def lpips_weights() -> list[Finding]:
    from prt.metrics.lpips import lpips_unavailable

    reason = lpips_unavailable("alex")
    return [
        Finding("missing", "LPIPS", f"{reason}")
        if reason
        else Finding("ok", "LPIPS", "AlexNet weights found")
    ]


def cache() -> list[Finding]:
    """Where caches lie, whether they can be written, how big they are."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PrtError(
            f"{folder} cannot be written ({error.strerror}); set PRT_CACHE to another folder"
        ) from error
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    free = shutil.disk_usage(folder).free
    return [
        Finding(
            "ok", "PRT_CACHE", f"{folder}, {size / 1e6:.0f} MB used, {free / 1e9:.0f} GB free; safe to delete"
        )
    ]


def configuration() -> list[Finding]:
    from prt.bench.compose import GROUPS, choices, conf_folders

    found = [Finding("ok", "conf", ", ".join(map(str, conf_folders())))]
    for group in GROUPS:
        names = choices(group)
        found.append(Finding("ok" if names else "broken", group, ", ".join(names) or "no choices"))
    return found


def extras() -> list[Finding]:
    found = []
    for module, (name, how) in EXTRAS.items():
        try:
            there = importlib.util.find_spec(module) is not None
        except ModuleNotFoundError:
            there = False
        found.append(
            Finding("ok", name, package_version(name) or "") if there else Finding("missing", name, how)
        )
    return found


CHECKS: dict[str, Callable[[], list[Finding]]] = {
    "packages": packages,
    "computing": computing,
    "Mitsuba": rendering,
    "denoising": denoiser,
    "GLSL": glsl,
    "data": data,
    "LPIPS": lpips_weights,
    "cache": cache,
    "configuration": configuration,
    "optional extras": extras,
}

"""Which LLVM is taken, which is refused, and that torch and mitsuba go together in either import order."""

import subprocess
import sys
from pathlib import Path

import pytest

from prt.errors import PrtError
from prt.scene import mitsuba_setup
from prt.scene.mitsuba_setup import OLDEST_LLVM, choose_variant, find_llvm, llvm_version

WORK = """
from prt.scene.mitsuba_setup import mitsuba
mi = mitsuba()
import numpy, drjit as dr
scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}})
sensor = mi.load_dict({"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4,
                       "rfilter": {"type": "box"}}})
image = numpy.array(mi.render(scene, sensor=sensor, integrator=mi.load_dict({"type": "path"}), spp=2))
a = torch.rand(64, 64, requires_grad=True)
(a @ a).sum().backward()
assert abs(image - 1).max() < 1e-5, image
assert torch.isfinite(a.grad).all() and abs(float(dr.sum(mi.Float([1, 2, 3]))[0]) - 6) < 1e-6
print("worked with", mi.variant())
"""


def python(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


def test_torch_then_mitsuba_works_and_the_library_is_found(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    result = python("import torch" + WORK + "\nprint(dr.detail.llvm_version()[0])")
    assert result.returncode == 0 and "worked with" in result.stdout, result.stderr
    if choose_variant().startswith("llvm"):
        assert int(result.stdout.split()[-1]) >= OLDEST_LLVM


def test_mitsuba_then_torch_works(monkeypatch):
    # a Dr.Jit that is imported before prt takes its LLVM from this variable alone
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(find_llvm() or ""))
    result = python("import mitsuba, drjit, torch" + WORK)
    assert result.returncode == 0 and "worked with" in result.stdout, result.stderr


def test_a_drjit_imported_before_that_took_a_bad_library_is_refused(monkeypatch, tmp_path):
    """Kernels of LLVM 15 abort the process (``Cannot select: fmaximum``): better one line."""
    if not choose_variant().startswith("llvm"):
        pytest.skip("this machine runs Mitsuba without LLVM")
    (tmp_path / "libLLVM.so").write_text("no library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    late = "import drjit, os; del os.environ['DRJIT_LIBLLVM_PATH']\n"
    result = python(late + "from prt.scene.mitsuba_setup import mitsuba\nmitsuba()")
    last = result.stderr.splitlines()[-1]
    assert result.returncode == 1 and "PrtError: mitsuba or drjit was imported before prt" in last
    assert "no LLVM" in last and "DRJIT_LIBLLVM_PATH=" in last


@pytest.mark.parametrize(
    ("version", "usable"), [(14, False), (15, False), (16, False), (17, True), (23, True)]
)
def test_the_version_that_drjit_took_decides(monkeypatch, version, usable):
    mitsuba_setup.mitsuba()
    import drjit

    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/usr/lib/libLLVM-23.so")
    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: (version, 0, 6))
    if usable:
        return mitsuba_setup.check_loaded_llvm()
    with pytest.raises(PrtError, match=f"loaded LLVM {version}, but {OLDEST_LLVM} or newer"):
        mitsuba_setup.check_loaded_llvm()


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.23.1", 23), ("libLLVM.so.19.1", 19), ("libLLVM-19.so.1", 19), ("libLLVM-14.so", 14),
        ("libLLVM-15.0.7.so", 15), ("libLLVM-16.so.16", 16), ("libLLVM.so", None),
        ("libLLVMCore.so.19", None), ("libclang-19.so", None), ("libLLVM.so.", None),
    ],
)  # fmt: skip
def test_version_of_a_library_file(name, version):
    assert llvm_version(Path("/somewhere") / name) == version


@pytest.mark.parametrize("version", [13, 14, 15, 16])
def test_versions_known_to_fail_are_refused_before_they_can_abort(monkeypatch, version):
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "llvm_ad_rgb")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", f"/usr/lib/libLLVM-{version}.so")
    with pytest.raises(PrtError, match=f"libLLVM {OLDEST_LLVM} or newer.*libLLVM-{version}.so") as caught:
        mitsuba_setup.mitsuba.__wrapped__()
    assert "karellen-llvm-core" in str(caught.value) and "\n" not in str(caught.value)


def test_a_library_that_is_not_there_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "llvm_ad_rgb")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-19.so"))
    with pytest.raises(PrtError, match="cannot load .*libLLVM-19.so.*DRJIT_LIBLLVM_PATH"):
        mitsuba_setup.mitsuba.__wrapped__()


def test_the_newest_usable_library_is_found_and_old_ones_are_passed_over(monkeypatch, tmp_path):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(mitsuba_setup, "Path", lambda text: tmp_path / str(text).lstrip("/"))
    monkeypatch.setattr(sys, "prefix", "/venv")

    def put(path: str) -> Path:
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        return file

    assert find_llvm() is None
    put("usr/lib/x86_64-linux-gnu/libLLVM-14.so.1")
    put("usr/lib/llvm-16/lib/libLLVM-16.so")
    assert find_llvm() is None
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "auto")
    monkeypatch.setattr(mitsuba_setup.torch.cuda, "is_available", lambda: False)
    assert choose_variant() == "scalar_rgb"
    debian = put("usr/lib/llvm-19/lib/libLLVM.so.19.1")
    assert find_llvm() == debian and choose_variant() == "llvm_ad_rgb"
    wheel = put("venv/lib/libLLVM.so.23.1")
    assert find_llvm() == wheel
    # the user's choice stands
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", f"/{debian.relative_to(tmp_path)}")
    assert find_llvm() == debian


def test_an_unknown_variant_is_refused(monkeypatch):
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "cuda_rgb")
    with pytest.raises(PrtError, match="cuda_rgb.*llvm_ad_rgb"):
        choose_variant()


def test_scalar_mode_serves_with_a_warning(monkeypatch):
    code = "import warnings\nfrom prt.scene.mitsuba_setup import mitsuba\nprint(mitsuba().variant())"
    monkeypatch.setenv("PRT_MITSUBA_VARIANT", "scalar_rgb")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert result.stdout.strip() == "scalar_rgb" and "several times slower" in result.stderr, result.stderr

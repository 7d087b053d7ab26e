"""LPIPS against values computed by others: the ``lpips`` package 0.1.4, torchmetrics 1.9.0's docstrings."""

import numpy as np
import pytest
import torch

from prt.metrics import lpips as module
from prt.metrics import registry
from prt.metrics.lpips import distance, lpips, lpips_unavailable
from prt.metrics.registry import evaluate
from prt.paths import data_folder


@pytest.fixture
def weights():
    folder = data_folder()
    if folder is None or not (folder / "lpips" / "alex.safetensors").exists():
        pytest.skip("needs PRT_DATA with lpips/alex.safetensors and lpips/squeeze.safetensors")


def noise(count: int, seed: int = 42) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.rand(count, 3, 100, 100, generator=generator) * 2 - 1 for _ in range(2)]


def pattern() -> tuple[np.ndarray, np.ndarray]:
    """(prediction, reference): a smooth image, and the same with waves laid over it."""
    y, x = np.mgrid[0:72, 0:96]
    reference = np.stack([x / 95, y / 71, 0.5 + 0.5 * np.sin(x / 7) * np.cos(y / 5)], -1)
    return np.clip(reference + 0.1 * np.sin(x / 3 + y / 4)[..., None], 0, 1), reference


def test_squeeze_equals_torchmetrics_docstrings(weights):
    # torchmetrics.functional.image.lpips: two images a side from a generator seeded 42, values one by one
    assert distance(*noise(2), "squeeze").numpy() == pytest.approx([0.1024, 0.0938], abs=5e-5)
    # same docstring: the mean over ten images a side, seed 42. (0.1024 in the docstring of the class is for
    # other images: building the class draws random numbers between the seed and the images.)
    assert float(distance(*noise(10), "squeeze").mean()) == pytest.approx(0.1005, abs=5e-5)


def test_alexnet_equals_the_lpips_package(weights):
    # golden numbers from lpips.LPIPS(net="alex"), version 0.1.4, on the same inputs
    assert distance(*noise(2), "alex").numpy() == pytest.approx([0.131169, 0.141963], abs=2e-6)
    assert lpips(*pattern()) == pytest.approx(0.144634, abs=2e-6)


def test_lpips_is_zero_for_equal_images_and_symmetric(weights):
    prediction, reference = pattern()
    assert lpips(reference, reference) == 0
    assert lpips(prediction, reference) == pytest.approx(lpips(reference, prediction), rel=1e-5)


def test_evaluate_hands_lpips_the_srgb_image(weights):
    from prt.metrics.tonemap import to_srgb

    prediction, reference = pattern()
    found = evaluate(prediction, reference, ["lpips"], exposure=0.7)["lpips"]
    assert found == pytest.approx(lpips(to_srgb(prediction, 0.7), to_srgb(reference, 0.7)), abs=1e-7)
    assert abs(found - lpips(prediction, reference)) > 1e-3


def test_a_small_image_has_no_lpips(weights, monkeypatch):
    monkeypatch.setattr(registry, "_warned", set())
    image = np.ones((62, 80, 3))
    with pytest.warns(UserWarning, match="at least 63 pixels"):
        assert np.isnan(evaluate(image, image, ["lpips"])["lpips"])
    assert evaluate(np.ones((63, 80, 3)), np.ones((63, 80, 3)), ["lpips"])["lpips"] == 0


def test_without_weights_the_reason_is_given_and_no_number(monkeypatch):
    monkeypatch.delenv("PRT_DATA", raising=False)
    monkeypatch.setattr(registry, "_warned", set())
    monkeypatch.setattr(module, "_load", module._load.__wrapped__)
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda name: None)
    reason = lpips_unavailable()
    assert reason is not None and "PRT_DATA" in reason and "prt[lpips]" in reason and "\n" not in reason
    image = np.ones((64, 64, 3))
    with pytest.warns(UserWarning, match="PRT_DATA"):
        assert np.isnan(evaluate(image, image, ["lpips"])["lpips"])


def test_damaged_weights_are_named(monkeypatch, tmp_path):
    (tmp_path / "lpips").mkdir()
    (tmp_path / "lpips" / "alex.safetensors").write_bytes(b"\x10" * 100)
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    assert "alex.safetensors" in (lpips_unavailable() or "")

import warnings

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.metrics import registry
from prt.metrics.registry import METRICS, evaluate
from prt.metrics.tonemap import exposure_of, srgb_oetf, to_srgb

NO_WEIGHTS_NEEDED = ["psnr", "ssim", "flip", "mape", "mae", "rmse"]


@pytest.fixture
def images():
    """A smooth reference with a black background, and a prediction with noise of two percent."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:48, 0:64] / 64
    reference = np.stack([2 * x, 1 + y, 0.5 + 0.5 * np.sin(9 * x)], axis=-1)
    reference[:8] = 0
    return reference + 0.02 * rng.normal(size=reference.shape), reference


def test_exposure_maps_the_95th_percentile_of_lit_pixels_to_0_8():
    image = np.zeros((20, 10, 3))
    image[:10, :, 1] = np.arange(1, 101).reshape(10, 10)  # half the pixels black
    image[:10, :, 0] = 0.5
    assert exposure_of(image) == pytest.approx(0.8 / np.percentile(np.arange(1, 101), 95))
    assert exposure_of(torch.from_numpy(image)) == exposure_of(image)
    assert exposure_of(np.zeros((4, 4, 3))) == 1.0


def test_srgb_known_values():
    # IEC 61966-2-1: middle grey 0.5 encodes to 0.735357; the two pieces meet at 0.0031308
    linear = np.array([0.0, 0.001, 0.0031308, 0.5, 1.0])
    assert srgb_oetf(linear) == pytest.approx([0.0, 0.01292, 0.04045, 0.735357, 1.0], abs=1e-5)
    assert to_srgb(np.full((1, 1, 3), -1.0), 1.0).max() == 0.0
    assert to_srgb(np.full((1, 1, 3), 9.0), 1.0) == pytest.approx(1.0)


def test_psnr_of_a_known_error():
    # a constant image of exposed value 0.8, and one whose encoded value is off by exactly 0.1
    reference = np.full((16, 16, 3), 3.0)
    encoded = srgb_oetf(np.array(0.8)) - 0.1
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    prediction = np.full((16, 16, 3), linear * 3.0 / 0.8)
    assert evaluate(prediction, reference, ["psnr"])["psnr"] == pytest.approx(20.0)


def test_linear_errors_by_hand():
    reference = np.ones((2, 2, 3))
    prediction = reference.copy()
    prediction[0, 0] = [3.0, 0.0, 1.0]
    found = evaluate(prediction, reference, ["mae", "rmse", "mape"])
    assert found["mae"] == pytest.approx(3 / 12)
    assert found["rmse"] == pytest.approx(np.sqrt(5 / 12))
    assert found["mape"] == pytest.approx(3 / 1.01 / 12)


def test_linear_metrics_see_what_clipping_hides():
    reference = np.ones((16, 16, 3))
    a, b = reference * 10, reference * 20
    first, second = (evaluate(p, reference, ["psnr", "rmse"]) for p in (a, b))
    assert first["psnr"] == second["psnr"]
    assert second["rmse"] > 2 * first["rmse"]


def test_ssim_is_scikit_images(images):
    from skimage.metrics import structural_similarity

    prediction, reference = images
    exposure = exposure_of(reference)
    want = structural_similarity(
        to_srgb(prediction, exposure), to_srgb(reference, exposure), gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, data_range=1.0, channel_axis=2,
    )  # fmt: skip
    assert evaluate(*images, ["ssim"])["ssim"] == pytest.approx(want, abs=1e-12)
    assert 0.3 < want < 0.999


def test_flip_of_far_and_near_greys():
    black, white = np.zeros((16, 16, 3)), np.ones((16, 16, 3))
    assert evaluate(black, white, ["flip"])["flip"] > 0.9
    assert evaluate(white * 0.99, white, ["flip"])["flip"] < 0.05


@pytest.mark.parametrize("name", NO_WEIGHTS_NEEDED)
def test_every_metric_orders_a_small_before_a_large_error(images, name):
    prediction, reference = images
    worse = reference + 5 * (prediction - reference)
    small, large = (evaluate(p, reference, [name])[name] for p in (prediction, worse))
    assert small > large if METRICS[name].direction == "higher" else small < large


def test_identical_images(images):
    _, reference = images
    found = evaluate(reference, reference, NO_WEIGHTS_NEEDED)
    want = {"psnr": 99, "ssim": 1, "flip": 0, "mape": 0, "mae": 0, "rmse": 0, "bad_pixels": 0}
    assert found == pytest.approx(want, abs=1e-6)


def test_numpy_and_torch_agree(images):
    as_torch = [torch.from_numpy(image) for image in images]
    assert evaluate(*as_torch, NO_WEIGHTS_NEEDED) == evaluate(*images, NO_WEIGHTS_NEEDED)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_bad_pixels_are_counted_and_count_as_black(images, value):
    prediction, reference = images
    broken, black = prediction.copy(), prediction.copy()
    broken[20, 5, 1] = broken[30, 7] = value
    black[20, 5] = black[30, 7] = 0
    found = evaluate(broken, reference, NO_WEIGHTS_NEEDED)
    assert found.pop("bad_pixels") == 2
    want = evaluate(black, reference, NO_WEIGHTS_NEEDED)
    assert want.pop("bad_pixels") == 0
    assert found == want
    assert found["psnr"] < evaluate(prediction, reference, ["psnr"])["psnr"]


def test_no_metric_is_nan_on_black_and_huge_images():
    rng = np.random.default_rng(1)
    noise, black = rng.random((16, 16, 3)), np.zeros((16, 16, 3))
    for pair in ((noise, black), (black, noise), (black, black), (noise * 1e30, noise), (-noise, noise)):
        assert np.isfinite(list(evaluate(*pair, NO_WEIGHTS_NEEDED).values())).all()


def test_exposure_can_be_given(images):
    dim = evaluate(*images, ["psnr"], exposure=0.01)["psnr"]
    assert dim > evaluate(*images, ["psnr"])["psnr"] + 5


@pytest.mark.parametrize("names", [["psnrr"], ["PSNR"]])
def test_unknown_metric_lists_the_known(images, names):
    with pytest.raises(PrtError, match="psnr, ssim, lpips"):
        evaluate(*images, names)


def test_wrong_shapes_and_bad_references_are_errors(images):
    prediction, reference = images
    with pytest.raises(PrtError, match="one image size"):
        evaluate(prediction[:-1], reference)
    with pytest.raises(PrtError, match=r"\(H, W, 3\)"):
        evaluate(prediction[..., 0], reference)
    with pytest.raises(PrtError, match="non-empty"):
        evaluate(prediction[:0], reference[:0])
    reference[3, 4, 0] = np.nan
    with pytest.raises(PrtError, match="reference has 1 pixels"):
        evaluate(prediction, reference)


def test_unavailable_metric_is_nan_with_its_reason_once(images, monkeypatch):
    monkeypatch.setattr(registry, "_warned", set())
    small = [image[20:28, :8] for image in images]
    with pytest.warns(UserWarning, match="SSIM .* at least 11 pixels"):
        assert np.isnan(evaluate(*small, ["ssim"])["ssim"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(evaluate(*small, ["ssim"])["ssim"])


def test_every_metric_says_what_it_is():
    assert list(METRICS) == ["psnr", "ssim", "lpips", "flip", "mape", "mae", "rmse"]
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.direction in ("higher", "lower") and metric.domain in ("srgb", "linear")
        assert metric.definition.endswith(".") and "\n" not in metric.definition

"""The lobe in harmonics against its limits and against Mitsuba's own GGX."""

import math

import numpy as np
import pytest
import torch

from prt.light.glossy_lobe import cosine_bands, lobe_above, lobe_bands, lobe_reflectance
from prt.scene.mitsuba_setup import mitsuba

COUNT = 40000


def reflected(sigma: float, cosine: float):
    """Directions that GGX of reflectance 1 sends light to, and the weights of these samples."""
    mi = mitsuba()
    bsdf = mi.load_dict(
        {"type": "roughconductor", "material": "none", "alpha": sigma**2, "distribution": "ggx"}
    )
    random = np.random.default_rng(0).random((3, COUNT)).astype(np.float32)
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(math.sqrt(1 - cosine**2), 0, cosine)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(random[0]), mi.Point2f(random[1:]))
    return torch.from_numpy(np.array(sample.wo).T), torch.from_numpy(np.array(weight).T[:, 0])


def test_a_mirror_keeps_all_bands_and_a_rough_lobe_few():
    bands = lobe_bands(torch.tensor([[0.0], [0.3], [1.0]]), 9)
    assert torch.allclose(bands[0], torch.ones(9)) and torch.allclose(bands[:, 0], torch.ones(3))
    assert (bands[1].diff() < 0).all() and 0.2 < bands[1, 8] < 0.6
    assert bands[2, 3:].abs().max() < 0.1


@pytest.mark.parametrize("sigma", [0.25, 0.5, 0.75])
def test_bands_are_those_of_the_renderers_lobe_along_the_normal(sigma):
    wo, weight = reflected(sigma, 1.0)
    bands = lobe_bands(torch.tensor([[sigma]]), 6)[0]
    for l in range(6):
        legendre = torch.from_numpy(np.polynomial.legendre.Legendre.basis(l)(wo[:, 2].double().numpy()))
        assert float((weight * legendre).sum() / weight.sum()) == pytest.approx(float(bands[l]), abs=0.01)


@pytest.mark.parametrize("cosine", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("sigma", [0.25, 0.5, 0.75])
def test_reflectance_is_the_renderers(sigma, cosine):
    _, weight = reflected(sigma, cosine)
    found = lobe_reflectance(torch.ones(1, 3), torch.tensor([[sigma]]), torch.tensor([cosine]))
    assert torch.allclose(found, weight.mean().expand(1, 3), atol=0.015)


def test_reflectance_grows_at_grazing_angles_and_black_stays_black():
    specular = torch.tensor([[0.04, 0.0, 1.0]]).repeat(2, 1)
    found = lobe_reflectance(specular, torch.full((2, 1), 0.1), torch.tensor([1.0, 0.1]))
    assert found[0, 0] == pytest.approx(0.04, abs=0.003) and found[1, 0] > 0.4
    assert (found[:, 1] == 0).all() and (found[:, 2] > 0.95).all()


def test_a_rough_lobe_loses_to_the_horizon_what_an_integral_says():
    """Mean over the lobe, turned to the reflected direction, of what lies above the surface."""
    sigma, cosine = 0.6, 0.3
    wo, weight = reflected(sigma, 1.0)
    tilted = math.sqrt(1 - cosine**2) * wo[:, 0] + cosine * wo[:, 2]
    # the sharp horizon, without bands: many bands come close
    expected = float((weight * (tilted > 0)).sum() / weight.sum())
    found = lobe_above(torch.tensor([[sigma]]), torch.tensor([cosine]), 30)
    assert float(found) == pytest.approx(expected, abs=0.01)


def test_cosine_bands_are_those_of_the_literature():
    assert torch.allclose(cosine_bands(7), torch.tensor([1, 2 / 3, 1 / 4, 0, -1 / 24, 0, 1 / 64]), atol=1e-6)

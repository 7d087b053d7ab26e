"""Lightings unlike training: what each of them is."""

import pytest
import torch

from prt.errors import PrtError
from prt.light.cubemap import mean_radiance
from prt.light.unlike import KINDS, unlike


@pytest.fixture
def environment():
    return torch.rand((6, 8, 8, 3), generator=torch.Generator().manual_seed(0)) + 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_a_lighting(environment, kind):
    out = unlike(environment, kind)
    assert out.shape == environment.shape and bool(out.isfinite().all()) and float(out.min()) >= 0


@pytest.mark.parametrize("kind", ["sun", "texel"])
def test_a_sun_keeps_the_light_there_is(environment, kind):
    out = unlike(environment, kind)
    assert mean_radiance(out).mean() == pytest.approx(float(mean_radiance(environment).mean()), rel=1e-4)
    brightest = out.sum(-1).flatten().sort(descending=True).values
    assert brightest[0] > 20 * brightest[1]
    assert (brightest[1] == 0) == (kind == "texel")


def test_red_and_black_and_bright(environment):
    red = unlike(environment, "red")
    assert torch.allclose(red[..., 1], environment[..., 1] * 0.05) and torch.equal(
        red[..., 0], environment[..., 0]
    )
    assert not unlike(environment, "black").any()
    assert torch.allclose(unlike(environment, "bright"), environment * 1000)


def test_an_unknown_kind_is_named(environment):
    with pytest.raises(PrtError, match="'green' is not one of same, sun"):
        unlike(environment, "green")

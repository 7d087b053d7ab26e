import pytest
import torch

from prt.errors import PrtError
from prt.light.sanitise import sanitise


def grey(R=4):
    return torch.full((6, R, R, 3), 0.5)


@pytest.mark.parametrize(
    "value, word",
    [
        (float("nan"), "1 NaN"),
        (float("inf"), "1 infinite"),
        (-float("inf"), "1 infinite"),
        (-0.1, "1 negative"),
    ],
)
def test_bad_texels_are_refused_by_name_with_count_and_fix(value, word):
    bad = grey()
    bad[2, 1, 1, 0] = value
    with pytest.raises(PrtError) as caught:
        sanitise(bad, "attic")
    message = str(caught.value)
    assert "attic" in message and word in message and "of 96" in message and "lighting.mend=true" in message
    assert "\n" not in message


def test_mending():
    bad = grey()
    bad[0, 0, 0] = torch.tensor([float("nan"), -3.0, float("inf")])
    bad[1, 0, 0, 0] = 7.0
    with pytest.warns(UserWarning, match="attic.*mended"):
        good = sanitise(bad, "attic", mend=True)
    assert good[0, 0, 0].tolist() == [0.0, 0.0, 7.0]
    assert torch.equal(good[2:], bad[2:])
    assert good.isfinite().all() and (good >= 0).all()


def test_a_map_without_one_good_texel_becomes_black():
    with pytest.warns(UserWarning):
        assert sanitise(torch.full((6, 2, 2, 3), float("nan")), "void", mend=True).sum() == 0


@pytest.mark.parametrize("kind", ["black", "single", "bright"])
def test_valid_extremes_pass_untouched(kind):
    cubemap = torch.zeros((6, 4, 4, 3))
    if kind == "single":
        cubemap[3, 2, 1] = 5.0
    if kind == "bright":
        cubemap[:] = 1e6
    assert sanitise(cubemap, kind) is cubemap


def test_wrong_shape_is_an_error():
    with pytest.raises(PrtError, match="shape"):
        sanitise(torch.ones((6, 4, 4, 1)), "grey")

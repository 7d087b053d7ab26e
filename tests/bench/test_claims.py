"""Claims: the grammar, its errors, and verdicts on runs whose answer is known."""

import pandas as pd
import pytest
from synthetic_runs import make_run

from prt.bench.claims import parse_claims
from prt.bench.results import read_images, summarise
from prt.bench.verdicts import Evidence, judge
from prt.errors import PrtError

CLAIM = "wavelet_neural > neural_prt on psnr/full, far, every scene"


def evidence(*cells, scenes=("box",), reasons=None) -> Evidence:
    images = read_images(cells)
    return Evidence(images, summarise(list(cells), images), list(scenes), reasons or {})


@pytest.fixture
def both(tmp_path) -> Evidence:
    """wavelet_neural stands exactly 4 dB above neural_prt on every image."""
    return evidence(make_run(tmp_path, "box", "wavelet_neural"), make_run(tmp_path, "box", "neural_prt"))


def verdict(text: str, found: Evidence) -> str:
    return judge(parse_claims([text]), found)["verdict"].iloc[-1]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("wavelet_neural > neural_prt on psnr/indirect, far, every scene", "holds"),
        ("neural_prt > wavelet_neural on psnr/indirect, far, every scene", "fails"),
        # lower is better: the same order must come out of the metric's direction
        ("wavelet_neural > neural_prt on lpips/indirect, far, every scene", "holds"),
        ("neural_prt > wavelet_neural on lpips/indirect, far, every scene", "fails"),
        ("wavelet_neural > neural_prt by 3.9 on psnr/indirect, far, every scene", "holds"),
        ("wavelet_neural > neural_prt by 4.1 on psnr/indirect, far, every scene", "fails"),
        ("wavelet_neural ~ neural_prt within 4.1 on psnr/indirect, far, every scene", "holds"),
        ("wavelet_neural ~ neural_prt within 3.9 on psnr/indirect, far, every scene", "fails"),
        ("wavelet_neural > wavelet_neural on psnr/indirect, far, every scene", "undecided"),
        ("wavelet_neural[denoised] - wavelet_neural > 0.7 on psnr/full, far, every scene", "holds"),
        ("wavelet_neural[denoised] - wavelet_neural > 0.9 on psnr/full, far, every scene", "fails"),
        ("wavelet_neural > 28 on psnr/indirect, far, scene box", "holds"),
        ("wavelet_neural > 40 on psnr/indirect, far, scene box", "fails"),
        ("wavelet_neural[near] ~ wavelet_neural[far] within 2 on psnr/full, every scene", "holds"),
        ("neural_prt > wavelet_neural on time/shade, every scene", "holds"),
        ("wavelet_neural > neural_prt on time/shade, every scene", "fails"),
    ],
)
def test_verdicts(both, text, expected):
    assert verdict(text, both) == expected


def test_alternatives_expand():
    claims = parse_claims(["a[denoised] > b on psnr|ssim|lpips/full|indirect, far|near, every scene"])
    assert len(claims) == 12
    assert {(c.metric, c.component, c.split) for c in claims} == {
        (m, p, s) for m in ("psnr", "ssim", "lpips") for p in ("full", "indirect") for s in ("far", "near")
    }
    assert all(c.better[0].variant == "denoised" and c.than[0].variant == "" for c in claims)


@pytest.mark.parametrize(
    ("text", "variants", "splits"),
    [
        ("a > b on rmse/indirect, same, every scene", ["", ""], ["", ""]),
        ("a[basis=16] > b[points] on psnr/full, far, every scene", ["basis=16", ""], ["", "points"]),
        ("a[denoised, closer] > a[same,denoised] on psnr/full, every scene", ["denoised"] * 2,
         ["closer", "same"]),
        ("a[basis=16,lambda=1e-2,near] > 3 on psnr/full, every scene", ["basis=16,lambda=1e-2", ""],
         ["near", ""]),
    ],
)  # fmt: skip
def test_words_in_brackets_are_splits_and_pairs_are_variants(text, variants, splits):
    (claim,) = parse_claims([text])
    terms = [*claim.better, *claim.than]
    assert [t.variant for t in terms] == variants and [t.split for t in terms] == splits


def test_any_single_word_is_a_split_and_scopes_are_none():
    claims = parse_claims(["a > b on psnr/full, same|points|directional, scene box den"])
    assert [c.split for c in claims] == ["same", "points", "directional"]
    assert all(c.scenes == ("box", "den") for c in claims)


def test_a_split_that_was_not_measured_is_named(both):
    row = judge(parse_claims(["wavelet_neural > neural_prt on psnr/full, points, every scene"]), both).iloc[0]
    assert row["verdict"] == "undecided"
    assert row["note"] == "wavelet_neural: no psnr figures of split points, there are near, far"


def test_diagnostics_are_judged_by_their_own_direction(tmp_path):
    cells = [make_run(tmp_path, "box", m, extra={"rmse/bound": v, "negative/share": v})
             for m, v in (("wavelet_neural", 0.1), ("neural_prt", 0.3))]  # fmt: skip
    found = evidence(*cells)
    for metric in ("rmse/bound", "negative/share"):
        assert (
            verdict(f"wavelet_neural > neural_prt on {metric}/indirect, far, every scene", found) == "holds"
        )
    # usually taken once; a task that takes it image by image is served too
    cells = [make_run(tmp_path / "once", "box", m, extra={"condition/transfer": v})
             for m, v in (("wavelet_neural", 10.0), ("neural_prt", 30.0))]  # fmt: skip
    text = "wavelet_neural > neural_prt on condition/transfer/indirect, far, every scene"
    assert verdict(text, evidence(*cells)) == "holds"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a > b", "no ` on"),
        ("a better b on psnr/full, far, every scene", "between two sides"),
        ("a > b on psnr, far, every scene", "<metric>/<component>"),
        ("a > b on psnr/full, every scene", "near or far"),
        ("a > b on psnr/full, far", "which scenes"),
        ("a > b on psnr/full, far, all scenes", "'all scenes'"),
        ("a ~ b on psnr/full, far, every scene", "within"),
        ("a > b on psnr/full, far, scene", "'scene'"),
        ("a > b on psnrr/full, far, every scene", "unknown metric 'psnrr'; choose from psnr"),
        ("a > b on psnr/full, far, near, every scene", "'near'"),
        ("a[near, far] > b on psnr/full, every scene", "two splits, near and far"),
        ("a[not-a-word] > b on psnr/full, far, every scene", "neither key=value, denoised nor a split"),
        ("a > b! on psnr/full, far, every scene", "neither a method nor a number"),
    ],
)
def test_malformed_claims_are_explained(text, says):
    with pytest.raises(PrtError, match=says.replace("[", r"\[")) as error:
        parse_claims([text])
    assert text in str(error.value) and "\n" not in str(error.value)


def test_difference_is_reported_with_its_interval_and_count(both):
    row = judge(parse_claims([CLAIM]), both).iloc[0]
    assert row["difference"] == pytest.approx(4.0)
    assert row["lo"] <= 4.0 <= row["hi"] and row["n"] == 6


def test_missing_runs_leave_a_claim_undecided_with_the_reason(tmp_path):
    reasons = {("box", "neural_prt"): "loss became NaN"}
    found = evidence(make_run(tmp_path, "box", "wavelet_neural"), reasons=reasons)
    rows = judge(parse_claims([CLAIM]), found)
    assert list(rows["verdict"]) == ["undecided", "undecided"]
    assert "neural_prt: loss became NaN" in rows["note"].iloc[0]


def test_most_scenes_and_every_scene(tmp_path):
    cells = []
    for scene, gap in (("a", 0.0), ("b", 0.0), ("c", 9.0)):  # on c the baseline wins by 5 dB
        cells.append(make_run(tmp_path, scene, "wavelet_neural"))
        cells.append(make_run(tmp_path, scene, "neural_prt", psnr=26 + gap))
    found = evidence(*cells, scenes=("a", "b", "c"))
    assert verdict("wavelet_neural > neural_prt on psnr/full, far, most scenes", found) == "holds"
    assert verdict("wavelet_neural > neural_prt on psnr/full, far, every scene", found) == "fails"
    assert verdict("neural_prt > wavelet_neural on psnr/full, far, most scenes", found) == "fails"


def test_a_noisy_reference_decides_nothing(tmp_path):
    cells = [make_run(tmp_path, "box", method, floor=33.0) for method in ("wavelet_neural", "neural_prt")]
    row = judge(parse_claims([CLAIM]), evidence(*cells)).iloc[0]
    assert row["verdict"] == "undecided" and "noise floor" in row["note"]


def test_unequal_test_images_are_not_compared(tmp_path):
    cells = [make_run(tmp_path, "box", "wavelet_neural"), make_run(tmp_path, "box", "neural_prt")]
    path = cells[1].run.path / "metrics.csv"
    table = pd.read_csv(path)
    table[table["view"] != "view2"].to_csv(path, index=False)
    row = judge(parse_claims([CLAIM]), evidence(*cells)).iloc[0]
    assert row["verdict"] == "undecided" and "same images" in row["note"]

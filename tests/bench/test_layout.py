"""The tidy table and its layouts: right cells, published apart from measured, reasons for gaps."""

import re

import numpy as np
import pandas as pd
import pytest
from synthetic_runs import make_run

from prt.bench import layout
from prt.bench.layout import Layout, quality_sheet, to_latex, to_markdown
from prt.bench.results import (
    COLUMNS,
    image_interval,
    in_views,
    less,
    merge_published,
    read_images,
    read_published,
    read_results,
    summarise,
    write_results,
)
from prt.bench.run_sheets import cost_sheet, error_sheets
from prt.errors import PrtError

PLAN = Layout(["box"], [("wavelet_neural", ""), ("neural_prt", "")], labels={"neural_prt": "NPRT"})


def published_rows(*rows) -> pd.DataFrame:
    table = pd.DataFrame([dict(zip(COLUMNS, row, strict=True)) for row in rows])
    return table


def paper_row(scene: str, value: float) -> tuple:
    nan = float("nan")
    keys = (scene, "wavelet_neural", "denoised", "paper", "GPU", "far", "full", "psnr")
    return (*keys, nan, nan, nan, nan, nan, value)


@pytest.fixture
def cells(tmp_path):
    return [make_run(tmp_path, "box", "wavelet_neural"), make_run(tmp_path, "box", "neural_prt")]


def test_means_counts_and_columns(cells, tmp_path):
    images = read_images(cells)
    table = summarise(cells, images)
    assert list(table.columns) == COLUMNS
    assert not table.duplicated(COLUMNS[:8]).any()
    own = images[
        (images.method == "neural_prt")
        & (images.variant == "denoised")
        & (images.split == "far")
        & (images.component == "indirect")
        & (images.metric == "psnr")
    ]
    row = table[
        (table.method == "neural_prt")
        & (table.variant == "denoised")
        & (table.split == "far")
        & (table.component == "indirect")
        & (table.metric == "psnr")
    ].iloc[0]
    assert row["value"] == pytest.approx(own["value"].mean()) and row["n"] == len(own) == 6
    assert row["lo"] < row["value"] < row["hi"]
    write_results(table, tmp_path / "results.csv")
    back = read_results(tmp_path / "results.csv")
    assert list(back.columns) == COLUMNS and (back["variant"] == table["variant"]).all()


def test_seeds_are_averaged_image_by_image(tmp_path):
    cells = [make_run(tmp_path, "box", "neural_prt", seed=seed) for seed in (0, 1, 2)]
    table = summarise(cells, read_images(cells))
    rows = table[(table.metric == "psnr") & (table.component == "full")]
    assert (rows["seeds"] == 3).all() and (rows["n"] == 6).all()
    assert table[table.metric == "time/fit"]["value"].item() == 481.0


def test_costs(cells):
    table = summarise(cells, read_images(cells)).set_index(["method", "variant", "metric"])["value"]
    assert table["wavelet_neural", "", "time/shade"] == 0.08
    assert table["wavelet_neural", "", "time/frame"] == pytest.approx(0.083)
    assert table["wavelet_neural", "denoised", "time/frame"] == pytest.approx(0.093)
    assert table["wavelet_neural", "", "bytes/model"] == 2_000_000
    assert table["wavelet_neural", "", "time/fit"] == 480.0
    assert ("wavelet_neural", "denoised", "time/shade") not in table.index


def test_published_numbers_stay_in_their_column(cells):
    paper = published_rows(paper_row("box", 12.34), paper_row("palace", 56.78))
    plain, merged = summarise(cells, read_images(cells)), summarise(cells, read_images(cells), paper)
    pd.testing.assert_series_equal(
        merged["value"].iloc[: len(plain)].astype(float), plain["value"].astype(float), check_index=False
    )
    beside = merged[merged["published"] == 12.34].iloc[0]
    assert beside["budget"] == "laptop" and beside["value"] > 20
    alone = merged[merged["published"] == 56.78].iloc[0]
    assert alone[["value", "lo", "hi", "n"]].isna().all() and alone["scene"] == "palace"
    plan = Layout(["box", "palace"], PLAN.methods)
    measured, published = quality_sheet(merged, plan), quality_sheet(merged, plan, "published")
    assert "12.34" not in to_markdown(measured) and "56.78" not in to_markdown(measured)
    assert "12.34" in to_markdown(published) and "56.78" in to_markdown(published)


def test_a_published_file_may_not_fill_measured_columns(tmp_path):
    table = published_rows(paper_row("box", 12.34))
    table["value"] = 12.34
    table.to_csv(tmp_path / "paper.csv", index=False)
    with pytest.raises(PrtError, match="only the column `published`"):
        read_published(tmp_path / "paper.csv")
    assert merge_published(table, None) is table


def test_cells_best_and_directions(cells):
    sheet = quality_sheet(summarise(cells, read_images(cells)), PLAN)
    assert [lead for lead, _ in sheet.rows[:2]] == [
        ["PSNR (dB) ↑", "wavelet neural", "no"],
        ["PSNR (dB) ↑", "wavelet neural", "yes"],
    ]
    assert sheet.rows[2][0][1] == "NPRT" and sheet.rows[-1][0][0] == "LPIPS ↓"
    for lead, row in sheet.rows:  # wavelet_neural denoised is the best on every metric, whichever way it runs
        wins = lead[1] == "wavelet neural" and lead[2] == "yes"
        assert all(all(entry.best) == wins and any(entry.best) == wins for entry in row)
    assert re.fullmatch(r"\d\d\.\d\d / \d\d\.\d\d", sheet.rows[0][1][0].text(str))
    assert len(sheet.rows[0][1]) == 2  # far, near


def test_failed_missing_and_unavailable(tmp_path):
    good = make_run(tmp_path, "box", "wavelet_neural", lpips=None)
    bad = make_run(tmp_path, "box", "neural_prt", state="failed")
    absent = make_run(tmp_path, "den", "neural_prt", state="absent")
    cells = [good, bad, absent]
    reasons = {(c.scene, c.method, c.variant): c.reason for c in cells if not c.done}
    plan = Layout(["box", "den"], PLAN.methods)
    results = summarise(cells, read_images(cells))
    text = to_markdown(quality_sheet(results, plan, reasons=reasons))
    failed = next(line for line in text.splitlines() if "| neural prt | no" in line)
    assert failed.split("|")[4].strip() == "failed" and failed.split("|")[5].strip() == layout.MISSING
    assert "loss became NaN at step 12" in text
    lpips = next(line for line in text.splitlines() if line.startswith("| LPIPS"))
    assert "n/a / n/a" in lpips and "LPIPS could not be computed" in text


def test_latex_is_escaped_and_balanced(cells):
    text = to_latex(quality_sheet(summarise(cells, read_images(cells)), PLAN, title="50 % of a_b & c"))
    assert r"50 \% of a\_b \& c" in text and r"$\uparrow$" in text and r"\textbf{" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert len({len(re.findall(r"(?<!\\)&", line)) for line in rows}) == 1


def test_cost_sheet(cells):
    text = to_markdown(cost_sheet(summarise(cells, read_images(cells)), PLAN))
    line = next(line for line in text.splitlines() if "NPRT" in line)
    assert [c.strip() for c in line.split("|")[4:-1]] == ["480", "4", "3", "20", "10", "23", "2"]


def test_a_methods_parts_and_baking_get_columns_where_there_are_any(tmp_path):
    cells = [
        make_run(tmp_path, "box", "wavelet_neural", parts={"measure": 0.001, "transfer": 0.0005}, bake=12.0),
        make_run(tmp_path, "box", "neural_prt"),
    ]
    results = summarise(cells, read_images(cells))
    lines = to_markdown(cost_sheet(results, PLAN)).splitlines()
    head, (own, other) = lines[2], [line for line in lines if line.startswith("| Box")]
    cut = [[c.strip() for c in line.split("|")[4:-1]] for line in (head, own, other)]
    assert cut[0] == ["bake (s)", "fit (s)", "light (ms)", "G-buffer (ms)", "shade (ms)", "measure (ms)",
                      "transfer (ms)", "denoise (ms)", "frame (ms)", "model (MB)"]  # fmt: skip
    assert cut[1][:1] + cut[1][5:7] == ["12", "1", "0.5"]
    assert cut[2][:1] + cut[2][5:7] == [layout.MISSING] * 3
    assert any("measure, transfer: parts of light and shade" in line for line in lines)


def test_parts_of_an_error_stand_beside_the_whole_and_variants_apart(tmp_path):
    extra = {"rmse": 0.02, "rmse/bound": 0.01, "rmse/relative": 0.5, "negative/share": 0.125}
    cells = [make_run(tmp_path, "box", "svd", variant=v, extra=extra) for v in ("basis=4", "basis=16")]
    plan = Layout(["box"], [("svd", "basis=4"), ("svd", "basis=16")])
    psnr, rmse, others = error_sheets(summarise(cells, read_images(cells)), plan)
    assert psnr.title == "Error split (PSNR, dB)" and rmse.title == "Error split (RMSE, radiance)"
    assert rmse.groups[0][1] == ["all errors", "RMSE bound", "relative RMSE"]
    assert others.title == "Diagnostics" and others.groups[0][1] == ["negative, share ↓"]
    places = [tuple(lead[1:3]) for lead, _ in rmse.rows]
    assert set(places) == {(s, f"svd (basis={n})") for s in ("near", "far") for n in (4, 16)}
    assert len(places) == 4
    assert [float(e.text(str)) for e in rmse.rows[0][1]] == pytest.approx([0.02, 0.01, 0.5], rel=0.01)
    assert float(others.rows[0][1][0].text(str)) == pytest.approx(0.125, rel=0.01)


def test_splits_have_names_and_an_order(cells):
    assert [layout.split_name(s) for s in ("near", "far", "same", "points")] == [
        "near views", "far views", "same lights", "point lights"
    ]  # fmt: skip
    assert layout.splits_of(["near", "near", "far"]) == ["far", "near"]
    assert layout.splits_of(["same", "points", "same"]) == ["same", "points"]
    plan = Layout(["box"], PLAN.methods, splits=["far", "same"])
    sheet = quality_sheet(summarise(cells, read_images(cells)), plan)
    assert [name for name, _ in sheet.groups] == ["far views", "same lights"]


def test_only_the_views_of_the_list_count(tmp_path):
    cells = [make_run(tmp_path, "box", "neural_prt", views=("lightmap", "frame00", "frame01"))]
    images = read_images(cells)
    assert in_views(images, []) is images
    assert set(in_views(images, ["lightmap"])["view"]) == {"lightmap"}
    assert set(in_views(images, ["frame*"])["view"]) == {"frame00", "frame01"}
    own = summarise(cells, in_views(images, ["lightmap"]))
    row = own[(own.metric == "psnr") & (own.split == "far") & (own.component == "full")].iloc[0]
    wanted = images[(images["view"] == "lightmap") & (images.metric == "psnr") & (images.split == "far")
                    & (images.component == "full") & (images.variant == "")]  # fmt: skip
    assert row["n"] == 2 and row["value"] == pytest.approx(wanted["value"].mean())


@pytest.mark.parametrize(
    ("metric", "label"),
    [
        ("psnr", "PSNR (dB) ↑"),
        ("psnr/fit", "PSNR, fit only (dB) ↑"),
        ("rmse/bound", "RMSE bound (radiance) ↓"),
        ("condition/transfer", "condition number, transfer ↓"),
        ("eigenvalue/lost", "eigenvalue, lost ↓"),
        ("ratio/error", "ratio/error ↓"),
        ("paths/record", "paths/record ↑"),
        ("time/measure", "time/measure ↓"),
    ],
)
def test_labels_say_which_way_is_better(metric, label):
    assert layout.metric_label(metric) == label


def test_fits_that_differ_widen_the_interval():
    rng = np.random.default_rng(0)
    images = pd.MultiIndex.from_product([list("abcdef"), list("xy")], names=["view", "lighting"])
    noise = 0.01 * rng.normal(size=(12, 3))
    alike = pd.DataFrame(30 + noise, index=images, columns=[0, 1, 2])
    apart = alike + np.array([-1.0, 0.0, 1.0])
    one = image_interval(alike[[0]])
    assert image_interval(apart).mean == pytest.approx(30, abs=0.02)
    # Student's t of three means whose standard deviation is 1
    assert image_interval(apart).hi - image_interval(apart).mean == pytest.approx(4.303 / 3**0.5, rel=0.02)
    assert image_interval(alike).hi - image_interval(alike).lo < 3 * (one.hi - one.lo)
    # paired by seed: what all seeds share is no difference
    assert image_interval(less(apart + 0.5, apart)).lo == pytest.approx(0.5)
    lone = less(apart + 0.5, apart[[1]])
    assert lone.shape == (12, 1) and lone.to_numpy().mean() == pytest.approx(0.5, abs=0.02)


def test_what_a_row_varies_can_have_words_of_its_own():
    labels = {"svd": "SVD", "svd[basis=4,lambda=0]": "four"}
    plan = Layout(["box"], [("svd", "basis=4,lambda=0"), ("svd", "")], labels=labels)
    assert plan.method_label("svd", "basis=4,lambda=0") == "SVD (four)"
    assert plan.method_label("svd", "basis=4,lambda=0", "denoised") == "SVD (four,denoised)"
    assert plan.method_label("svd", "", "denoised") == "SVD (denoised)"
    assert plan.method_label("svd", "") == "SVD"
    assert plan.chosen(["SVD (four)"], "figure") == [("svd", "basis=4,lambda=0")]


def test_methods_are_chosen_by_label_by_name_and_by_variant():
    plan = Layout(["box"], [("svd", "basis=4"), ("svd", "basis=16"), ("nprt", "")], labels={"nprt": "NPRT"})
    assert plan.chosen(["NPRT", "svd[basis=16]"], "figure") == [("nprt", ""), ("svd", "basis=16")]
    assert plan.chosen(["svd", "svd (basis=4)"], "figure") == plan.methods[:2]
    with pytest.raises(PrtError, match=r"figure: no method 'swd' .* choose from svd\[basis=4\], svd"):
        plan.chosen(["swd"], "figure")


def test_unknown_metric_is_an_error(cells):
    with pytest.raises(PrtError, match="unknown metric 'psnrr'"):
        quality_sheet(summarise(cells, read_images(cells)), Layout(["box"], PLAN.methods, metrics=["psnrr"]))

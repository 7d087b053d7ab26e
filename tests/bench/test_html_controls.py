"""The HTML report in a real browser: tables, claims, charts and pictures obey."""

import base64
import io

from html_page import NAMES, choose, open_table, texts
from PIL import Image

from prt.bench.html.content import read_report


def test_results_sort_by_a_head(page):
    open_table(page)
    head = page.locator("#results th[data-column=value]")
    choose(page, "Metric", "psnr (PSNR)")
    assert head.get_attribute("aria-sort") == "none"

    def values() -> list[float]:
        return [float(t) for t in texts(page, "#results td.value") if t != "–"]

    as_in_the_file = values()
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "ascending" and values() == sorted(as_in_the_file)
    head.locator("button").focus()
    page.keyboard.press("Enter")
    assert head.get_attribute("aria-sort") == "descending" and values() == sorted(
        as_in_the_file, reverse=True
    )
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "none" and values() == as_in_the_file
    assert len(set(as_in_the_file)) > 8
    page.locator("#results th[data-column=method] button").click()
    methods = texts(page, "#results tbody tr td:nth-child(2)")
    assert methods == sorted(methods) and len(set(methods)) == 4


def test_results_are_filtered_and_long_tables_grow(page):
    open_table(page)
    rows = page.locator("#results tbody tr")
    total = rows.count()
    assert total == 200 and page.get_by_role("button", name="Show all").is_visible()
    page.get_by_role("button", name="Show all").click()
    whole = rows.count()
    assert whole > 200

    choose(page, "Scene", "den")
    choose(page, "Method", "neural_prt")
    choose(page, "Split", "far")
    choose(page, "Component", "indirect")
    assert set(texts(page, "#results tbody th")) == {"den"} and 5 < rows.count() < 40
    choose(page, "Metric", "ssim")
    assert rows.count() == 2 and "of" in page.locator("#results .status").inner_text()
    option = page.locator("#results label", has_text="Metric").locator("option", has_text="time/shade")
    assert option.is_disabled()  # times have no split
    page.locator("#results").get_by_role("button", name="Clear").click()
    assert rows.count() == 200


def test_published_figures_have_columns_of_their_own(page):
    open_table(page)
    page.get_by_role("button", name="Show all").click()
    owners = texts(page, "#results tr.owners th")
    assert owners == ["Measured by this project", "Published"]
    page.locator("#results th.published button").click()  # what is known comes first
    first = page.locator("#results tbody tr").first
    assert (
        first.locator("td.published").inner_text() == "12.34"
        and "12.34" not in first.locator("td.value").inner_text()
    )
    assert "12.34" not in "".join(texts(page, "#results td.value, #results td.interval"))
    colours = page.evaluate("""['td.published', 'td.value'].map(name =>
        getComputedStyle(document.querySelector('#results ' + name)).backgroundColor)""")
    assert colours[0] != colours[1]
    published = page.locator("#tables details.published")
    assert published.count() == 1 and "12.34" in published.inner_text()


def test_the_papers_table_stands_in_its_layout(page):
    open_table(page)
    table = page.locator("#tables table.sheet").first
    assert [t for t in table.locator("th.group").all_inner_texts()] == ["far views", "near views"]
    assert table.locator("thead tr").nth(1).locator("th").all_inner_texts() == ["Box", "Den", "Box", "Den"]
    assert table.locator("tbody b").count() > 4 and "**" not in table.inner_text()


def test_claims_are_filtered_by_verdict_and_open_into_scenes(page):
    open_table(page)
    shown = page.locator("#claims table.claims > tbody:visible")
    assert shown.count() == 3
    page.locator("#claims .filter", has_text="1 fails").click()
    assert shown.count() == 1 and "path_traced > neural_prt" in shown.inner_text()
    assert texts(page, "#claims .filter[aria-pressed=true]") == ["✘ 1 fails"]
    toggle = shown.locator("button.claim")
    toggle.focus()
    page.keyboard.press("Enter")
    assert toggle.get_attribute("aria-expanded") == "true"
    assert shown.locator("table.scenes tbody th").all_inner_texts() == ["box", "den"]
    assert shown.locator("table.scenes .verdict.fails").count() == 2
    page.locator("#claims .filter", has_text="All 3").click()
    assert shown.count() == 3
    page.get_by_role("button", name="Open all").click()
    assert page.locator("#claims table.scenes").count() == 3


def test_a_point_of_a_chart_says_what_it_is(page):
    open_table(page, "charts")
    tip = page.locator(".tip")
    assert tip.is_hidden()
    points = page.locator("#charts circle.point")
    assert points.count() == 10
    label = points.nth(0).get_attribute("aria-label")
    assert label.startswith("Ours, Box; PSNR, indirect (dB): ") and "time per frame (ms): 83" in label
    points.nth(0).scroll_into_view_if_needed()
    page.wait_for_timeout(200)  # scrolling puts labels away
    points.nth(0).hover(force=True)
    assert tip.is_visible() and "Ours, Box" in tip.inner_text() and "83" in tip.inner_text()
    page.mouse.move(2, 2)
    assert tip.is_hidden()
    points.nth(0).focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")  # there is none
    assert points.nth(9).evaluate("node => node === document.activeElement")
    for _ in range(6):
        page.keyboard.press("ArrowLeft")
    assert page.locator("#charts circle.point[tabindex='0']").count() == 1  # one stop of the tab key
    assert tip.is_visible() and "NPRT (denoised), Box" in tip.inner_text()
    page.keyboard.press("Escape")
    assert tip.is_hidden()


def pixels(page, selector: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(
        page.evaluate(f"document.querySelector('{selector}').toDataURL()").partition(",")[2]
    ))).convert("RGB")  # fmt: skip


def test_the_divider_is_dragged_between_two_pictures(page, reports):
    open_table(page, "pictures")
    handle = page.get_by_role("slider")
    handle.wait_for()
    page.wait_for_function("document.querySelector('.stage canvas').width > 200")
    assert handle.get_attribute("aria-valuenow") == "50"
    stage = page.locator(".stage")
    stage.scroll_into_view_if_needed()
    box = stage.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, middle, steps=4)
    page.mouse.up()
    page.mouse.move(box["x"] + box["width"] * 0.9, middle)  # let go: it stays
    assert handle.get_attribute("aria-valuenow") == "25"
    assert page.evaluate("getComputedStyle(document.querySelector('canvas.over')).clipPath").endswith(" 25%)")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    assert handle.get_attribute("aria-valuenow") == "37"
    page.keyboard.press("End")
    assert handle.get_attribute("aria-valuenow") == "100"
    # both sides are cut out of the one figure, pixel by pixel
    report = read_report(NAMES[2], reports / NAMES[2])
    figure = Image.open(reports / NAMES[2] / "figure.png").convert("RGB")

    def cut(row: int, column: int, kind: str) -> Image.Image:
        x, y, w, h = report["figure"]["rows"][row]["columns"][column][kind]
        return figure.crop((x, y, x + w, y + h))

    assert pixels(page, ".stage canvas").tobytes() == cut(0, 0, "picture").tobytes()
    assert pixels(page, ".stage canvas.over").tobytes() == cut(0, 1, "picture").tobytes()
    page.locator(".sides select").nth(1).select_option(label="NPRT")
    page.get_by_role("button", name="Error maps").click()
    assert pixels(page, ".stage canvas.over").tobytes() == cut(0, 2, "error").tobytes()
    assert pixels(page, ".stage canvas").tobytes() == cut(0, 0, "picture").tobytes()  # a reference has none
    assert texts(page, ".stage .tag") == ["Reference", "NPRT, error"]
    page.locator(".viewer .tab", has_text="Den").click()
    assert pixels(page, ".stage canvas.over").tobytes() == cut(1, 2, "error").tobytes()
    page.get_by_role("button", name="Swap left and right").click()
    assert texts(page, ".stage .tag") == ["NPRT, error", "Reference"]
    page.locator(".thumb", has_text="path traced").click()
    assert texts(page, ".stage .tag")[1] == "path traced, error"


def test_a_figure_without_boxes_is_shown_whole_and_says_so(page, file):
    page.goto(file.as_uri() + "#/hostile2024/table2")
    assert "cannot be laid over each other" in page.locator("#pictures .note").inner_text()
    assert page.locator("#pictures .whole img").is_visible() and page.locator(".stage").count() == 0

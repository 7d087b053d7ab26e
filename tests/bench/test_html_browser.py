"""The HTML report in a real browser: its pages and its search, light and dark, and texts that attack.

The fixture ``page`` fails every test with a console message, or a request but for the file.
"""

import pytest
from html_page import TABLE, open_table, texts


def test_the_index_lists_tables_by_paper(page):
    assert page.title() == "prt report"
    heads = texts(page, ".paper h2")
    assert ["Hostile 2024" in heads[0], "Nobody 2024" in heads[1], "2 tables" in heads[1]] == [True] * 3
    row = page.locator(".row", has_text="nobody2024/table1")
    verdicts = [text.split() for text in row.locator(".verdict").all_inner_texts()]
    assert verdicts == [["✔", "1", "holds"], ["✘", "1", "fails"], ["?", "1", "undecided"]]
    assert row.locator(".blocks i").count() == 3 and "01234567" in row.inner_text()
    assert "3 tables from 2 papers" in page.locator(".lead").inner_text()


def test_a_table_opens_by_click_and_by_keyboard_and_back_leads_to_the_index(page, file):
    page.get_by_role("link", name="Table 1 of Nobody 2024").click()
    assert page.url == file.as_uri() + TABLE and "Two methods in a box" in page.locator(".about").inner_text()
    assert page.evaluate("document.activeElement.tagName") == "H1"
    assert page.title() == "table1, Table 1 of Nobody 2024"
    page.go_back()
    assert page.locator("h1").inner_text() == "Measured results"
    page.get_by_role("link", name="Figure 10 of Somebody 2024").focus()
    page.keyboard.press("Enter")
    assert page.locator("h1").inner_text() == "Figure 10 of Somebody 2024"
    assert page.locator("#pictures").count() == 0  # it has no figure


def test_an_address_opens_a_section(page, file):
    page.goto(file.as_uri() + TABLE + "::results")
    page.reload()
    page.locator("#results h2").wait_for()
    page.wait_for_function("document.getElementById('results').getBoundingClientRect().top < 300")
    page.goto(file.as_uri() + "#/nobody2024/gone")
    assert page.locator("h1").inner_text() == "No such table"


def test_search_finds_tables_by_their_words(page):
    open_table(page)
    page.keyboard.press("/")
    page.keyboard.type("Somebody ssim")
    assert page.locator("h1").inner_text() == "Search"
    assert page.locator(".row").count() == 1 and "figure10" in page.locator(".row").inner_text()
    assert [t.lower() for t in texts(page, ".row mark")] == ["somebody", "ssim"]
    page.locator("#search").fill("path_traced fails")
    assert page.locator(".row").count() == 2
    assert "path_traced > neural_prt on psnr/indirect" in page.locator(".hits").first.inner_text()
    page.locator("#search").fill("nothing has this")
    assert page.locator(".row").count() == 0 and "No table has all" in page.locator(".none").inner_text()
    page.keyboard.press("Escape")
    assert page.locator(".row").count() == 3 and page.locator("#search").input_value() == ""
    page.go_back()
    assert page.locator("h1").inner_text() == "Table 1 of Nobody 2024"  # where the search began


def test_hostile_texts_are_texts(page, file):
    page.goto(file.as_uri() + "#/hostile2024/table2")
    assert page.locator("h1").inner_text().startswith('<script>window.hacked="title"</script>')
    assert page.locator("#results tbody th").first.inner_text().startswith("<script>window.hacked")
    page.get_by_role("button", name="Open all").click()
    for part in page.locator("details").all():
        part.evaluate("node => { node.open = true; }")
    page.locator("#search").fill("hacked")
    assert page.locator(".row").count() == 1
    assert page.evaluate("document.querySelectorAll('main script, main img, main iframe').length") == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_follows_light_and_dark(page, scheme):
    page.emulate_media(color_scheme=scheme)
    open_table(page)
    ground, ink = page.evaluate("""['backgroundColor', 'color'].map(name =>
        getComputedStyle(document.body)[name].match(/\\d+/g).slice(0, 3).reduce((a, b) => a + +b, 0))""")
    assert (ground > 600 > 200 > ink) if scheme == "light" else (ground < 120 < 600 < ink)
    panel = page.evaluate(
        "getComputedStyle(document.querySelector('#charts svg path')).fill.match(/\\d+/g).map(Number)"
    )
    assert (panel[0] > 200) == (scheme == "light")


def test_a_narrow_window_does_not_scroll_sideways(page):
    page.set_viewport_size({"width": 400, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    open_table(page)
    page.wait_for_timeout(100)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400

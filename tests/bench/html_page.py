"""What the tests of the HTML report do to its page in the browser."""

NAMES = ["hostile2024/table2", "nobody2024/figure10", "nobody2024/table1"]
TABLE = "#/nobody2024/table1"


def texts(page, selector: str) -> list[str]:
    return [" ".join(text.split()) for text in page.locator(selector).all_inner_texts()]


def choose(page, name: str, option: str) -> None:
    """Choose in the filter of that name the first option that has this text."""
    select = page.locator("#results label", has_text=name).locator("select")
    select.select_option(value=select.locator("option", has_text=option).first.get_attribute("value"))


def open_table(page, section: str = "") -> None:
    page.evaluate(f"location.hash = '{TABLE}{'::' + section if section else ''}'")
    page.locator("h1", has_text="Table 1 of Nobody").wait_for()

"""Shared by the tests of the bench: reports that are made once, for they take seconds, and a browser."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="session")
def reports(tmp_path_factory) -> Path:
    """The folder ``reports/`` of :mod:`synthetic_reports`; nothing in it is changed."""
    from synthetic_reports import write_reports

    return write_reports(tmp_path_factory.mktemp("html"))


@pytest.fixture
def here(reports, tmp_path, monkeypatch) -> Path:
    """The folder above the reports, the current one."""
    (tmp_path / "reports").symlink_to(reports)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def file(reports, tmp_path_factory) -> Path:
    """The page of all of them."""
    from html_page import NAMES

    from prt.bench.html import page as html
    from prt.bench.html.content import read_report

    path = tmp_path_factory.mktemp("browser") / "a report.html"
    path.write_text(html.build([read_report(name, reports / name) for name in NAMES]), encoding="utf-8")
    return path


@pytest.fixture(scope="module")  # its event loop is gone before other tests begin
def browser() -> Iterator:
    """Headless Chromium; tests that ask for it are skipped where there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the package playwright is missing (pip install playwright)"
    )
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=found, timeout=120_000)
        yield running
        running.close()


@pytest.fixture
def page(browser, file):
    """The page at its index; whatever it says to the console, or asks of the network, fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.set_default_timeout(60_000)
    said, asked = [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    yield page
    hacked = page.evaluate("window.hacked")
    context.close()
    assert said == [] and hacked is None
    assert {url for url in asked if not url.startswith("data:")} == {file.as_uri()}

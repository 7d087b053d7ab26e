"""Progress where the output is no terminal: a line now and then, with the remaining time."""

import types

import pytest

from prt import progress
from prt.progress import PLAIN_INTERVAL, Bar, track


@pytest.fixture
def clock(monkeypatch):
    found = types.SimpleNamespace(now=100.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: found.now)
    return found


def test_lines_come_now_and_then_with_the_time_left(clock, capsys):
    for _ in track(range(40), "record", 40):
        clock.now += 2.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "record: 8/40, 64 s left" and lines[1] == "record: 16/40, 48 s left"
    assert len(lines) == int(80 / (PLAIN_INTERVAL + 1))


def test_a_resumed_bar_judges_its_pace_by_what_it_did_itself(clock, capsys):
    with Bar("fit", 100, done=50) as bar:
        clock.now += 20.0
        bar.advance(10, note="loss 0.1")
    assert capsys.readouterr().err == "fit: 60/100, 80 s left loss 0.1\n"


def test_quick_work_prints_nothing(capsys):
    assert list(track(iter("abc"), "quick", 3)) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""


def test_an_error_passes_through(capsys):
    with pytest.raises(RuntimeError), Bar("fit", 3):
        raise RuntimeError


def test_a_terminal_gets_a_bar(monkeypatch):
    monkeypatch.setattr(progress.sys.stderr, "isatty", lambda: True, raising=False)
    with Bar("fit", 3) as bar:
        bar.advance(2, note="loss 0.1")
        assert bar.rich is not None and bar.rich.tasks[0].completed == 2
        assert bar.rich.tasks[0].fields["note"] == "loss 0.1"

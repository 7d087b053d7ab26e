"""Figures that are no image metrics: names in full before families, labels, directions."""

import pytest

from prt.metrics.diagnostics import DIAGNOSTICS, diagnostic_label, diagnostic_of


@pytest.mark.parametrize(
    ("name", "direction", "once", "label"),
    [
        ("condition/transfer", "lower", True, "condition number, transfer"),
        ("negative/share", "lower", False, "negative, share"),
        ("flicker/median", "lower", True, "flicker, median"),
        ("eigenvalue/lost_energy", "lower", True, "eigenvalue, lost energy"),
        ("rmse/bound", "lower", False, "RMSE bound"),
        ("rmse/relative", "lower", False, "relative RMSE"),
        ("ratio/error", "lower", True, "ratio/error"),
        ("ratio/speedup", "higher", True, "ratio/speedup"),
        ("paths/record", "higher", True, "paths/record"),
    ],
)
def test_entries(name, direction, once, label):
    found = diagnostic_of(name)
    assert (found.direction, found.once, diagnostic_label(name)) == (direction, once, label)


def test_other_names_have_none():
    assert all(diagnostic_of(name) is None for name in ("psnr", "rmse", "rmse/other", "conditional/a"))


def test_every_entry_is_whole():
    assert all(
        d.definition.endswith(".") and d.direction in ("lower", "higher") for d in DIAGNOSTICS.values()
    )

"""``claims.csv`` for the page: every claim with its verdict over all scenes, and scene by scene."""

from pathlib import Path
from typing import Any

import pandas as pd

from prt.bench.html.measured import number
from prt.bench.verdicts import SCOPES, VERDICT_COLUMNS
from prt.errors import PrtError

VERDICTS = ("holds", "fails", "undecided")


def read(path: Path, name: str) -> list[dict[str, Any]]:
    """The claims in their order; none where there is no file.

    Raises:
        PrtError: if the file cannot be read.
    """
    if not path.exists():
        return []
    text = {column: str for column in ("claim", "scene", "verdict", "metric", "note")}
    try:
        table = pd.read_csv(path, dtype=text, keep_default_na=False, na_values={"difference": [""]})
        table = table[VERDICT_COLUMNS]
        found, scenes = [], []
        for row in table.to_dict("records"):
            if row["scene"] in SCOPES.values():  # a claim's last row
                claim = {key: row[key] for key in ("claim", "verdict", "metric", "note")}
                found.append({**claim, "scope": row["scene"], "scenes": scenes})
                scenes = []
            else:
                figures = {key: number(pd.to_numeric(row[key])) for key in ("difference", "lo", "hi", "n")}
                scenes.append({**{key: row[key] for key in ("scene", "verdict", "note")}, **figures})
    except (OSError, KeyError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())
        raise PrtError(f"cannot read {path} ({why}); write it again with `prt table {name}`") from error
    return found


def count(claims: list[dict[str, Any]]) -> dict[str, int]:
    """How many claims hold, fail, and are undecided."""
    found = [claim["verdict"] for claim in claims]
    return {verdict: found.count(verdict) for verdict in VERDICTS}

"""All reports put into one HTML file."""

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from prt.bench.html.content import read_report, summary
from prt.bench.html.folders import REPORTS, choose
from prt.cache import write_atomically
from prt.errors import PrtError

#: in the order they are read
STYLES = ("base.css", "index.css", "tables.css", "pictures.css")
SCRIPTS = (
    "dom.js", "format.js", "strips.js", "index.js", "sheets.js", "claims.js", "results.js", "charts.js",
    "viewer.js", "report.js", "app.js",
)  # fmt: skip


def main(names: Sequence[str], output: Path) -> int:
    """``prt report [names...] [--output FILE]``: write the file, say where it lies.

    Raises:
        PrtError: without reports, for an unknown name, a damaged report, or a file that cannot be written.
    """
    if output.is_dir():
        raise PrtError(f"--output {output} is a folder; name a file, as {output / 'report.html'}")
    chosen = choose(names)
    content = build([read_report(name, REPORTS / name) for name in chosen]).encode()
    write_atomically(output, content)
    tables = "1 table" if len(chosen) == 1 else f"{len(chosen)} tables"
    print(f"{output}: {tables}, {len(content) / 1e6:.1f} MB")
    return 0


def build(reports: Sequence[dict[str, Any]]) -> str:
    """The page of these reports; the same text for the same reports."""
    script = "(() => {\n" + "\n".join(map(asset, SCRIPTS)) + "\n})();"
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    data = [_json("index", [summary(report) for report in reports])]
    data += [_json(f"report-{number}", report) for number, report in enumerate(reports)]
    parts = {
        "digest": digest,
        "style": "\n".join(map(asset, STYLES)),
        "data": "\n".join(data),
        "script": script,
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], asset("page.html"))


def asset(name: str) -> str:
    """A file of ``assets/``."""
    return (files(__package__) / "assets" / name).read_text(encoding="utf-8")


def _json(name: str, content: Any) -> str:
    """Data in an element that is no script, and cannot be left early: no character of it is a markup's."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" id="{name}">{text}</script>'

"""One report folder read for the page: plain data, every text still as it stands in the files."""

import re
from pathlib import Path
from typing import Any

import pandas as pd

from prt.bench.html import markdown, measured, pictures, svg, verdicts
from prt.bench.html.folders import paper_of
from prt.bench.html.markdown import Block, plain

#: the images that have a place of their own on the page
FIGURE = "figure.png"
_COMMIT = re.compile(r"commit ([0-9a-f]{7,40}(?:, [0-9a-f]{7,40})*)( with uncommitted changes)?")
_DATE = re.compile(r"\b(\d{4}-\d\d-\d\d)T\d\d:\d\d")


def read_report(name: str, folder: Path) -> dict[str, Any]:
    """Everything the page shows of a report.

    Raises:
        PrtError: for a results.csv or claims.csv that cannot be read.
    """
    table = measured.read(folder / "results.csv", name)
    claims = verdicts.read(folder / "claims.csv", name)
    document = markdown.blocks(_text(folder / "report.md"))
    parts = markdown.sections(document)
    prose = [
        {"title": title, "blocks": found}
        for title, found in parts[1:]
        if found and not any(b["kind"] == "table" for b in found)
    ]
    opening = [b for b in parts[0][1] if b["kind"] in ("p", "list")]
    about = [b for b in opening if not _points_elsewhere(b)]
    command = _command(opening) or f"prt table {name}"
    known = list(dict.fromkeys([*table["metric"], *(claim["metric"] for claim in claims)]))
    results = measured.columns(table)
    return {
        "name": name,
        "title": markdown.title(document) or name,
        "about": about,
        "command": command,
        "facts": _facts(prose, table),
        "metrics": measured.metrics(known),
        "results": results,
        "claims": claims,
        "sheets": _sheets(_text(folder / "table.md")),
        "charts": _charts(folder, document),
        "figure": pictures.figure(folder, command),
        "pictures": _pictures(folder, document),
        "prose": prose,
    }


def summary(report: dict[str, Any]) -> dict[str, Any]:
    """A report's line in the index, and the words it is found by."""
    words = report["results"]["words"]
    return {
        "name": report["name"],
        "paper": paper_of(report["name"]),
        "title": report["title"],
        "about": " ".join(plain(b["spans"]) for b in report["about"] if b["kind"] == "p"),
        "verdicts": verdicts.count(report["claims"]),
        "commit": report["facts"]["commit"],
        "date": report["facts"]["date"],
        "figures": len(report["results"]["value"]),
        "charts": len(report["charts"]),
        "pictures": len(report["pictures"]) + bool(report["figure"]),
        "words": {key: words[key] for key in ("scene", "method", "variant", "split", "metric")},
        "claims": [[claim["claim"], claim["verdict"]] for claim in report["claims"]],
    }


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _command(opening: list[Block]) -> str:
    """How the report says it is written again."""
    for block in opening:
        spans = block.get("spans") or []
        if spans and isinstance(spans[0], str) and spans[0].startswith("Regenerate with"):
            return next((span[1] for span in spans if not isinstance(span, str)), "")
    return ""


def _points_elsewhere(block: Block) -> bool:
    """Whether a paragraph only leads to other files of the folder, or captions one of its pictures."""
    spans = block.get("spans") or [""]
    text = plain(spans)
    if len(spans) == 1 and not isinstance(spans[0], str) and spans[0][0] == "i":
        return True
    return text.startswith(("Regenerate with", "More tables:", "More forms:"))


def _facts(prose: list[dict[str, Any]], table: pd.DataFrame) -> dict[str, str]:
    """Commit, date, device and budget, as far as the report says; of measured rows, not the paper's."""
    how = next((part["blocks"] for part in prose if part["title"].startswith("How it was")), [])
    lines = [plain(item) for block in how if block["kind"] == "list" for item in block["items"]]
    text = "\n".join(line for line in lines if line.startswith(("system:", "code:")))
    commit, date = _COMMIT.search(text), _DATE.search(text)
    measured_rows = table[table["n"].notna()]
    return {
        "commit": ", ".join(c[:12] for c in commit[1].split(", ")) if commit else "",
        "changed": "yes" if commit and commit[2] else "",
        "date": date[1] if date else "",
        "device": "; ".join(filter(None, measured_rows["device"].unique())),
        "budget": ", ".join(filter(None, measured_rows["budget"].unique())),
    }


def _sheets(text: str) -> list[dict[str, Any]]:
    """The tables of table.md, each with its title and notes; the published ones say so."""
    sheets = []
    for title, found in markdown.sections(markdown.blocks(text)):
        for i, block in enumerate(found):
            if block["kind"] == "table":
                notes = (
                    found[i + 1]["items"] if found[i + 1 : i + 2] and found[i + 1]["kind"] == "list" else []
                )
                table = {key: block[key] for key in ("heads", "figures", "rows")}
                published = title.startswith("Published")
                sheets.append({"title": title, "published": published, **table, "notes": notes})
    return sheets


def _images(document: list[Block], ending: str) -> list[Block]:
    """Images the report shows that lie beside it."""
    shown = [b for b in document if b["kind"] == "image" and b["file"].endswith(ending)]
    return [b for b in shown if re.fullmatch(r"\w[\w.-]*", b["file"])]


def _charts(folder: Path, document: list[Block]) -> list[dict[str, Any]]:
    """The charts of report.md; one that is damaged or gone is left out."""
    found = []
    for number, image in enumerate(_images(document, ".svg")):
        try:
            drawn = svg.prepare(_text(folder / image["file"]), f"c{number}-")
        except ValueError:
            continue
        named = image["caption"] not in ("", image["file"].removesuffix(".svg"))
        caption = image["caption"] if named else ""
        found.append(
            {"file": image["file"], "caption": caption, "svg": drawn, "points": svg.has_points(drawn)}
        )
    return found


def _pictures(folder: Path, document: list[Block]) -> list[dict[str, Any]]:
    """Pictures beside the figure, with their captions."""
    wanted = [image for image in _images(document, ".png") if image["file"] != FIGURE]
    read = [(image, pictures.png(folder / image["file"])) for image in wanted]
    return [{"file": image["file"], "caption": image["caption"], **found} for image, found in read if found]

"""The Markdown that reports are written in, as plain data: blocks of spans, never HTML.

Only what :mod:`prt.bench.report`, ``layout`` and ``benchmark`` write is understood; all else is text.

A span is a text, ``[kind, text]`` of kind ``b``, ``i`` or ``code``, or ``["link", text, name]`` to a report.
A block is a dictionary, ``kind`` and

    h      level, text
    p      spans
    list   items, each spans
    table  heads (spans), figures (whether each column holds figures), rows of cells of spans
    image  file, caption
"""

import re
from typing import Any

Span = str | list[str]
Block = dict[str, Any]

_INLINE = re.compile(
    r"`([^`]+)`|\*\*(.+?)\*\*|(?<![\w*])\*([^*\s][^*]*)\*(?![\w*])|\[([^\]]*)\]\(([^)\s]*)\)"
)
#: what leads to another report
_REPORT = re.compile(r"(?:\.\./)+([\w.-]+(?:/[\w.-]+)*)/report\.md")
_IMAGE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
_RULE = re.compile(r"\|?(\s*:?-+:?\s*\|)+\s*(:?-+:?)?\s*")


def blocks(text: str) -> list[Block]:
    """A document in order."""
    found: list[Block] = []
    for part in re.split(r"\n\s*\n", text.replace("\r\n", "\n").strip()):
        lines = part.strip("\n").split("\n")
        while lines and lines[0].startswith("#"):
            mark, _, title = lines.pop(0).partition(" ")
            found.append({"kind": "h", "level": len(mark), "text": title.strip()})
        found += _lines(lines) if any(line.strip() for line in lines) else []
    return found


def _lines(lines: list[str]) -> list[Block]:
    image = _IMAGE.fullmatch(" ".join(lines).strip())
    if image:
        return [{"kind": "image", "file": image[2], "caption": image[1]}]
    if len(lines) > 1 and "|" in lines[0] and _RULE.fullmatch(lines[1]):
        return [_table(lines)]
    first = next((i for i, line in enumerate(lines) if line.startswith("- ")), None)
    if first is None:
        return [{"kind": "p", "spans": spans(" ".join(lines))}]
    before = _lines(lines[:first]) if first else []
    items: list[str] = []
    for line in lines[first:]:
        if line.startswith("- "):
            items.append(line[2:])
        else:
            items[-1] += f" {line.strip()}"
    return [*before, {"kind": "list", "items": [spans(item) for item in items]}]


def _table(lines: list[str]) -> Block:
    heads, rule, *rows = (cells(line) for line in lines if line.strip())
    figures = [mark.strip().endswith(":") for mark in rule]
    return {
        "kind": "table",
        "heads": [spans(head) for head in heads],
        "figures": (figures + [False] * len(heads))[: len(heads)],
        "rows": [[spans(cell) for cell in row] for row in rows],
    }


def cells(line: str) -> list[str]:
    """The cells of a table's row; ``\\|`` is a bar in a cell."""
    parts = re.split(r"(?<!\\)\|", line.strip().removeprefix("|"))
    if not parts[-1].strip():
        parts.pop()
    return [part.strip().replace("\\|", "|") for part in parts]


def spans(text: str) -> list[Span]:
    """A text with its emphasis; of a link to anything but a report only the words stay."""
    found: list[Span] = []
    at = 0
    for match in _INLINE.finditer(text):
        found += [text[at : match.start()]] if match.start() > at else []
        code, bold, italic, link, target = match.groups()
        if link is not None:
            report = _REPORT.fullmatch(target)
            found.append(["link", link, report[1]] if report else link)
        else:
            found.append(["code", code] if code else ["b", bold] if bold else ["i", italic])
        at = match.end()
    return [*found, text[at:]] if at < len(text) or not found else found


def plain(parts: list[Span]) -> str:
    """Spans without emphasis."""
    return "".join(part if isinstance(part, str) else part[1] for part in parts)


def sections(found: list[Block]) -> list[tuple[str, list[Block]]]:
    """Blocks under each heading but the document's own; what stands before the first has an empty title."""
    parts: list[tuple[str, list[Block]]] = [("", [])]
    for block in found:
        if block["kind"] == "h" and block["level"] > 1:
            parts.append((block["text"], []))
        elif block["kind"] != "h":
            parts[-1][1].append(block)
    return parts


def title(found: list[Block]) -> str:
    """The document's own heading, empty without one."""
    return next((block["text"] for block in found if block["kind"] == "h" and block["level"] == 1), "")

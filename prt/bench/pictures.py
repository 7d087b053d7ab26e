"""Pictures in a report folder that something else wrote, as a benchmark: checked, shown, missed.

A table's YAML names them: ``pictures: [{file: basis.png, caption: The first eight vectors}]``.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prt.errors import PrtError

Picture = dict[str, str]


def parse_pictures(given: Sequence[dict[str, Any]], taken: Sequence[str]) -> list[Picture]:
    """The ``pictures`` of a YAML.

    Args:
        given: ``file`` and ``caption`` of each.
        taken: names the report's own files have.

    Raises:
        PrtError: for a file that is no plain name ending in .png, or another one's.
    """
    found = []
    for entry in given:
        file = str(entry.get("file", ""))
        if not re.fullmatch(r"\w[\w.-]*\.png", file):
            raise PrtError(f"pictures: file {file!r} must be a name ending in .png, without a folder")
        if file in taken or file in [other["file"] for other in found]:
            raise PrtError(f"pictures: file {file!r} is another picture's name; choose another")
        found.append({"file": file, "caption": str(entry.get("caption") or "")})
    return found


def remove(pictures: Sequence[Picture], folder: Path) -> None:
    """Remove earlier ones, so that what is not written again does not stay."""
    for picture in pictures:
        (folder / picture["file"]).unlink(missing_ok=True)


def missing(pictures: Sequence[Picture], folder: Path) -> list[str]:
    """Notes of those that do not lie in the report folder."""
    names = [picture["file"] for picture in pictures]
    return [f"no picture {name}: it was not written" for name in names if not (folder / name).exists()]


def markdown(pictures: Sequence[Picture], folder: Path) -> list[str]:
    """Those that lie in the report folder, with their captions, for report.md."""
    parts = []
    for picture in pictures:
        file, caption = picture["file"], picture["caption"]
        if (folder / file).exists():
            parts += [f"![{caption or file}]({file})", *([f"*{caption}*"] if caption else [])]
    return parts

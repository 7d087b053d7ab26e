"""Which reports there are, and which of them are meant."""

import re
from collections.abc import Sequence
from pathlib import Path

from prt.errors import PrtError

#: where tables write their reports
REPORTS = Path("reports")


def find(root: Path = REPORTS) -> list[str]:
    """Names of all reports below ``root``, as ``raghavan2023/table1``: papers by name, numbers by size."""
    found = [path.parent.relative_to(root).as_posix() for path in root.rglob("results.csv")]
    return sorted((name for name in found if name != "."), key=_order)


def choose(names: Sequence[str], root: Path = REPORTS) -> list[str]:
    """The reports meant by ``names``: reports, or folders of them, as a paper; all of them without names.

    Raises:
        PrtError: where there are no reports, or none of a name.
    """
    known = find(root)
    if not known:
        raise PrtError(
            f"no reports in {root}/; write one with `prt table quickstart`, or go to the folder that has them"
        )
    wanted = set()
    for given in names:
        name = Path(given).as_posix().removeprefix(f"{root.as_posix()}/")
        matching = {report for report in known if name == report or report.startswith(f"{name}/")}
        if not matching and Path(given).as_posix() != root.as_posix():
            raise PrtError(
                f"no report {given!r}{_near(name, known)}; choose from {', '.join(choices(known))}"
            )
        wanted |= matching or set(known)
    return [name for name in known if name in wanted] if names else known


def choices(known: Sequence[str]) -> list[str]:
    """Papers, then reports."""
    return [*dict.fromkeys(paper_of(name) for name in known if paper_of(name)), *known]


def paper_of(name: str) -> str:
    """The folder a report stands in, empty for one by itself."""
    return name.rpartition("/")[0]


def _order(name: str) -> list:
    """Figure 10 after figure 3; reports of no paper last; what has a year is a paper."""
    paper, _, table = name.rpartition("/")
    parts = [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", table)]
    return [
        not re.search(r"\d{4}", paper),
        not paper,
        paper,
        [(isinstance(p, str), p) for p in parts if p != ""],
    ]


def _near(name: str, known: Sequence[str]) -> str:
    from prt.bench.compose import near  # it reads the configuration's groups: not needed where all is well

    return near(name, choices(known))

"""A table's YAML, read and checked.

It (``experiments/<paper>/<table>.yaml``) holds only its differences from ``conf/``::

    title: Table 1 of Raghavan et al. 2023
    grid:                        # one run for every combination; a value may carry further overrides,
      scene: [kitchen]           # as `wavelet_neural method.wavelets=16`, which then name the variant
      method: [wavelet_neural, neural_prt]  # `neural_prt@ladder`: in all its sizes (prt.bench.ladder)
      seed: [0]
    common: [lighting=hdri, budget=laptop]      # Hydra overrides of every run
    settings: {neural_prt: [method.training.steps=5000]}    # of one method's or one scene's runs; no variant
    columns: {metrics: [psnr, ssim], components: [full, indirect], splits: [far, near], views: ["far*"]}
    labels: {neural_prt: NPRT}
    published: published/table1.csv             # beside the YAML
    claims: ["wavelet_neural > neural_prt on psnr/indirect, far, every scene"]
    chart: {x: time/frame, y: psnr/indirect}
    charts: [{file: size, x: bytes/model, y: psnr/indirect}]      # further ones: chart_size.svg
    enough: {y: psnr/indirect, x: bytes/model, within: 0.5}       # prt.bench.enough: the smallest that does
    differences: {y: psnr/indirect, split: far}  # prt.bench.differences: in place of the chart
    figure:                      # rows may also have split, component, label, crops
      component: indirect
      columns: ["neural_prt", "wavelet_neural[wavelets=16]"]      # by default all
      rows: [{scene: kitchen, view: 0, lighting: 0}]
    curves: [{file: error, x: wavelets, y: psnr/indirect}]        # prt.bench.curves
    pictures: [{file: parts.png, caption: What it is made of}]    # other pictures in the report folder

``columns.splits`` are the task's own (by default all that were measured); ``columns.views`` keeps only the
test items of these views in tables, chart, curves and claims (``frame*`` for all that begin so).

A YAML with ``benchmark: {_target_: ...}`` measures instead of running methods: ``prt.bench.benchmark``; one
with ``matrix`` gathers figures of other reports: ``prt.bench.matrix``.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

import prt
from prt.bench import compose as composer
from prt.bench import ladder
from prt.bench.claims import Claim, parse_claims
from prt.bench.launchers import is_launcher, split
from prt.bench.pictures import Picture, parse_pictures
from prt.bench.where import listed, read_where
from prt.errors import PrtError
from prt.paths import data_folder

if TYPE_CHECKING:
    from prt.bench.curves import Curve

#: overrides that change where or how runs are kept, not what comes out of them
BOOKKEEPING = ("run.", "report")


@dataclass
class Spec:
    """A table's YAML with the command line's overrides, checked."""

    name: str
    path: Path
    title: str
    grid: dict[str, list[str]]
    common: list[str]
    report: Path
    overrides: list[str]
    about: str = ""
    columns: dict[str, Any] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=dict)
    published: Path | None = None
    claims: list[Claim] = field(default_factory=list)
    chart: dict[str, Any] = field(default_factory=dict)
    figure: dict[str, Any] = field(default_factory=dict)
    benchmark: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, list[str]] = field(default_factory=dict)
    curves: "list[Curve]" = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    launcher: list[str] = field(default_factory=list)  #: overrides that choose and configure it
    verb: str = "prt table"
    enough: dict[str, Any] = field(default_factory=dict)
    differences: dict[str, Any] = field(default_factory=dict)
    advice: dict[str, Any] | None = None  #: whether that of ``prt needs`` is judged; None: it is not
    charts: list[dict[str, Any]] = field(default_factory=list)  #: further ones, each with its ``file``

    @property
    def command(self) -> str:
        return " ".join([self.verb, self.name, *self.overrides])


KEYS = (
    "title", "about", "grid", "common", "settings", "columns", "labels", "published", "claims", "chart",
    "charts", "enough", "advice", "differences", "figure", "curves", "pictures", "benchmark", "without_data",
)  # fmt: skip
PART_KEYS = {
    "without_data": ("grid", "common"),
    "columns": ("metrics", "components", "splits", "views", "as_is"),
    "chart": ("x", "y", "split", "target", "where"),
    "enough": ("x", "y", "within", "split"),
    "differences": ("y", "split"),
    "advice": ("scenes",),
    "figure": ("component", "split", "denoised", "rows", "columns"),
}
#: of every entry of a list
ENTRY_KEYS = {
    "figure.rows": ("scene", "split", "view", "lighting", "component", "denoised", "label", "crops"),
    "pictures": ("file", "caption"),
    "charts": ("file", "x", "y", "split", "target", "where"),
}


def read_yaml(path: Path) -> dict[str, Any]:
    """The pairs of a YAML file, references resolved; empty where it has none.

    Raises:
        PrtError: where it cannot be read, or is no YAML.
    """
    try:
        content = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (OmegaConfBaseException, ValueError, OSError) as error:
        raise PrtError(f"cannot read {path}: {' '.join(str(error).split())}") from error
    except Exception as error:  # the YAML parser's own errors have no common base here
        raise PrtError(f"{path} is no YAML: {' '.join(str(error).split())}") from error
    return {str(key): value for key, value in content.items()} if isinstance(content, dict) else {}


def check_keys(path: Path, part: str, given: dict[str, Any], allowed: Sequence[str]) -> None:
    """A misspelt key is an error, not a setting nobody reads."""
    for key in given:
        if key not in allowed:
            name, hint = ".".join(filter(None, [part, str(key)])), composer.near(str(key), allowed)
            raise PrtError(f"{path}: unknown key {name!r}{hint}; allowed: {', '.join(allowed)}")


def experiment_folders() -> list[Path]:
    """Where tables are looked for: the current folder's ``experiments/``, then the project's."""
    found = [Path("experiments"), Path(prt.__file__).resolve().parent.parent / "experiments"]
    return [folder for folder in found if folder.is_dir()]


def load_spec(name: str, overrides: Sequence[str] = ()) -> Spec:
    """Read and check a table's YAML, with the command line's overrides put in place.

    Where ``PRT_DATA`` is not set, the YAML's ``without_data`` takes the place of its ``grid`` and ``common``.
    An override of a grid axis replaces its values (``scene=a,b``); ``report=<folder>`` says where to write;
    ``benchmark.<key>`` changes a benchmark's setting; ``launcher=...`` and its settings say where runs are
    carried out, and are no part of them; every other one replaces or joins ``common``. Overrides that change
    results get a folder of their own.

    Raises:
        PrtError: for an unknown table or key, a grid without scenes or methods, a wrong claim or override.
    """
    path = find(name)
    content = read_yaml(path)
    check_keys(path, "", content, KEYS)
    for part, allowed in PART_KEYS.items():
        check_keys(path, part, content.get(part) or {}, allowed)
    for part, allowed in ENTRY_KEYS.items():
        for entry in entries(path, part, content):
            check_keys(path, part, entry, allowed)
    if data_folder() is None:
        content |= content.get("without_data") or {}
    benchmark = content.get("benchmark") or {}
    if benchmark and not benchmark.get("_target_"):
        raise PrtError(f"{path}: benchmark has no _target_; name the function that measures")
    grid = {str(key): [str(v) for v in listed(value)] for key, value in (content.get("grid") or {}).items()}
    if not grid.get("scene") or not (grid.get("method") or benchmark):
        raise PrtError(f"{path}: grid must list at least one scene and one method")
    grid.setdefault("seed", ["0"])
    launcher, common = split(str(c) for c in content.get("common") or [])
    changed, report = [], None
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise PrtError(f"cannot read {text!r}: an override is key=value, as scene=kitchen,bathroom")
        if key == "report":
            report = Path(value)
        elif is_launcher(text):
            launcher += [text]
        elif key in grid:
            changed += [text] if grid[key] != value.split(",") else []
            grid[key] = value.split(",")
        elif benchmark and key.startswith("benchmark."):
            changed += [text]
            added = OmegaConf.from_dotlist([text.removeprefix("benchmark.")])
            benchmark = OmegaConf.to_container(OmegaConf.merge(benchmark, added))
        else:
            new = text not in common and not key.startswith(BOOKKEEPING)
            changed += [text] if new else []
            common = [c for c in common if c.partition("=")[0].lstrip("+") != key.lstrip("+")] + [text]
    if grid.get("method"):
        grid["method"] = ladder.expand(grid["method"], common)
    slug = "_".join(re.sub(r"[^\w.,]+", "-", text) for text in changed)
    claims = parse_claims(content.get("claims") or [], needs_split=not benchmark)
    if content.get("enough"):
        from prt.bench import enough  # knows charts, and so matplotlib, which other commands can do without

        enough.check(content["enough"])
    if content.get("advice") is not None and not content.get("enough"):
        raise PrtError(f"{path}: advice is judged against what is enough; give enough: {{x, y, within}}")
    if content.get("differences"):
        from prt.bench import differences

        differences.check(content["differences"])
    charts = content.get("charts") or []
    for entry in (content.get("chart") or {}, *charts):
        read_where(entry.get("where"))  # a mistake is found before hours of runs
    for entry in charts:
        if not re.fullmatch(r"\w+", str(entry.get("file", ""))):
            raise PrtError(f"{path}: charts: file={entry.get('file')!r} must be a plain word")
    published = content.get("published")
    columns = {key: [str(v) for v in listed(value)] for key, value in (content.get("columns") or {}).items()}
    return Spec(
        name, path, str(content.get("title") or name), grid, common,
        report or Path("reports") / (name + ("_" + slug if slug else "")), split(overrides)[1],
        content.get("about") or "", columns, content.get("labels") or {},
        path.parent / published if published else None,
        claims, content.get("chart") or {}, content.get("figure") or {}, benchmark,
        named_settings(path, content.get("settings") or {}, grid),
        *drawn(path, content), launcher, charts=charts,
        enough=content.get("enough") or {}, differences=content.get("differences") or {},
        advice=content.get("advice"),
    )  # fmt: skip


def entries(path: Path, part: str, content: dict[str, Any]) -> list[dict[str, Any]]:
    """A list of settings in the YAML, ``part`` its dotted name; empty where it is not given.

    Raises:
        PrtError: for anything but a list of pairs.
    """
    found: Any = content
    for name in part.split("."):
        found = (found or {}).get(name)
    if not isinstance(found or [], list) or not all(isinstance(entry, dict) for entry in found or []):
        raise PrtError(f"{path}: {part} must be a list of entries, as [{{key: value}}]")
    return found or []


def drawn(path: Path, content: dict[str, Any]) -> "tuple[list[Curve], list[Picture]]":
    """The ``curves`` and the ``pictures`` of a YAML, checked; raises PrtError for a mistake in them."""
    curves = []
    try:
        if entries(path, "curves", content):
            from prt.bench.curves import (
                parse_curves,  # draws in matplotlib, which other commands can do without
            )

            curves = parse_curves(content["curves"])
        charts = [f"chart_{entry['file']}.png" for entry in content.get("charts") or []]
        taken = [
            "chart.png",
            "differences.png",
            "figure.png",
            *charts,
            *(f"{curve.file}.png" for curve in curves),
        ]
        return curves, parse_pictures(entries(path, "pictures", content), taken)
    except PrtError as error:
        raise PrtError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


def named_settings(path: Path, given: dict[str, Any], grid: dict[str, list[str]]) -> dict[str, list[str]]:
    """The overrides of single methods, scenes, and methods on one scene (``scene/method``).

    Those of what the command line left out are not needed.
    """
    methods, scenes = composer.choices("method"), composer.choices("scene")
    for name in given:
        scene, both, method = str(name).partition("/")
        if both and scene in scenes and method in methods:
            continue
        if both or name not in methods + scenes:
            hint = composer.near(str(name), methods + scenes)
            raise PrtError(
                f"{path}: settings names {name!r}, which is no method, scene or scene/method{hint}; choose "
                f"from {', '.join(methods + scenes)}"
            )
    chosen = {value.split()[0] for axis in ("method", "scene") for value in grid.get(axis, [])}
    return {
        name: [str(text) for text in listed(given[name])]
        for name in given
        if all(part in chosen for part in str(name).split("/"))
    }


def find(name: str) -> Path:
    """The YAML of a table: a name below ``experiments/`` or a path."""
    candidates = [Path(name), *(folder / f"{name}.yaml" for folder in experiment_folders())]
    for path in candidates:
        if path.is_file() and path.suffix in (".yaml", ".yml"):
            return path
    known = [
        str(p.relative_to(f).with_suffix("")) for f in experiment_folders() for p in sorted(f.rglob("*.yaml"))
    ]
    known = list(dict.fromkeys(known))
    raise PrtError(f"no table {name!r}{composer.near(name, known)}; choose from {', '.join(known) or 'none'}")


def has_matrix(path: Path) -> bool:
    """Whether a YAML is a matrix of failures, which reads reports and runs nothing (prt.bench.matrix)."""
    return any(line.startswith("matrix:") for line in path.read_text(encoding="utf-8").splitlines())

"""``prt table``: a table's YAML resolved to runs, the missing ones run, and the report made.

A table's YAML (``experiments/<paper>/<table>.yaml``) holds only its differences from ``conf/``::

    title: Table 1 of Raghavan et al. 2023
    grid:                        # one run for every combination; a value may carry further overrides,
      scene: [kitchen]           # as `wavelet_neural method.wavelets=16`, which then name the variant
      method: [wavelet_neural, neural_prt]
      seed: [0]
    common: [lighting=hdri, budget=laptop]      # Hydra overrides of every run
    settings: {neural_prt: [method.training.steps=5000]}    # of one method's runs; no variant
    columns: {metrics: [psnr, ssim], components: [full, indirect], splits: [far, near]}
    labels: {neural_prt: NPRT}
    published: published/table1.csv             # beside the YAML
    claims: ["wavelet_neural > neural_prt on psnr/indirect, far, every scene"]
    chart: {x: time/frame, y: psnr/indirect}
    figure: {component: indirect, rows: [{scene: kitchen, view: 0, lighting: 0}]}

A YAML with ``benchmark: {_target_: ...}`` measures instead of running methods: ``prt.bench.benchmark``.
"""

import itertools
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import prt
from prt.bench import compose as composer
from prt.bench import run as runner
from prt.bench.claims import Claim, parse_claims
from prt.bench.layout import Layout
from prt.bench.results import Cell
from prt.cache import write_atomically
from prt.errors import PrtError
from prt.metrics.registry import METRICS
from prt.paths import data_folder

#: overrides that change where or how runs are kept, not what comes out of them
BOOKKEEPING = ("run.", "report")


#: grid axes with columns of their own in the results; all others make the variant
NAMED = ("scene", "method", "seed")


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

    @property
    def command(self) -> str:
        return " ".join(["prt table", self.name, *self.overrides])


KEYS = (
    "title", "about", "grid", "common", "settings", "columns", "labels", "published", "claims", "chart",
    "figure", "benchmark", "without_data",
)  # fmt: skip
PART_KEYS = {
    "without_data": ("grid", "common"),
    "columns": ("metrics", "components", "splits", "as_is"),
    "chart": ("x", "y", "split"),
    "figure": ("component", "split", "denoised", "rows"),
}


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
    ``benchmark.<key>`` changes a benchmark's setting; every other one replaces or joins ``common``. Overrides
    that change results get a folder of their own.

    Raises:
        PrtError: for an unknown table or key, a grid without scenes or methods, a wrong claim or override.
    """
    path = find(name)
    try:
        content = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (OmegaConfBaseException, ValueError, OSError) as error:
        raise PrtError(f"cannot read {path}: {' '.join(str(error).split())}") from error
    except Exception as error:  # the YAML parser's own errors have no common base here
        raise PrtError(f"{path} is no YAML: {' '.join(str(error).split())}") from error
    content = content if isinstance(content, dict) else {}
    check_keys(path, "", content, KEYS)
    for part, allowed in PART_KEYS.items():
        check_keys(path, part, content.get(part) or {}, allowed)
    if data_folder() is None:
        content |= content.get("without_data") or {}
    benchmark = content.get("benchmark") or {}
    if benchmark and not benchmark.get("_target_"):
        raise PrtError(f"{path}: benchmark has no _target_; name the function that measures")
    grid = {str(key): [str(v) for v in _listed(value)] for key, value in (content.get("grid") or {}).items()}
    if not grid.get("scene") or not (grid.get("method") or benchmark):
        raise PrtError(f"{path}: grid must list at least one scene and one method")
    grid.setdefault("seed", ["0"])
    common, changed, report = [str(c) for c in content.get("common") or []], [], None
    for text in overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise PrtError(f"cannot read {text!r}: an override is key=value, as scene=kitchen,bathroom")
        if key == "report":
            report = Path(value)
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
    slug = "_".join(re.sub(r"[^\w.,]+", "-", text) for text in changed)
    claims = parse_claims(content.get("claims") or [])
    published = content.get("published")
    return Spec(
        name, path, str(content.get("title") or name), grid, common,
        report or Path("reports") / (name + ("_" + slug if slug else "")), list(overrides),
        content.get("about") or "", content.get("columns") or {}, content.get("labels") or {},
        path.parent / published if published else None,
        claims, content.get("chart") or {}, content.get("figure") or {}, benchmark,
        method_settings(path, content.get("settings") or {}, grid.get("method", [])),
    )  # fmt: skip


def method_settings(path: Path, given: dict[str, Any], methods: Sequence[str]) -> dict[str, list[str]]:
    """The overrides of single methods; those of a method the command line left out are not needed."""
    known = composer.choices("method")
    for method in given:
        if method not in known:
            hint = composer.near(str(method), known)
            raise PrtError(
                f"{path}: settings names the method {method!r}{hint}; choose from {', '.join(known)}"
            )
    chosen = {value.split()[0] for value in methods}
    return {name: [str(text) for text in _listed(given[name])] for name in given if name in chosen}


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


def _listed(value: Any) -> list:
    return value if isinstance(value, list) else [value]


def grid_overrides(spec: Spec) -> list[tuple[list[str], str]]:
    """Every run of the grid, scene by scene: (Hydra overrides, variant)."""
    axes = ["scene", *(k for k in spec.grid if k not in NAMED), "method", "seed"]
    axes = [axis for axis in axes if axis in spec.grid]  # a benchmark has no methods
    found = []
    for values in itertools.product(*(spec.grid[axis] for axis in axes)):
        variant: list[str] = []
        overrides: list[str] = []
        of_method: list[str] = []
        for axis, value in zip(axes, values, strict=True):
            first, *extra = value.split()
            of_method = spec.settings.get(first, []) if axis == "method" else of_method
            overrides.append(f"{axis}={first}")
            overrides += extra
            variant += [short(text) for text in ([] if axis in NAMED else [f"{axis}={first}"]) + extra]
        # the command line's settings are in common and win
        found.append(([*of_method, *spec.common, *overrides], ",".join(variant)))
    return found


def short(override: str) -> str:
    """``method.wavelets=16`` as ``wavelets=16``, the form variants are written in."""
    key, equals, value = override.lstrip("+").partition("=")
    return key.rpartition(".")[2] + equals + value


def resolve(spec: Spec) -> list[tuple[Cell, DictConfig]]:
    """The grid as cells with their composed configurations; a mistake in any stops before anything runs."""
    cells = []
    for overrides, variant in grid_overrides(spec):
        cfg = composer.compose(overrides)
        cell = Cell(
            cfg.choice.scene, cfg.choice.method, variant, int(cfg.seed), str(cfg.budget.name),
            runner.folder_of(cfg), tuple(overrides),
        )  # fmt: skip
        cells.append((cell, cfg))
    return cells


def layout_of(spec: Spec, cells: Sequence[Cell]) -> Layout:
    """Order and labels of rows and columns, from the grid and ``columns``.

    Raises:
        PrtError: for an unknown metric in ``columns``.
    """
    for metric in spec.columns.get("metrics", []):
        if metric not in METRICS:
            raise PrtError(
                f"{spec.path}: unknown metric {metric!r} in columns.metrics; choose from {', '.join(METRICS)}"
            )
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    methods = list(dict.fromkeys((cell.method, cell.variant) for cell in cells))
    return Layout(scenes, methods, labels=spec.labels, **spec.columns)


def run_missing(
    cells: Sequence[tuple[Cell, DictConfig]], carry_out: Callable[[DictConfig], Any] = runner.run
) -> dict[Cell, str]:
    """Run what is not done; returns the reasons of those that failed, which do not stop the rest."""
    failed: dict[Cell, str] = {}
    todo = [(cell, cfg) for cell, cfg in cells if not cell.done]
    say(f"{len(cells)} runs: {len(cells) - len(todo)} done already, {len(todo)} to run")
    started = time.monotonic()
    for number, (cell, cfg) in enumerate(todo):
        spent = time.monotonic() - started
        left = f", about {clock(spent / number * (len(todo) - number))} left" if number else ""
        variant = f" {cell.variant}" if cell.variant else ""
        place = f"[{number + 1}/{len(todo)}] {cell.scene} {cell.method}{variant} seed {cell.seed}"
        say(f"{place}: {clock(spent)} elapsed{left}")
        try:
            carry_out(cfg)
        except PrtError as error:
            failed[cell] = str(error)
        except (
            Exception
        ) as error:  # a bug in one run must not cost the others; its traceback lies in its folder
            failed[cell] = f"{type(error).__name__}: {' '.join(str(error).split())}"
        if cell in failed:
            say(f"    failed: {failed[cell]}")
    return failed


def clock(seconds: float) -> str:
    """``42 s``, ``3 min 05 s``, ``1 h 12 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main(name: str, overrides: Sequence[str] = (), dry_run: bool = False) -> int:
    """``prt table <name> [--dry-run] [overrides]``: run what is missing, write the report, print the table.

    Returns 1 where some run failed, else 0. Raises PrtError for a mistake in the YAML or the overrides.
    """
    spec = load_spec(name, overrides)
    if spec.benchmark:
        from prt.bench import benchmark

        return benchmark.main(spec, dry_run)
    cells = resolve(spec)
    layout = layout_of(spec, [cell for cell, _ in cells])
    if dry_run:
        print(f"{spec.title}: {len(cells)} runs, report in {spec.report}")
        for cell, _ in cells:
            print(f"  {cell.run.state():8} {cell.run.path}  prt run {' '.join(cell.overrides)}")
        return 0
    check_writable(spec.report)  # before hours of runs, not after
    failed = run_missing(cells)

    from prt.bench.report import write_report

    write_report(spec, layout, [cell for cell, _ in cells], failed, references=TaskReferences(dict(cells)))
    return 1 if failed else 0


def check_writable(folder: Path) -> None:
    """Raises PrtError where the report could not be written."""
    probe = folder / ".writable"
    write_atomically(probe, b"")
    probe.unlink()


class TaskReferences:
    """Reference images for the figure, from the task itself (its cache holds them)."""

    def __init__(self, configs: dict[Cell, DictConfig]):
        self.configs = configs
        self.kept: tuple[str, list[Any]] = ("", [])

    def __call__(self, cell: Cell, split: str, view: str, lighting: str) -> dict[str, Any]:
        if self.kept[0] != cell.scene:
            self.kept = (cell.scene, runner.build_task(self.configs[cell]).tests())
        for item in self.kept[1]:
            if (str(item.split), str(item.view_name), str(item.lighting_name)) == (split, view, lighting):
                return {component: image.numpy() for component, image in item.references.items()}
        raise PrtError(
            f"the task has no test image {split}/{view}/{lighting}; were its settings changed since the run?"
        )

"""A folder ``reports/`` for tests of the HTML report: two that the project wrote itself, a hostile one."""

import base64
import io
import os
from pathlib import Path

from rich.console import Console
from synthetic_runs import fake_references, make_run

from prt.bench import report, table
from prt.bench.results import COLUMNS
from prt.bench.verdicts import VERDICT_COLUMNS

YAML = """
title: Table 1 of Nobody 2024
about: Two methods in a box and a den.
grid:
  scene: [box, den]
  method: [wavelet_neural, neural_prt, path_traced]
common: [lighting=hdri, budget=laptop]
columns: {as_is: path_traced}
labels: {wavelet_neural: Ours, neural_prt: NPRT}
published: paper.csv
claims:
  - "wavelet_neural > neural_prt on psnr/indirect, far, every scene"
  - "path_traced > neural_prt on psnr/indirect, far, every scene"
  - "wavelet_neural > 30 on psnr/indirect, far, every scene"
curves: [{file: share, x: none, y: psnr/indirect}]
figure: {component: indirect, rows: [{scene: box}, {scene: den, view: view1}]}
"""
#: one figure beside a measured one, one that only the paper has
PAPER = (
    ",".join(COLUMNS)
    + "\nbox,wavelet_neural,denoised,paper,GPU,far,full,psnr,,,,,,12.34"
    + "\nden,old_method,,paper,GPU,far,full,psnr,,,,,,56.78\n"
)
ATTACK = '<script>window.hacked="{}"</script><img src=x onerror="window.hacked=1">'
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def write_reports(root: Path) -> Path:
    """``root/reports`` with nobody2024/table1, nobody2024/figure10 (an older one) and hostile2024/table2."""
    before = Path.cwd()
    os.chdir(root)
    try:
        _own_report(root, "nobody2024/table1")
        _own_report(root, "nobody2024/figure10", images=False)
    finally:
        os.chdir(before)
    hostile_report(root / "reports" / "hostile2024" / "table2")
    return root / "reports"


def _own_report(root: Path, name: str, images: bool = True) -> None:
    path = root / "experiments" / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(YAML if images else YAML.replace("Table 1 of Nobody", "Figure 10 of Somebody"))
    (path.parent / "paper.csv").write_text(PAPER)
    spec = table.load_spec(name)
    cells = [
        make_run(root / "runs" / name, scene, method, images=images, denoise=method != "path_traced")
        for scene in spec.grid["scene"]
        for method in spec.grid["method"]
    ]
    references = fake_references if images else None
    console = Console(file=io.StringIO(), width=160)
    report.write_report(spec, table.layout_of(spec, cells), cells, None, references, console)


def hostile_report(folder: Path) -> None:
    """Every text that a report may hold is an attack."""
    folder.mkdir(parents=True)
    text = {name: ATTACK.format(name).replace('"', '""') for name in (*COLUMNS, *VERDICT_COLUMNS)}
    keys = ",".join(f'"{text[name]}"' for name in COLUMNS[:7])
    (folder / "results.csv").write_text(
        ",".join(COLUMNS) + f'\n{keys},psnr,30.5,29,32,4,1,\n{keys},"{text["metric"]}",inf,,,4,1,\n'
    )
    claim = f'"{text["claim"]}","{text["scene"]}",holds,"{text["metric"]}",1,0.5,2,4,"{text["note"]}"\n'
    overall = f'"{text["claim"]}",every scene,"{text["verdict"]}",psnr,,,,,"{text["note"]}"\n'
    (folder / "claims.csv").write_text(",".join(VERDICT_COLUMNS) + "\n" + claim + overall)
    (folder / "report.md").write_text(
        f"# {ATTACK.format('title')}\n\nAbout `{ATTACK.format('code')}` **{ATTACK.format('bold')}** "
        f"[{ATTACK.format('link')}](javascript:alert(1)) </script>\n\n"
        "![bad](chart.svg)\n\n![worse](../../../secret.svg)\n\n![far](https://example.org/far.svg)\n\n"
        "![Speed](figure.png)\n\n"
        f"## How it was run\n\n- code: commit 0123456789ab, {ATTACK.format('how')}\n"
    )
    (folder / "table.md").write_text(
        f"# t\n\n## {ATTACK.format('sheet')}\n\n| {ATTACK.format('head')} | x |\n|---|---:|\n"
        f"| {ATTACK.format('cell')} | **1** |\n\n- {ATTACK.format('note')}\n"
    )
    (folder / "chart.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        'viewBox="0 0 9 9" onload="window.hacked=1"><script>window.hacked=1</script><style>* {}</style>'
        '<image href="https://example.org/a.png"/><a xlink:href="javascript:alert(1)"><path d="M 0 0"/></a>'
        '<foreignObject><body xmlns="http://www.w3.org/1999/xhtml" onload="window.hacked=1"/></foreignObject>'
        '<use xlink:href="https://example.org/a.svg#a"/><path id="kept" d="M 0 0 L 9 9" onclick="alert(1)" '
        'style="fill: #ffffff; background: url(https://example.org/b.png)" clip-path="url(#clip)"/></svg>'
    )
    (folder / "figure.png").write_bytes(PIXEL)
    (folder / "figure.json").write_text('{"width": 5, "height": 5, "rows": [], "panels": []}')

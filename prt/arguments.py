"""The words of the command line: subcommands, options, help with examples and the choices of ``conf/``."""

import argparse
import sys
import textwrap
from pathlib import Path

from prt.errors import PrtError

EXAMPLES = {
    "prt": """
        prt doctor                                                     what works on this machine
        prt run scene=cornell_glossy method=wavelet_neural             one method on one scene
        prt run -m scene=cornell_glossy,kitchen seed=0,1,2             a sweep
        prt table quickstart                                           run what is missing, write the report
        prt needs scene=kitchen lighting=hdri                          what to use, without training
        prt select scene=kitchen "target=psnr/indirect>=26"            the smallest model that is good enough
        prt report                                                     all reports in one HTML file
        prt status                                                     what is done, failed, stopped""",
    "run": """
        prt run scene=cornell_glossy method=wavelet_neural method.wavelets=32 budget=laptop
        prt run -m scene=cornell_glossy,four_shapes seed=0,1,2         every combination, one after the other
        prt run -m launcher=ray scene=cornell_glossy,kitchen           several at a time; also local, slurm
        prt run --conf-dir mine method=my_method                       names a class of your own
        prt run --show scene=kitchen                                   settings and run folder only""",
    "table": """
        prt table quickstart
        prt table raghavan2023/table1 budget=laptop
        prt table raghavan2023/table1 --dry-run                  the runs of the grid and their states
        prt table raghavan2023/table1 launcher=slurm launcher.partition=gpu launcher.gpus=1""",
    "select": """
        prt select scene=kitchen method=wavelet_neural "target=psnr/indirect>=26"
        prt select scene=kitchen "target=time/shade<=0.05"             the best that is fast enough
        prt select "target=psnr/indirect>=26" over=method.wavelets=4,8,16,32,64
        prt select task=relight_direct scene=teaset "target=mape/direct<=0.05" split=diffuse""",
    "needs": """
        prt needs scene=kitchen lighting=hdri                    wavelets, rank, shares of light, cells
        prt needs scene=many scene.variables=7                   which variables matter
        prt needs scene=cornell_box lighting=spots               how many patterns lightmaps have""",
    "view": """
        prt view runs/relight_indirect/kitchen/wavelet_neural/0123456789
        prt view runs/.../wavelet_neural/... runs/.../neural_prt/...   two beside each other""",
    "export": """
        prt export runs/relight_indirect/kitchen/wavelet_neural/0123456789     the environment turns
        prt export runs/... --kind turntable --frames 96 --size 512 --formats mp4,exr""",
    "report": """
        prt report                                               all of reports/ in one file, report.html
        prt report raghavan2023 quickstart                       some papers or tables
        prt report raghavan2023/table1 --output table1.html""",
    "status": """
        prt status
        prt status --folder runs/relight_indirect/kitchen""",
    "score": """
        prt score runs/relight_indirect/cornell_glossy                 every finished run below it""",
    "doctor": """
        prt doctor""",
}
ABOUT = {
    "run": "Run a method on a scene, or a sweep (-m). Finished runs are skipped, interrupted ones resume.",
    "table": "Regenerate a table or figure of experiments/: run what is missing, then write reports/<name>/.",
    "needs": "Measure in minutes, without training, what a scene asks of a model; recommend method and size.",
    "select": "Walk a method's sizes from the smallest on; answer with the first that meets a target.",
    "report": "Make one HTML file of reports/: tables, claims, charts and pictures, to open from disk.",
    "view": "Look at finished runs in the browser: move the camera, the light, the scene's variables.",
    "export": "Render a finished run as a turntable or a relighting sequence: PNG, EXR, MP4.",
    "status": "List runs by state, read from their folders.",
    "score": "Recompute metrics from the stored images, without fitting anything.",
    "doctor": "Show what works on this machine, what is missing, and how to get it.",
}
#: commands whose words are Hydra overrides
COMPOSED = ("run", "table", "needs", "select")
SETTINGS = "choices and settings, see below"
OVERRIDES = {
    "select": "target=<figure><sign><value> (in quotes), then any of over=<setting>=a,b,c (in place of the "
    "method's ladder), split=, quality= (psnr/indirect, what ranks rungs), report=<folder>; and " + SETTINGS,
}


class Parser(argparse.ArgumentParser):
    """argparse with errors of one line."""

    def error(self, message: str):
        raise PrtError(f"{message}; `{self.prog} --help` shows what is possible")


def parser() -> Parser:
    """The command line; help texts list the choices found in conf/."""
    style = argparse.RawDescriptionHelpFormatter
    top = Parser(
        "prt",
        formatter_class=style,
        epilog=examples("prt"),
        description="Reference experiments for precomputed radiance transfer.",
    )
    top.add_argument("--debug", action="store_true", help="show the traceback of an error")
    subs = top.add_subparsers(dest="command", metavar="<command>", parser_class=Parser)
    for name, about in ABOUT.items():
        epilog = examples(name) + (groups_help() if name in COMPOSED and wants_help() else "")
        sub = subs.add_parser(name, help=about, description=about, formatter_class=style, epilog=epilog)
        sub.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        if name in COMPOSED:
            sub.add_argument(
                "--conf-dir",
                action="append",
                default=[],
                metavar="FOLDER",
                help="a folder with your own method/, scene/, ... YAML files; may be repeated",
            )
        if name == "run":
            sub.add_argument(
                "-m",
                "--multirun",
                action="store_true",
                help="sweep over comma-separated values, on any launcher",
            )
            sub.add_argument("--show", action="store_true", help="print the settings, run nothing")
        if name == "table":
            sub.add_argument("name", help="a YAML of experiments/, as raghavan2023/table1")
            sub.add_argument(
                "--dry-run", action="store_true", help="list the runs and their states, run nothing"
            )
        if name in COMPOSED:
            sub.add_argument("overrides", nargs="*", metavar="key=value", help=OVERRIDES.get(name, SETTINGS))
        if name == "report":
            sub.add_argument("names", nargs="*", metavar="name", help="tables or papers (default: all)")
            sub.add_argument(
                "--output", default="report.html", type=Path, metavar="FILE", help="default: report.html"
            )
        if name == "view":
            sub.add_argument(
                "runs", nargs="+", type=Path, metavar="run", help="folders of one or two finished runs"
            )
            sub.add_argument("--port", default=8080, type=int, help="default: 8080; 0 for any")
            sub.add_argument("--host", default="127.0.0.1", help="0.0.0.0 to be seen from other machines")
            sub.add_argument("--component", default=None, help="full, indirect or direct")
            sub.add_argument("--size", default=384, type=int, help="pixels of a still picture's height")
        if name == "export":
            sub.add_argument("run", type=Path, help="folder of a finished run")
            sub.add_argument("--kind", default="relight", help="relight (default) or turntable")
            sub.add_argument("--frames", default=48, type=int)
            sub.add_argument("--size", default=256, type=int, help="pixels a side")
            sub.add_argument("--fps", default=24, type=int, help="frames a second of the MP4")
            sub.add_argument("--formats", default="png,mp4", help="any of png, exr, mp4 (default: png,mp4)")
            sub.add_argument("--lighting", default=None, help="name of a test lighting (default: the first)")
            sub.add_argument("--component", default=None, help="full, indirect or direct")
            sub.add_argument("--output", default=None, type=Path, help="default: export/ in the run")
        if name == "status":
            sub.add_argument("--folder", default="runs", type=Path, help="where to look (default: runs)")
        if name == "score":
            sub.add_argument(
                "folders", nargs="+", type=Path, metavar="folder", help="runs, or folders of runs"
            )
            sub.add_argument("--metrics", default=None, metavar="a,b", help="default: those of the run")
    return top


def wants_help() -> bool:
    return any(word in ("-h", "--help") for word in sys.argv)


def examples(name: str) -> str:
    return "examples:\n" + textwrap.indent(textwrap.dedent(EXAMPLES[name]).strip("\n"), "  ")


def groups_help() -> str:
    """Groups and their choices, then where settings come from."""
    from prt.bench.compose import GROUPS, choices

    lines = ["", "", "groups and their choices:"]
    for group in (*GROUPS, "launcher"):
        text = ", ".join(choices(group)) or "(none yet)"
        lines.append(
            textwrap.fill(text, 100, initial_indent=f"  {group + '=':<10}", subsequent_indent=" " * 12)
        )
    lines += [
        "",
        "settings: any key of a YAML file in conf/, as seed=1, device=cpu, run.folder=elsewhere",
    ]
    return "\n".join(lines)

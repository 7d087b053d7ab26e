"""Claims: statements of a paper as data, each tested on this project's own runs.

One claim is one line::

    wavelet_neural > neural_prt on psnr/indirect, far, every scene
    wavelet_neural[denoised] > neural_prt[denoised] on psnr|ssim|lpips/full|indirect, far|near, every scene
    wavelet_neural[denoised] > wavelet_neural by 0.5 on psnr/indirect, far, most scenes
    wavelet_neural ~ neural_prt[denoised] within 0.02 on ssim/full, far, most scenes
    wavelet_neural[near] ~ wavelet_neural[far] within 1.5 on psnr/full, every scene
    wavelet_neural[denoised] - wavelet_neural > 0.5 on psnr/full, far, every scene
    wavelet_neural > 30 on psnr/indirect, far, scene cornell_glossy
    svd_transfer[basis=64] > svd_transfer[basis=16] on rmse/bound/indirect, same|points, every scene

``>`` always means *better*, whichever way the metric runs; ``~ ... within`` means equal up to that much.
``|`` writes several claims in one line: each word beside a ``|`` takes its turn. A clause that is a single
word is the split, whatever the task calls it: ``far``, ``same``, ``points``. A method may carry its variant
and its split in brackets: ``key=value`` and ``denoised`` are of the variant, any other word is the split.
Costs, and diagnostics taken once, need no split: ``wavelet_neural > path_traced on time/frame, every scene``;
nor does any figure of a benchmark: ``record[mode=bsdf] > 0.7 on ratio/paths/full, every scene``.
"""

import itertools
import re
from dataclasses import dataclass

from prt.bench.results import DENOISED, direction_of, is_cost, measured_once
from prt.errors import PrtError

GRAMMAR = (
    "`<side> > <side> [by <margin>] on <metric>/<component>, <split>, every scene` "
    "(`>` means better; or `<side> ~ <side> within <width> on ...`; a side is `method`, `method[denoised]`, "
    "`method[key=value]`, `method[near]`, `a - b` or a number; splits: any single word; "
    "scopes: `every scene`, `most scenes`, `scene <names>`)"
)
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_TERM = re.compile(r"^([A-Za-z]\w*)(?:\[([^\]]*)\])?$")
_SPLIT = re.compile(r"[A-Za-z]\w*")
#: words that begin a scope and so are no split
_SCOPE_WORDS = ("every", "most", "scene")


@dataclass(frozen=True)
class Term:
    """A method's figures, or a fixed number where ``method`` is empty."""

    method: str = ""
    variant: str = ""
    split: str = ""
    number: float = 0.0


@dataclass(frozen=True)
class Claim:
    """``better[0] - better[1]`` against ``than``, on one metric, component and split, over some scenes."""

    statement: str
    better: tuple[Term, ...]
    than: tuple[Term, ...]
    metric: str
    component: str
    split: str
    scope: str  #: ``every``, ``most`` or ``named``
    scenes: tuple[str, ...] = ()
    margin: float = 0.0
    within: float | None = None  #: the width of ``~``; None for ``>``


def parse_claims(
    lines: list[str], known_metrics: set[str] | None = None, needs_split: bool = True
) -> list[Claim]:
    """Parse claim lines; one line with ``|`` gives several claims.

    Args:
        known_metrics: all that may be named; any by default.
        needs_split: whether figures of images must name the split they are judged on; a benchmark has none.

    Raises:
        PrtError: naming the line, what is wrong in it and the grammar.
    """
    return [_parse(text, known_metrics, needs_split) for line in lines for text in _expand(line)]


def _expand(line: str) -> list[str]:
    """``psnr|ssim/full|indirect`` as every single statement."""
    if not isinstance(line, str):
        raise PrtError(f"claim {line!r}: a claim is one line of text; write {GRAMMAR}")
    parts = re.split(r"([A-Za-z0-9_.]+(?:\|[A-Za-z0-9_.]+)+)", " ".join(line.split()))
    return ["".join(choice) for choice in itertools.product(*(part.split("|") for part in parts))]


def _parse(text: str, known_metrics: set[str] | None, needs_split: bool) -> Claim:
    def wrong(what: str) -> PrtError:
        return PrtError(f"claim {text!r}: {what}; write {GRAMMAR}")

    sides, on, rest = text.partition(" on ")
    if not on:
        raise wrong("no ` on <metric>/<component>`")
    match = re.match(rf"^(.+?) ([>~]) (.+?)(?: (by|within) ({_NUMBER}))?$", sides)
    if not match:
        raise wrong("no ` > ` or ` ~ ` between two sides")
    left, sign, right, word, amount = match.groups()
    if (word == "within") != (sign == "~"):
        raise wrong("`~` needs `within <width>` and `>` takes only `by <margin>`")

    what, *clauses = [clause.strip() for clause in rest.split(",")]
    metric, slash, component = (what, "/", "") if is_cost(what) else what.rpartition("/")
    if not slash or component not in ("full", "direct", "indirect", ""):
        raise wrong(f"{what!r} is not <metric>/<component> with component full, direct or indirect")
    if known_metrics is not None and metric not in known_metrics:
        raise wrong(f"unknown metric {metric!r}, allowed are {sorted(known_metrics)}")
    try:
        direction_of(metric)
    except PrtError as error:
        raise wrong(str(error)) from error
    split, scope, scenes = "", "", ()
    for clause in clauses:
        if _is_split(clause) and not split:
            split = clause
        elif clause in ("every scene", "most scenes") and not scope:
            scope = clause.split()[0]
        elif clause.startswith("scene ") and not scope:
            scope, scenes = "named", tuple(clause.split()[1:])
        else:
            raise wrong(f"did not understand {clause!r}")
    if not scope:
        raise wrong("it does not say which scenes")

    terms = [[_term(t, wrong) for t in side.split(" - ")] for side in (left, right)]
    for term in itertools.chain(*terms):
        if needs_split and term.method and not (term.split or split or measured_once(metric)):
            raise wrong(f"it does not say on which split {term.method} is judged, near or far or another")
    return Claim(
        text, tuple(terms[0]), tuple(terms[1]), metric, component, split, scope, scenes,
        margin=float(amount) if word == "by" else 0.0, within=float(amount) if word == "within" else None,
    )  # fmt: skip


def _is_split(word: str) -> bool:
    return _SPLIT.fullmatch(word) is not None and word not in _SCOPE_WORDS


def _term(text: str, wrong) -> Term:
    if re.fullmatch(_NUMBER, text.strip()):
        return Term(number=float(text))
    match = _TERM.match(text.strip())
    if not match:
        raise wrong(f"{text!r} is neither a method nor a number")
    tokens = [token.strip() for token in (match[2] or "").split(",") if token.strip()]
    of_variant = [token for token in tokens if "=" in token or token == DENOISED]
    splits = [token for token in tokens if token not in of_variant]
    for token in splits:
        if not _is_split(token):
            raise wrong(f"{token!r} in {text!r} is neither key=value, {DENOISED} nor a split")
    if len(splits) > 1:
        raise wrong(f"{text!r} names two splits, {' and '.join(splits)}")
    variant = ",".join(of_variant)
    return Term(match[1], variant, splits[0] if splits else "")

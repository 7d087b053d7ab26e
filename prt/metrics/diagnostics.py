"""Figures that are no image metrics: which way is better, what they are called, how often they are taken.

A name is ``<prefix>/<what>`` (``condition/transfer``) or stands here in full (``rmse/bound``). Tasks report
them from ``error_split``, benchmarks in their rows; tables, charts and claims treat all of them alike.
"""

from dataclasses import dataclass

from prt.metrics.registry import Direction


@dataclass(frozen=True)
class Diagnostic:
    """One figure, or a family of them.

    Attributes:
        name: in full, or ending in ``/`` where all names that begin so are meant.
        label: as it stands in tables and on axes; empty where the name itself is shown.
        direction: which way is better.
        unit: "" where it is a pure number.
        once: one figure a run or measurement, not one a test image: such figures have no split.
        definition: one sentence.
    """

    name: str
    label: str
    direction: Direction
    unit: str
    once: bool
    definition: str


_ALL = (
    Diagnostic(
        "rmse/bound", "RMSE bound", "lower", "radiance", False,
        "RMSE of the best image of the method's own basis: what no choice of coefficients can get below.",
    ),
    Diagnostic(
        "rmse/relative", "relative RMSE", "lower", "", False,
        "RMSE over the root of the mean square of the reference.",
    ),
    Diagnostic(
        "rmse/over_bound", "RMSE over bound", "lower", "", False,
        "RMSE over that of the projection into the method's own basis.",
    ),
    Diagnostic("error/", "error", "lower", "", True,
               "Root mean square error over the root mean square of what it is compared with."),
    Diagnostic("basis/", "elements", "lower", "", True, "Elements of a basis."),
    Diagnostic("condition/", "condition number", "lower", "", True,
               "Largest over smallest singular value of the matrix that is inverted."),
    Diagnostic("negative/", "negative", "lower", "", False,
               "Values below zero, which no light has, as a fraction."),
    Diagnostic("chroma/", "chroma", "lower", "", True,
               "Distance of the mean chroma (CIE a* and b*) of an image from that of its reference."),
    Diagnostic("energy/", "energy", "higher", "", True,
               "Share of the sum of squares of a pixel's transport coefficients in its largest ones."),
    Diagnostic("points/", "points", "higher", "", True, "Share of the training points drawn."),
    Diagnostic("flicker/", "flicker", "lower", "", True,
               "Change from one frame to the next beyond the reference's own, under a light that moves."),
    Diagnostic("eigenvalue/", "eigenvalue", "lower", "", True,
               "Relative weight of what a basis of this size leaves out."),
    Diagnostic("frames/", "frames per second", "higher", "1/s", True,
               "Frames in a second by the median frame; the interval goes down to the 95th percentile."),
    Diagnostic("rays/", "rays", "lower", "", True, "Rays of one image."),
    Diagnostic("neurons/", "neurons", "lower", "", True, "Neurons of a layer."),
    Diagnostic("networks/", "networks", "lower", "", True, "Networks of a scene that is cut into cells."),
    Diagnostic("order/", "bands", "lower", "", True, "Bands of spherical harmonics."),
    Diagnostic("layers/", "layers", "lower", "", True, "Hidden layers of a network."),
    Diagnostic("seam/", "seam", "lower", "", True,
               "Difference of two neighbouring networks at their boundary, over the root mean square there."),
    Diagnostic("input/", "input", "lower", "", True,
               "1 where an input does harm in silence, 0 where it is refused or answered as it should be."),
    Diagnostic("spread/", "spread over seeds", "lower", "", False,
               "Standard deviation over seeds of the mean over test images."),
    Diagnostic("steps/", "steps", "lower", "", True, "Steps of training."),
    Diagnostic("change/", "change", "higher", "", True,
               "Root mean square difference of two path-traced images without their noise, over their mean."),
    Diagnostic("rmse/step", "RMSE of change", "lower", "radiance", False,
               "RMSE of the change from the frame before, against the reference's own change: flicker."),
    Diagnostic("mape/noise", "MAPE of noise", "lower", "", False,
               "Half the MAPE between two halves of the reference: what its own noise contributes."),
    Diagnostic("growth/", "growth", "lower", "", True,
               "Time per unit of work over that of less work in the same run: 1 is linear."),
    Diagnostic("ratio/error", "", "lower", "", True, "Deviation from the form compared with."),
    Diagnostic("ratio/", "", "higher", "", True, "How many times better than what is compared with."),
    Diagnostic("paths/", "", "higher", "", True, "Paths per second."),
)  # fmt: skip
DIAGNOSTICS: dict[str, Diagnostic] = {diagnostic.name: diagnostic for diagnostic in _ALL}


def diagnostic_of(metric: str) -> Diagnostic | None:
    """The entry of a figure's name (an exact one before a family), None where there is none."""
    return DIAGNOSTICS.get(metric) or DIAGNOSTICS.get(metric.partition("/")[0] + "/")


def diagnostic_label(metric: str) -> str:
    """As in tables: ``condition number, transfer``; the name itself where the entry has no label.

    Raises:
        KeyError: for a name without an entry.
    """
    known = DIAGNOSTICS.get(metric)
    if known is None:
        family, _, what = metric.partition("/")
        known = DIAGNOSTICS[family + "/"]
        if known.label:
            return f"{known.label}, {what.replace('_', ' ')}"
    return known.label or metric

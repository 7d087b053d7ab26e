"""What a model must reach: ``psnr/indirect>=35``, ``time/shade<=0.01``, ``bytes/model<=1e6``."""

import re
from dataclasses import dataclass

from prt.bench.chart import Axis
from prt.bench.results import direction_of, is_cost
from prt.errors import PrtError

_FORM = re.compile(r"^(?P<what>[\w/]+)\s*(?P<sign>>=|<=)\s*(?P<value>[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)$")
HOW = 'write "target=psnr/indirect>=35", "target=time/shade<=0.01" or "target=bytes/model<=1e6", in quotes'


@dataclass(frozen=True)
class Target:
    """One figure and the value it must reach.

    Attributes:
        metric, component: as in results.csv; no component for a time or a size.
        value: in the metric's unit; seconds, bytes.
    """

    metric: str
    component: str
    value: float

    @classmethod
    def parse(cls, text: str) -> "Target":
        """Read a target.

        Raises:
            PrtError: for another form (an unquoted ``>`` is the shell's), an unknown metric, or a sign
                against the metric's own direction.
        """
        match = _FORM.match(text.strip())
        if match is None:
            raise PrtError(f"target={text!r} cannot be read; {HOW}")
        try:
            axis = Axis.parse(match["what"])
        except PrtError as error:
            raise PrtError(f"target={text!r}: {match['what']!r} is no figure of a run; {HOW}") from error
        wanted = ">=" if direction_of(axis.metric) == "higher" else "<="
        if match["sign"] != wanted:
            way = "higher" if wanted == ">=" else "lower"
            raise PrtError(f"target={text!r}: {axis.metric} is better when it is {way}; write {wanted}")
        return cls(axis.metric, axis.component, float(match["value"]))

    @property
    def of_cost(self) -> bool:
        """Whether it bounds what a model may cost, and not what it must be worth."""
        return is_cost(self.metric)

    @property
    def higher(self) -> bool:
        """Whether a higher figure is better."""
        return direction_of(self.metric) == "higher"

    @property
    def axis(self) -> str:
        """As charts and claims write it."""
        return f"{self.metric}/{self.component}" if self.component else self.metric

    def __str__(self) -> str:
        return f"{self.axis}{'>=' if self.higher else '<='}{self.value:g}"

    def met(self, value: float, error: float = 0.0) -> bool:
        """Whether a figure reaches it within one standard error."""
        return value + error >= self.value if self.higher else value - error <= self.value

"""What a gap search rests on, for its page: everything but the answer is optional."""

from dataclasses import dataclass

from models.gap.evaluation.show import Shown
from models.gap.findings import Findings
from models.gap.naming.isolability import Isolability
from models.gap.where.locate import Where
from models.gap.where.residuals import Residuals


@dataclass(frozen=True)
class ThetaRow:
    """A constant before and after, each median and 90 % interval, and as another instrument measured it (with sd).

    Both ends of an interval at the median: there is no posterior.
    """

    parameter: str
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    independent: tuple[float, float] | None = None


OLD = "Only the answer of this search is kept; run it again with another seed to see what it rests on."

# Tensile bars of the paper (Methods); friction and Poisson ratio were not measured on their own.
INDEPENDENT = {"young_modulus_mpa": (11.5, 1.75)}


@dataclass(frozen=True, eq=False)
class GapEvidence:
    """A finished search. `where`: of each round; `residuals`, `isolated`: of the first; `assumed`: sentences."""

    findings: Findings
    where: tuple[Where, ...] = ()
    residuals: Residuals | None = None
    shown: Shown | None = None
    theta: tuple[ThetaRow, ...] = ()
    isolated: Isolability | None = None
    assumed: tuple[str, ...] = ()

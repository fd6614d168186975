"""How many designs and objects a claim takes: said with every answer, and with none most of all."""

import numpy as np
from scipy.stats import t as student

TOOL_SD, CELL_SD = 0.04, 0.02  # of a print and of a placement, relative; what other labs see
LEVEL = 0.005  # of one factor, so that all factors of all phases together hold 5 %
POWER = 0.8
LEAST_TOOLS = 8  # fewer give too few permutations for that level
_MOST = 200


def compute_smallest_share(n_tools: int, n_objects: int) -> float:
    """The smallest gap, relative, that so many tools show on half of the designs with probability `POWER`.

    Two groups of tools are compared, which scatter by `TOOL_SD`, and by `CELL_SD` on each object: Student's two-sided
    test at `LEVEL`. Made-up worlds agree: 15 % is seen by 8 tools in 16 of 20, 5 % by 35 in
    14 of 20 (docs/reference/measured-figures.md).
    """
    variance = TOOL_SD**2 + CELL_SD**2 / max(n_objects, 1)
    of_freedom = max(n_tools - 2, 1)
    wanted = float(student.ppf(1.0 - LEVEL / 2.0, of_freedom) + student.ppf(POWER, of_freedom))
    return float(wanted * np.sqrt(4.0 * variance / max(n_tools, 1)))


def count_tools_needed(share: float, n_objects: int) -> int:
    """Tools to see a gap of `share` of the force on half of the designs, at least `LEAST_TOOLS`, at most 200."""
    tools = range(LEAST_TOOLS, _MOST)
    return next((n for n in tools if compute_smallest_share(n, n_objects) <= abs(share)), _MOST)


def write_power_sentence(n_tools: int, n_objects: int) -> str:
    """What so many designs and objects to learn from could have shown, and how many a gap of 5 % takes."""
    seen, wanted = compute_smallest_share(n_tools, n_objects), 0.05
    more = f"; one of 5 % takes {count_tools_needed(wanted, n_objects)} designs" if seen > wanted else ""
    return (
        f"{n_tools} designs on {n_objects} objects to learn from show a gap on half of the designs with "
        f"{100 * POWER:.0f} % power if it is {100 * seen:.0f} % of the force or more{more}."
    )

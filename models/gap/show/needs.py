"""How many designs and objects a claim takes: said before anything is claimed."""

import numpy as np
from scipy.stats import norm

TOOL_SD, CELL_SD = 0.04, 0.02  # of a print and of a placement, relative; what other labs see
LEVEL = 0.005  # of one factor, so that all factors of all phases together hold 5 %
LEAST_TOOLS, LEAST_HELD_OUT = 8, 3  # fewer give too few permutations for that level
_MOST = 200


def tools_needed(
    share: float,
    n_objects: int,
    *,
    power: float = 0.8,
    level: float = LEVEL,
    tool_sd: float = TOOL_SD,
    cell_sd: float = CELL_SD,
) -> int:
    """Tools to see a gap of `share` of the force on half of the designs with probability `power`.

    Two groups of tools are compared; a tool scatters by tool_sd, and by cell_sd on each object. Two-sided test at
    `level`; at least `LEAST_TOOLS`, since fewer are hardly significant by permutation however large the gap.
    """
    variance = tool_sd**2 + cell_sd**2 / max(n_objects, 1)
    wanted = float(norm.ppf(1.0 - level / 2.0) + norm.ppf(power))
    return int(np.clip(np.ceil(4.0 * variance * (wanted / abs(share)) ** 2), LEAST_TOOLS, _MOST))


def smallest_share(n_tools: int, n_objects: int, *, power: float = 0.8, level: float = LEVEL) -> float:
    """The smallest gap, relative, that so many tools show on half of the designs with probability `power`."""
    variance = TOOL_SD**2 + CELL_SD**2 / max(n_objects, 1)
    wanted = float(norm.ppf(1.0 - level / 2.0) + norm.ppf(power))
    return float(wanted * np.sqrt(4.0 * variance / n_tools))


def size_warnings(n_tools: int, n_objects: int, n_held_out_tools: int, n_held_out_objects: int) -> tuple[str, ...]:
    """What cannot be claimed from so few designs and objects, and how many it takes."""
    found = []
    visible = smallest_share(n_tools, n_objects)
    if visible > 0.05:
        found.append(
            f"{n_tools} designs on {n_objects} objects show a gap that goes with the design with 80 % power only from "
            f"{100 * visible:.0f} % of the force on; 5 % takes {tools_needed(0.05, n_objects)} designs."
        )
    if n_held_out_tools < LEAST_HELD_OUT or n_held_out_objects < LEAST_HELD_OUT:
        found.append(
            f"{n_held_out_tools} designs and {n_held_out_objects} objects are held out; an interval for how much of "
            f"the gap was closed takes {LEAST_HELD_OUT} of each."
        )
    return tuple(found)

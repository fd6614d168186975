"""The strategies that are compared: those of the paper's table."""

from dataclasses import dataclass

from fast.models.scientist.propose import RANDOM


@dataclass(frozen=True)
class Strategy:
    """How measured tools (`tools`) and simulated designs (`simulations`) are chosen, as an acquisition rule; None: not.

    With simulations but no tools, the best simulated designs are measured once, at the end.
    """

    name: str
    tools: str | None
    simulations: str | None


REFERENCE = "hybrid, MES"
_RANDOM = Strategy("random", RANDOM, None)
# Expected improvement of the simulated force, then the ten best are measured.
_SIMULATION_ONLY = Strategy("simulation only", None, "ei")
# Max-value entropy search for a batch, without simulations.
_MEASURED_ONLY = Strategy("measured only", "mes", None)
# The paper's own: bi-fidelity max-value entropy search for both.
_HYBRID = Strategy(REFERENCE, "mes", "mes")
STRATEGIES = {strategy.name: strategy for strategy in (_RANDOM, _SIMULATION_ONLY, _MEASURED_ONLY, _HYBRID)}

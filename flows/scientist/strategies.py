"""The strategies that are compared: those of the paper's table."""

from dataclasses import dataclass

from models.scientist.propose import RANDOM


@dataclass(frozen=True)
class Strategy:
    """How measured tools (`tools`) and simulated designs (`simulations`) are chosen, as an acquisition rule; None: not.

    With simulations but no tools, the best simulated designs are measured once, at the end.
    """

    name: str
    tools: str | None
    simulations: str | None


REFERENCE = "hybrid, MES"
_ALL = (
    Strategy("random", RANDOM, None),
    # Expected improvement of the simulated force, then the ten best are measured.
    Strategy("simulation only", None, "ei"),
    # Max-value entropy search for a batch, without simulations.
    Strategy("measured only", "mes", None),
    # The paper's own: bi-fidelity max-value entropy search for both.
    Strategy(REFERENCE, "mes", "mes"),
)
STRATEGIES = {strategy.name: strategy for strategy in _ALL}

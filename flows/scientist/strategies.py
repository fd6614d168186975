"""The strategies that are compared: the paper's baselines, the paper's hybrid, and what else was tried."""

from dataclasses import dataclass

from models.scientist.propose import RANDOM


@dataclass(frozen=True)
class Strategy:
    """How measured tools (`tools`) and simulated designs (`simulations`) are chosen; None: there are none.

    With simulations but no tools, the best simulated designs are measured once, at the end.
    """

    name: str
    tools: str | None
    simulations: str | None
    about: str


STRATEGIES = (
    Strategy("random", RANDOM, None, "random designs are measured"),
    Strategy("simulation only", None, "ei", "expected improvement in simulation, then the ten best are measured"),
    Strategy("measured only", "mes", None, "batch max-value entropy search on measurements alone"),
    Strategy("measured only, NEI", "nei", None, "batch noisy expected improvement on measurements alone"),
    Strategy("hybrid, MES", "mes", "mes", "the paper: bi-fidelity max-value entropy search for both"),
    Strategy("hybrid, NEI + Thompson", "nei", "thompson", "noisy expected improvement, simulations by Thompson paths"),
    Strategy("hybrid, NEI + MES", "nei", "mes", "noisy expected improvement, simulations by max-value entropy search"),
    Strategy("hybrid, Thompson + MES", "thompson", "mes", "tools by Thompson paths, simulations by entropy search"),
    Strategy("hybrid, JES", "jes", "jes", "bi-fidelity joint entropy search for both"),
)
STRATEGY_BY_NAME = {strategy.name: strategy for strategy in STRATEGIES}
REFERENCE = "hybrid, MES"
# What whole campaigns compare unless told otherwise: the table of the paper
OF_THE_PAPER = ("random", "simulation only", "measured only", REFERENCE)

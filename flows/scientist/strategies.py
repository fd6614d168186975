"""The strategies that are compared: those of the paper's table, and those with a simulator made truer by a night."""

from dataclasses import dataclass, replace

from fast.flows.scientist.landscape_bank import BELIEVED, EFFECT, THETA
from fast.models.scientist.propose import RANDOM


@dataclass(frozen=True)
class Strategy:
    """How measured tools (`tools`) and simulated designs (`simulations`) are chosen, as an acquisition rule; None: not.

    With simulations but no tools, the best simulated designs are measured once, at the end. `simulator`: the one that
    a campaign believes in, or the one after the night that follows the initial tools. `n_night`: designs that it
    simulates. `is_log`: forces are modelled by their logarithms, and simulations are left aside where they mislead.
    `n_best`: tools of a batch that have the largest predicted force.
    """

    name: str
    tools: str | None
    simulations: str | None
    simulator: str = BELIEVED
    n_night: int = 0
    is_log: bool = False
    n_best: int = 0


REFERENCE = "hybrid, MES"
MEASURED_ONLY = "measured only"
_RANDOM = Strategy("random", RANDOM, None)
# Expected improvement of the simulated force, then the ten best are measured.
_SIMULATION_ONLY = Strategy("simulation only", None, "ei")
# Max-value entropy search for a batch, without simulations.
_MEASURED_ONLY = Strategy(MEASURED_ONLY, "mes", None)
# The paper's own: bi-fidelity max-value entropy search for both.
_HYBRID = Strategy(REFERENCE, "mes", "mes")
STRATEGIES = {strategy.name: strategy for strategy in (_RANDOM, _SIMULATION_ONLY, _MEASURED_ONLY, _HYBRID)}

# What a campaign of today does that measures only, or that has nights.
_LOG_MEASURED_ONLY = Strategy("log measured only", "mes", None, is_log=True, n_best=2)
LOOP = {THETA: "loop, theta", EFFECT: "loop, theta and effect"}
LOOP_DISCOVERED = "loop, as discovered"  # either of them: see `landscape_study.with_discovery`
_AFTER_NIGHT = (
    *(replace(_SIMULATION_ONLY, name=f"simulation only, {found}", simulator=found) for found in (THETA, EFFECT)),
    *(replace(_HYBRID, name=f"hybrid, MES, {found}", simulator=found) for found in (THETA, EFFECT)),
    *(replace(_HYBRID, name=name, simulator=found, n_night=500, is_log=True, n_best=2) for found, name in LOOP.items()),
)
# On landscapes, where the simulator after a night is stored.
LANDSCAPE_STRATEGIES = STRATEGIES | {strategy.name: strategy for strategy in (_LOG_MEASURED_ONLY, *_AFTER_NIGHT)}
# What a truer simulator alone brings: in the tables, not in the figure.
NOT_DRAWN = frozenset(strategy.name for strategy in _AFTER_NIGHT) - frozenset(LOOP.values())

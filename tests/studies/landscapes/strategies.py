"""The strategies that are compared on landscapes: those of the paper's table, and those after a night."""

from dataclasses import dataclass, replace

from fast.flows.scientist.campaign_runs import BASELINE, STRATEGIES, Strategy
from tests.studies.landscapes.bank import BELIEVED, EFFECT, THETA


@dataclass(frozen=True)
class NightStrategy(Strategy):
    """A strategy with the simulator that a campaign believes in, or with the one after the night of the initial tools.

    `simulator`: which. `n_night`: designs that the night simulates. `is_log`: forces are modelled by their logarithms,
    and simulations are left aside where they mislead. `n_best`: tools of a batch that have the largest predicted force.
    """

    simulator: str = BELIEVED
    n_night: int = 0
    is_log: bool = False
    n_best: int = 0


def _of(strategy: Strategy) -> NightStrategy:
    return NightStrategy(strategy.name, strategy.tools, strategy.simulations)


_SIMULATION_ONLY, _HYBRID = _of(STRATEGIES["simulation only"]), _of(STRATEGIES[BASELINE])
# What a campaign of today does that measures only, or that has nights.
_LOG_MEASURED_ONLY = NightStrategy("log measured only", "mes", None, is_log=True, n_best=2)
LOOP = {THETA: "loop, theta", EFFECT: "loop, theta and effect"}
LOOP_DISCOVERED = "loop, as discovered"  # either of them: see `study.with_discovery`
_AFTER_NIGHT = (
    *(replace(_SIMULATION_ONLY, name=f"simulation only, {found}", simulator=found) for found in (THETA, EFFECT)),
    *(replace(_HYBRID, name=f"hybrid, MES, {found}", simulator=found) for found in (THETA, EFFECT)),
    *(replace(_HYBRID, name=name, simulator=found, n_night=500, is_log=True, n_best=2) for found, name in LOOP.items()),
)
LANDSCAPE_STRATEGIES = {
    strategy.name: strategy for strategy in (*map(_of, STRATEGIES.values()), _LOG_MEASURED_ONLY, *_AFTER_NIGHT)
}
# What a truer simulator alone brings: in the tables, not in the figure.
NOT_DRAWN = frozenset(strategy.name for strategy in _AFTER_NIGHT) - frozenset(LOOP.values())

"""Strategies replayed on a campaign of the lake."""

from collections.abc import Callable
from typing import Any

from fast.models.blas import one_blas_thread
from fast.models.errors import UsageError
from fast.models.scientist.backtest import HYBRID, LEAST_TOOLS, MEASURED_ONLY, RANDOM, Replay, replay, sum_up
from fast.models.scientist.objectives import MEAN_PEAK, OUTCOMES
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.scientist.fit import in_units_of
from fast.tasks.scientist.observe import closed_batches, observe

_FIRST = 0.25  # of the measured tools, with which a replay begins


def backtest(campaign: Campaign, n_replays: int, progress: Callable[[str], None]) -> list[dict[str, Any]]:
    """Run replays with batches of the campaign's size and half of it, for each measured objective and the mean force.

    Rows of `models.scientist.backtest.ReplayRow` with the objective.

    Raises:
        UsageError: hardly any tool is measured.
    """
    state = campaign.state()
    closed = closed_batches(campaign, state)
    size = campaign.config.schedule.tools_per_batch
    wanted = [name for name in campaign.config.scientist.objectives if name in OUTCOMES]
    rows: list[dict[str, Any]] = []
    for name in dict.fromkeys([*wanted, MEAN_PEAK.name]):
        if OUTCOMES[name].is_simulated:
            continue
        data = in_units_of(campaign, observe(campaign, state, closed, OUTCOMES[name]).of_this_campaign())
        if data.n_real < LEAST_TOOLS:
            raise UsageError(
                f"campaign {campaign.campaign_id} has {data.n_real} measured tools, a replay takes {LEAST_TOOLS} at "
                "least; measure more first."
            )
        n_first = max(int(_FIRST * data.n_real), 4)
        replays: list[Replay] = []
        with one_blas_thread():
            for n_batch in dict.fromkeys([size, max(size // 2, 1)]):
                for strategy in (RANDOM, MEASURED_ONLY, *([HYBRID] if data.n_sim else [])):
                    replays += [
                        replay(data, campaign.space, strategy, n_first, n_batch, seed) for seed in range(n_replays)
                    ]
                    progress(f"{name}: {strategy}, batches of {n_batch}")
        rows += [{"objective": name, **row.model_dump()} for row in sum_up(replays)]
    return rows

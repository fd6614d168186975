"""When a campaign needs a person next, from what is left on the bench and in the simulator and how fast both go."""

from dataclasses import dataclass
from datetime import datetime, timedelta

from fast.flows.campaign.pace import count_printed_left, count_simulated_left, find_stage
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState


@dataclass(frozen=True)
class Forecast:
    """`batch`: what a person will print next, None when nothing is left to print; `in_s`: 0 now, None not known yet."""

    batch: int | None
    in_s: float | None

    def in_words(self, now: datetime) -> str:
        """A sentence for people; `now` in their own time."""
        if self.batch is None:
            return "No person is needed any more."
        if self.in_s is None:
            return f"A person is needed for B{self.batch:02d}; when is not known yet."
        if self.in_s == 0:
            return f"A person is needed now: print and mount B{self.batch:02d}."
        at = now + timedelta(seconds=self.in_s)
        day = "" if at.date() == now.date() else f" on {at:%A, %d %B}"
        return f"Next time a person is needed: {at:%H:%M %Z}{day}, for B{self.batch:02d}."


def forecast(
    campaign: Campaign, state: CampaignState, s_per_grasp: float | None, s_per_simulation: float | None
) -> Forecast:
    """The next print, from the state of the lake and the recent seconds per measured and simulated grasp."""
    schedule = campaign.config.schedule
    stage = find_stage(campaign, state)
    bench_s = _time(count_printed_left(campaign, state, stage), s_per_grasp)
    for batch in schedule.batches_of(stage):
        if state.tools_of(batch) and not state.is_confirmed(batch):
            return Forecast(batch, bench_s)
    if stage + 1 >= schedule.n_stages:
        return Forecast(None, None)
    # The next tools are proposed when both the bench and the simulations of this stage are done.
    simulated_s = _time(count_simulated_left(campaign, state, stage), s_per_simulation)
    known = [bench_s, simulated_s]
    in_s = None if None in known else max(s for s in known if s is not None)
    is_night = campaign.config.gap.active or campaign.config.night.active
    # When a night ends depends on what it finds.
    return Forecast(schedule.batches_of(stage + 1)[0], None if is_night else in_s)


def _time(n_left: int, s_each: float | None) -> float | None:
    if n_left == 0:
        return 0.0
    return None if s_each is None else n_left * s_each

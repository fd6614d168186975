"""What a night of a campaign has done, in numbers and in words: events of the lake, read by page and report."""

import numpy as np
import scipy

from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.gap.findings import Verdict
from fast.models.records import Record
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.simulator_versions import count_seconds, find_decision
from fast.tasks.gap.findings import KIND as GAP_ENDED
from fast.tasks.gap.findings import GapRun
from fast.tasks.scientist.observe import means_of_simulations, means_of_tools

KIND = "night"
_FEWEST_TOOLS = 3  # whose ranks are compared: two are in order or not, which says nothing


class Night(Record):
    """A night that has ended. None: not known."""

    stage: int
    """Of the schedule, from 0."""
    batch: int
    """That was chosen after it, from 1."""
    old_version_id: str
    """The simulator before."""
    version_id: str
    """The simulator since."""
    change: str
    """What the new one differs in, in words."""
    n_planned: int
    """Designs to be simulated with it."""
    n_done: int
    """Those that are done on every object."""
    worker_hours: float
    """What that took, of all workers together."""
    n_tools: int
    """Measured tools that both versions have simulated."""
    rank_before: float | None
    """Spearman's rank correlation of the old version's forces of these tools with the measured ones."""
    rank_after: float | None
    """The same of the new version."""
    error_before_n: float | None
    """Held-out error of the old version, of the search behind the new one."""
    error_after_n: float | None
    """The same of the new version."""

    @property
    def sentence(self) -> str:
        """The whole story of the night."""
        return "; ".join([self.change, self._error_words, self._rank_words, self._work_words])

    @property
    def _error_words(self) -> str:
        if self.error_before_n is None or self.error_after_n is None:
            return "its held-out error is not known"
        return f"held-out error {self.error_before_n:.2f} -> {self.error_after_n:.2f} N"

    @property
    def _rank_words(self) -> str:
        if self.rank_before is None or self.rank_after is None:
            return f"what it changed in the ranking is not known: both versions simulated {self.n_tools} measured tools"
        return (
            f"ranking of {self.n_tools} tools: rank correlation with the measured forces "
            f"{self.rank_before:.2f} -> {self.rank_after:.2f}"
        )

    @property
    def _work_words(self) -> str:
        if not self.n_planned:
            return "no design had to be simulated again"
        return f"{self.n_done} of {self.n_planned} designs simulated with it in {self.worker_hours:.2f} worker hours"


def find_night(campaign: Campaign, stage: int) -> Night | None:
    """Find the night before a stage, if it has ended."""
    nights = read_nights(campaign.lake, campaign.campaign_id)
    return next((night for night in nights if night.stage == stage), None)


def read_nights(lake: Lake, campaign_id: str) -> list[Night]:
    """Read the nights of a campaign that have ended, in order."""
    nights = [Night.model_validate(row.payload) for row in lake.records(EventRow, campaign_id=campaign_id, kind=KIND)]
    return sorted(nights, key=lambda night: night.stage)


def read_verdicts(lake: Lake, campaign_id: str) -> list[Verdict]:
    """Read what searches of a campaign, or of the whole lake, said of the simulators they ended with, in order."""
    rows = [row for row in lake.records(EventRow, kind=GAP_ENDED) if row.campaign_id in ("", campaign_id)]
    verdicts = [GapRun.model_validate(row.payload).findings.verdict for row in rows]
    return [verdict for verdict in verdicts if verdict is not None]


def end_night(campaign: Campaign, old: SimulatorVersion, stage: int) -> Night:
    """Write down what the night before a stage has done; `campaign` has the version of the stage, `old` the former.

    Written once: a night that has ended stays as it was.
    """
    known = find_night(campaign, stage)
    if known is not None:
        return known
    night = _sum_up(campaign, old, stage)
    name = campaign.campaign_id
    row = EventRow.of([name, KIND, stage], KIND, night.sentence, night, name)
    campaign.lake.append([row], campaign.provenance())
    return night


def count_worker_seconds(campaign: Campaign, stage: int) -> float:
    """Count what the simulations of the night before a stage took so far, summed over the workers, in seconds."""
    decision = find_decision(campaign, stage)
    if decision is None:
        return 0.0
    return count_seconds(campaign, campaign.version, decision.reruns) - decision.spent_s


def _sum_up(campaign: Campaign, old: SimulatorVersion, stage: int) -> Night:
    decision, state, version = find_decision(campaign, stage), campaign.state(), campaign.version
    planned = list(decision.reruns) if decision else []
    n_tools, before, after = _compare_ranks(campaign, old)
    verdict = _find_verdict(campaign, old, version)
    return Night(
        stage=stage,
        batch=campaign.config.schedule.batches_of(stage)[-1],
        old_version_id=old.version_id,
        version_id=version.version_id,
        change=_describe_change(old, version),
        n_planned=len(planned),
        n_done=sum(not state.missing_objects(design_id, campaign.object_ids) for design_id in planned),
        worker_hours=count_worker_seconds(campaign, stage) / 3600.0,
        n_tools=n_tools,
        rank_before=before,
        rank_after=after,
        error_before_n=verdict.present_rmse_n if verdict else None,
        error_after_n=verdict.rmse_n if verdict else None,
    )


def _compare_ranks(campaign: Campaign, old: SimulatorVersion) -> tuple[int, float | None, float | None]:
    """Count measured tools both versions simulated, and compute each one's rank correlation with what was measured."""
    state = campaign.state()
    measured = means_of_tools(campaign, state)
    design_of = {tool.tool_id: tool.design for tool in state.tools}
    designs = {design_of[tool_id].design_id: design_of[tool_id] for tool_id in measured.ids}
    found = [means_of_simulations(campaign, version, designs) for version in (old, campaign.version)]
    forces = [dict(zip(means.ids, means.y, strict=True)) for means in found]
    rows = [
        (force_n, *(one[design_of[tool_id].design_id] for one in forces))
        for tool_id, force_n in zip(measured.ids, measured.y, strict=True)
        if all(design_of[tool_id].design_id in one for one in forces)
    ]
    if len(rows) < _FEWEST_TOOLS:
        return len(rows), None, None
    real, *simulated = np.array(rows).T
    before, after = (_rank(values, real) for values in simulated)
    return len(rows), before, after


def _rank(simulated: np.ndarray, measured: np.ndarray) -> float | None:
    if not np.ptp(simulated) or not np.ptp(measured):
        return None
    return float(scipy.stats.spearmanr(simulated, measured).statistic)


def _find_verdict(campaign: Campaign, old: SimulatorVersion, new: SimulatorVersion) -> Verdict | None:
    """Find how the newest search that did has compared two versions; None if none has."""
    wanted, found = (old.version_id, new.version_id), read_verdicts(campaign.lake, campaign.campaign_id)
    return next((v for v in reversed(found) if (v.present_version_id, v.version_id) == wanted), None)


def _describe_change(old: SimulatorVersion, new: SimulatorVersion) -> str:
    """Describe what a version has that the former did not, in words."""
    from fast.models.simulation.effects.catalogue import CATALOGUE

    before, after = ({value.effect: value for value in version.effects} for version in (old, new))
    titles = [f"{CATALOGUE[name].title} was added" for name in after if name not in before]
    titles += [f"{CATALOGUE[name].title} was taken away" for name in before if name not in after]
    if old.theta != new.theta:
        titles.append(f"theta is {_describe_theta(new)} instead of {_describe_theta(old)}")
    if any(before[name] != after[name] for name in before.keys() & after.keys()):
        titles.append("parameters of known effects were inferred again")
    return ", ".join(titles) or f"version {new.version_id} replaces {old.version_id}"


def _describe_theta(version: SimulatorVersion) -> str:
    theta = version.theta
    return f"E {theta.young_modulus_mpa:.2f} MPa, friction {theta.friction:.3f}, nu {theta.poisson_ratio:.3f}"

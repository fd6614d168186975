"""What a campaign's objectives and limits mean: surrogates to choose tools with, and values of those measured."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from fast.models.scientist.acquisition.candidates import Predictor
from fast.models.scientist.acquisition.front import Criterion, draw_known, draw_surrogate, find_front
from fast.models.scientist.objectives import KNOWN, LESS_IS_BETTER, MEAN_PEAK, OUTCOMES, known_of
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import CampaignState
from fast.tasks.scientist.fit import fit_outcome, fit_outcome_by_object
from fast.tasks.scientist.observe import observe, observe_objects, outcomes_of_tools


def make_criteria(
    campaign: Campaign, batch: int, closed: Iterable[int], mean_peak: Surrogate, state: CampaignState
) -> list[Criterion]:
    """Make objectives and limits with their surrogates, fitted and recorded; none where the config asks nothing else.

    Raises:
        UsageError: an outcome is asked for that the grasps do not have.
    """
    scientist = campaign.config.scientist
    if not scientist.has_criteria:
        return []
    batches, criteria = list(closed), []
    for name in dict.fromkeys([*scientist.objectives, *scientist.at_least, *scientist.at_most]):
        is_less = name in LESS_IS_BETTER
        limit = (scientist.at_most if is_less else scientist.at_least).get(name)
        predictor: Predictor | None = None
        if name in KNOWN:
            draw = draw_known(_make_known(campaign, name))
        elif OUTCOMES[name].is_of_one_object:
            known = observe_objects(campaign, state, batches, OUTCOMES[name])
            objects = predictor = fit_outcome_by_object(campaign, batch, OUTCOMES[name], known)
            draw = objects.draw
        else:
            model = predictor = mean_peak
            if name != MEAN_PEAK.name:
                data = observe(campaign, state, batches, OUTCOMES[name])
                model = predictor = fit_outcome(campaign, batch, OUTCOMES[name], data)
            draw = draw_surrogate(model)
        criteria.append(Criterion(draw, None if is_less else predictor, name in scientist.objectives, limit, is_less))
    return criteria


def _make_known(campaign: Campaign, name: str) -> Any:
    """Return what is known of designs as a function of their points."""
    return lambda points: np.array([known_of(name, design) for design in campaign.space.from_unit(points)])


def list_outcomes(campaign: Campaign, state: CampaignState) -> list[dict[str, Any]]:
    """List measured tools with every objective and limit, and whether they keep the limits and lie on the front.

    The front is of those that keep the limits. Best first by the first objective. Tools without one of the outcomes are
    left out.
    """
    scientist = campaign.config.scientist
    names = list(dict.fromkeys([*scientist.objectives, *scientist.at_least, *scientist.at_most]))
    measured = {name: outcomes_of_tools(campaign, state, OUTCOMES[name]) for name in names if name in OUTCOMES}
    rows = []
    for tool in sorted(state.tools, key=lambda tool: (tool.batch, tool.slot)):
        values = {name: found.get(tool.tool_id) for name, found in measured.items()}
        if any(value is None for value in values.values()):
            continue
        row: dict[str, Any] = {"tool_id": tool.tool_id, **values}
        row |= {name: known_of(name, tool.design) for name in names if name in KNOWN}
        keeps = all(row[name] >= least for name, least in scientist.at_least.items())
        row["keeps_limits"] = keeps and all(row[name] <= most for name, most in scientist.at_most.items())
        rows.append(row)
    good = [row for row in rows if row["keeps_limits"]]
    signs = np.array([-1.0 if name in LESS_IS_BETTER else 1.0 for name in scientist.objectives])
    wanted = signs * np.array([[row[name] for name in scientist.objectives] for row in good]).reshape(-1, len(signs))
    on_front = {row["tool_id"] for row, is_on in zip(good, find_front(wanted), strict=True) if is_on}
    first = scientist.objectives[0]
    for row in rows:
        row["on_front"] = row["tool_id"] in on_front
    return sorted(rows, key=lambda row: -signs[0] * row[first])

"""What prior campaigns of the lake measured, as further fidelities of a campaign's surrogate."""

from dataclasses import dataclass

import numpy as np

from fast.lake.tables.campaign import CampaignRow, DesignRow
from fast.models.errors import ConfigError
from fast.models.records import Design
from fast.models.scientist.surrogate.imputation import mean_over_objects
from fast.models.scientist.surrogate.observations import MIN_OBSERVATIONS
from fast.models.units import spell_count
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import THICKNESSES, ProposedTool, tuples

_INSIDE = 1e-9  # unit-cube length by which rounding may take a design out of the space
_PROPOSED = "SELECT DISTINCT design_id FROM proposals WHERE list_contains($campaigns, campaign_id) ORDER BY design_id"
_FORCES = f"""
    SELECT tool_id, g.design_id, object_id, avg(peak_force_n), list(grasp_id),
        {", ".join(f"any_value(t.measured_{name})" for name in THICKNESSES)}
    FROM grasps AS g LEFT JOIN tools AS t USING (tool_id)
    WHERE g.campaign_id = ? AND g.status = 'ok' AND request_id IS NULL
    GROUP BY ALL ORDER BY tool_id, g.design_id, object_id
"""


@dataclass(frozen=True)
class PriorTools:
    """Tools of a prior campaign that this campaign can learn from.

    points: n x d, fingers as printed, unit cube of the design space. mean_n: n, mean force over the objects that both
    campaigns have, N. variance_n2: n, of these means from imputed objects. grasp_ids: what the means are of.
    n_left_out: tools of another family, outside the ranges of this campaign's designs, or without a common object.
    """

    campaign_id: str
    points: np.ndarray
    mean_n: np.ndarray
    variance_n2: np.ndarray
    grasp_ids: tuple[str, ...]
    n_left_out: int


def read_prior(campaign: Campaign) -> list[PriorTools]:
    """Read measured tools of the campaigns that `scientist.prior_campaigns` names, in that order; none without any."""
    return [_read_tools(campaign, name) for name in campaign.config.scientist.prior_campaigns]


def prior_designs(campaign: Campaign) -> dict[str, Design]:
    """Return designs prior campaigns proposed and this could, by id: what the same simulator said of them counts."""
    names = list(campaign.config.scientist.prior_campaigns)
    if not names:
        return {}
    design_ids = [design_id for (design_id,) in tuples(campaign.lake, _PROPOSED, campaigns=names)]
    rows = campaign.lake.records(DesignRow, design_id=design_ids)
    return {row.design_id: row.design for row in rows if _is_inside(campaign, row.design)}


def check_prior(campaign: Campaign) -> None:
    """See that there is something to learn from every prior campaign.

    Raises:
        ConfigError: the lake has no such campaign, or hardly a tool of it is usable here.
    """
    for name in campaign.config.scientist.prior_campaigns:
        if name == campaign.campaign_id:
            raise ConfigError(f"scientist.prior_campaigns names the campaign itself, `{name}`; remove it.")
        if not campaign.lake.ids(CampaignRow, campaign_id=name):
            raise ConfigError(
                f"scientist.prior_campaigns: the lake has no campaign `{name}`; bring it with `fast lake import`, or "
                "remove the name."
            )
        found = _read_tools(campaign, name)
        if len(found.mean_n) < MIN_OBSERVATIONS:
            others = (
                f" ({found.n_left_out} more are of another family, outside the ranges of this campaign's designs, or "
                "were measured on none of its objects)"
            )
            raise ConfigError(
                f"scientist.prior_campaigns: {spell_count(len(found.mean_n), 'tool')} of `{name}` can be used, "
                f"{MIN_OBSERVATIONS} are needed{others if found.n_left_out else ''}; remove the name"
                f"{', or widen [design]' if found.n_left_out else ''}."
            )


def _read_tools(campaign: Campaign, prior_id: str) -> PriorTools:
    rows = list(tuples(campaign.lake, _FORCES, prior_id))
    design_ids = sorted({row[1] for row in rows})
    designs = {row.design_id: row.design for row in campaign.lake.records(DesignRow, design_id=design_ids)}
    column_of = {object_id: column for column, object_id in enumerate(campaign.object_ids)}
    forces: dict[tuple[str, str], np.ndarray] = {}
    points: dict[tuple[str, str], np.ndarray] = {}
    grasp_ids: list[str] = []
    for tool_id, design_id, object_id, force_n, ids, *thicknesses in rows:
        key = tool_id, design_id
        if key not in points:
            measured_mm = {n: mm for n, mm in zip(THICKNESSES, thicknesses, strict=True) if mm is not None}
            points[key] = _point(campaign, ProposedTool(tool_id, 0, 0, designs[design_id], measured_mm=measured_mm))
            forces[key] = np.full(len(column_of), np.nan)
        if object_id in column_of and points[key].size:
            forces[key][column_of[object_id]] = force_n
            grasp_ids += ids
    used = [key for key in points if points[key].size and np.isfinite(forces[key]).any()]
    n_dims = campaign.space.n_dims
    mean_n, variance_n2 = np.zeros(0), np.zeros(0)
    if used:
        mean_n, variance_n2 = mean_over_objects(np.array([forces[key] for key in used]))
    return PriorTools(
        campaign_id=prior_id,
        points=np.array([points[key] for key in used]).reshape(-1, n_dims),
        mean_n=mean_n,
        variance_n2=variance_n2,
        grasp_ids=tuple(sorted(grasp_ids)),
        n_left_out=len(points) - len(used),
    )


def _point(campaign: Campaign, tool: ProposedTool) -> np.ndarray:
    """Return the finger as printed, d unit-cube coordinates; empty where the campaign's space lacks its design."""
    return tool.mounted_point(campaign.space) if _is_inside(campaign, tool.design) else np.zeros(0)


def _is_inside(campaign: Campaign, design: Design) -> bool:
    """Return whether a design is of the campaign's family and within its ranges."""
    if type(design) is not campaign.space.family:
        return False
    point = campaign.space.to_unit([design])[0]
    return bool((point >= -_INSIDE).all() and (point <= 1.0 + _INSIDE).all())

"""What programs propose and a person accepts or denies: nothing is started by a proposal itself."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from fast.flows.page.start import check_config, start_campaign, start_job
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.tasks.campaign.campaign import stored_provenance

PROPOSED, SETTLED = "proposal", "proposal_settled"  # kinds of events
_MOST_OPEN = 20


class Proposal(BaseModel):
    """What a program wants done: a campaign of a config, or a job of the queue; who, why, and what it costs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["campaign", "report", "calibration", "search"]
    who: str = Field(min_length=1, max_length=60)
    why: str = Field(min_length=1, max_length=2000)
    cost: str = Field(default="", max_length=300, description="what it costs, in words with units")
    config: str = Field(default="", max_length=100_000, description="TOML, of a campaign")
    campaign_id: str = Field(default="", max_length=100, description="of a report")

    @property
    def proposal_id(self) -> str:
        """Id derived from the content: the same proposal twice is one."""
        return content_id("Q", self.model_dump(mode="json"))


def write_proposal(lake: Lake, proposal: Proposal) -> str:
    """Keep a proposal for a person to decide; returns its id.

    Raises:
        UsageError: its config has faults, or too many wait already.
    """
    if proposal.kind == "campaign":
        checked = check_config(lake, proposal.config, "")
        if checked.faults:
            raise UsageError(f"{checked.faults[0].sentence} Nothing was proposed.")
    waiting = list_open(lake)
    if proposal.proposal_id in waiting:
        return proposal.proposal_id
    if len(waiting) >= _MOST_OPEN:
        raise UsageError(f"{_MOST_OPEN} proposals wait for a person already; nothing was proposed.")
    _write(lake, PROPOSED, proposal.proposal_id, f"{proposal.who} proposes: {proposal.kind}", proposal.model_dump())
    return proposal.proposal_id


def list_open(lake: Lake) -> dict[str, Proposal]:
    """List proposals of which nobody has said anything, by id, the oldest first."""
    settled = {row.payload["proposal"] for row in lake.records(EventRow, kind=SETTLED)}
    rows = [row.payload for row in lake.records(EventRow, kind=PROPOSED)]
    found = [Proposal.model_validate({k: v for k, v in row.items() if k != "proposal"}) for row in rows]
    return {one.proposal_id: one for one in found if one.proposal_id not in settled}


def settle_proposal(lake: Lake, proposal_id: str, is_accepted: bool, config: str, operator: str) -> str:
    """Carry out what was proposed, with the config as the person left it, or deny it.

    Raises:
        UsageError: somebody has decided already; or it cannot be started, and stays open.
    """
    proposal = list_open(lake).get(proposal_id)
    if proposal is None:
        raise UsageError("somebody has decided about this proposal already; nothing was changed.")
    done = f"The proposal of {proposal.who} is denied."
    if is_accepted and proposal.kind == "campaign":
        done = start_campaign(lake, {"text": config or proposal.config, "base": ""}, operator)
    elif is_accepted:
        done = start_job(lake, proposal.kind, proposal.campaign_id, operator)
    verb = "accepted" if is_accepted else "denied"
    said = {"accepted": is_accepted, "operator": operator}
    _write(lake, SETTLED, proposal_id, f"{operator} {verb} a proposal of {proposal.who}", said)
    return done


def _write(lake: Lake, kind: str, proposal_id: str, message: str, payload: dict[str, object]) -> None:
    row = EventRow.of([kind, proposal_id], kind, message, {**payload, "proposal": proposal_id}, None)
    lake.append([row], stored_provenance(lake, ""))

"""Orders of people to a running campaign: what was seen when one was given, and what it then does, once.

An order names the run that the person saw. One that comes late, since that run has ended or another has begun, is
refused with a sentence; the same order twice is one. A stop is never refused while anything runs.
"""

from dataclasses import dataclass

from fast.hardware.parts.safe_state import Verb
from fast.lake.leases import Holder, holder_of
from fast.lake.store import Lake
from fast.models.errors import FastError
from fast.tasks.campaign.requests import append_request, lease_name, requested_verb

_STRENGTH = (Verb.PAUSE, Verb.STOP, Verb.ABORT)
_EFFECTS = {
    Verb.PAUSE: "it ends after the current grasp",
    Verb.STOP: "the bench goes to its safe state at once",
    Verb.ABORT: "the bench goes to its safe state at once and it counts as failed",
}


class StaleRequestError(FastError):
    """The order was meant for what is no longer so; nothing was changed."""


@dataclass(frozen=True)
class PresentRun:
    """Who runs a campaign, and what the last run of it was asked for."""

    holder: Holder | None
    verb: Verb | None

    @property
    def run(self) -> str:
        """Names the run that goes on; empty where none does."""
        return self.holder.token if self.holder is not None else ""


def read_present_run(lake: Lake, campaign_id: str) -> PresentRun:
    """Read whether a campaign runs, and what was asked of it."""
    return PresentRun(holder_of(lake.storage, lease_name(campaign_id)), requested_verb(lake, campaign_id))


def request_verb(lake: Lake, campaign_id: str, verb: Verb, who: str, seen_run: str | None = None) -> str:
    """Ask a running campaign to pause, stop or abort; returns what that does. `seen_run`: `PresentRun.run` as seen.

    Raises:
        StaleRequestError: nothing runs, or for a pause another run than the one that was seen.
    """
    present = read_present_run(lake, campaign_id)
    if present.holder is None:
        raise StaleRequestError(
            f"campaign {campaign_id} is not running, so there is nothing to {verb}; nothing was changed."
        )
    if verb is Verb.PAUSE and seen_run not in (None, present.run):
        raise StaleRequestError(
            f"campaign {campaign_id} was started again since this page showed it; nothing was changed: look, then give "
            "the order again."
        )
    asked = present.verb
    if asked in _STRENGTH and _STRENGTH.index(asked) >= _STRENGTH.index(verb):
        return f"campaign {campaign_id} was asked to {asked} before; {_EFFECTS[asked]}."
    append_request(lake, campaign_id, verb, f"{verb} asked for {who}")
    return f"asked campaign {campaign_id} to {verb}; {_EFFECTS[verb]}."

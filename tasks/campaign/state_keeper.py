"""The state of a campaign, derived from the lake, and kept from one decision to the next: only what is new is read.

The lake remains the truth. A process that starts reads all of it, and so does one that sees files go away; what is kept
goes with the process.
"""

import threading
from collections.abc import Callable, Collection, Iterable
from typing import Any
from weakref import WeakKeyDictionary

from lake.query.additions import additions
from lake.query.engine import Mark
from lake.store import Lake
from lake.tables.campaign import DesignRow, GraspRow, ProposalRow, Row, SimulationRow, ToolRow, TraceRow
from models.design.space import PARAMETERS
from tasks.campaign.state import CampaignState
from tasks.campaign.state_parts import (
    GraspPart,
    Grasps,
    Plans,
    ProposalPart,
    Question,
    SimulationPart,
    Simulations,
    ToolPart,
)

_KEPT = 2  # states of a lake: that of the present stage and of the one before
# A grasp is read before the traces: its own was written first, so that it is found.
_COLUMNS: dict[type[Row], tuple[str, ...]] = {
    DesignRow: ("design_id", *PARAMETERS),
    ProposalRow: ProposalPart._fields[1:],
    ToolRow: ToolPart._fields[1:],
    GraspRow: GraspPart._fields[1:],
    TraceRow: ("grasp_id",),
    SimulationRow: SimulationPart._fields[1:],
}


class _Held:
    """What was read, by what the state says of it."""

    def __init__(self, question: Question) -> None:
        self._plans, self._grasps, self._simulations = Plans(question), Grasps(question), Simulations(question)
        self.take: dict[type[Row], Callable[[Iterable[tuple[Any, ...]]], None]] = {
            DesignRow: self._plans.add_designs,
            ProposalRow: self._plans.add_proposals,
            ToolRow: self._plans.add_tools,
            GraspRow: self._grasps.add,
            TraceRow: self._grasps.add_traces,
            SimulationRow: self._simulations.add,
        }

    def state(self) -> CampaignState:
        """All of it."""
        return CampaignState(**self._plans.fields(), **self._grasps.fields(), **self._simulations.fields())


class StateKeeper:
    """The answer to one question about a lake, the same for all calls; safe to use from several threads."""

    def __init__(self, question: Question) -> None:
        self._question = question
        self._lock = threading.Lock()
        self._marks: dict[type[Row], Mark] = {}
        self._held = _Held(question)
        self._state: CampaignState | None = None

    def state(self, lake: Lake) -> CampaignState:
        """Where the campaign stands now.

        Raises:
            LakeError: the lake cannot be read.
        """
        with self._lock:
            while not self._take_in(lake):
                self._marks, self._held = {}, _Held(self._question)
            if self._state is None:
                self._state = self._held.state()
            return self._state

    def _take_in(self, lake: Lake) -> bool:
        """Add what is new; False when some of what is held has gone, and all must be read again."""
        for row_type, columns in _COLUMNS.items():
            known = self._marks.get(row_type)
            new = additions(lake, row_type, columns, known)
            if new.mark == known:
                continue
            if known is not None and new.is_all:
                return False
            self._held.take[row_type](new.rows)
            self._marks[row_type], self._state = new.mark, None
        return True


_KEEPERS: WeakKeyDictionary[Lake, dict[Question, StateKeeper]] = WeakKeyDictionary()
_LOCK = threading.Lock()


def kept_state(lake: Lake, question: Question) -> CampaignState:
    """The state of a campaign, with the help of what was read for the same question before.

    Raises:
        LakeError: the lake cannot be read.
    """
    with _LOCK:
        keepers = _KEEPERS.setdefault(lake, {})
        keeper = keepers.pop(question, None) or StateKeeper(question)
        keepers[question] = keeper
        while len(keepers) > _KEPT:
            del keepers[next(iter(keepers))]  # the one that was not asked for longest
    return keeper.state(lake)


def derive_state(
    lake: Lake, campaign_id: str, setup_id: str, version_ids: Collection[str], older_ids: Collection[str] = ()
) -> CampaignState:
    """The state of a campaign from all rows of the lake; the arguments are those of `Question`."""
    question = Question(campaign_id, setup_id, frozenset(version_ids), frozenset(older_ids))
    return StateKeeper(question).state(lake)

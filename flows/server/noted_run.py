"""A run of a flow that nobody watches, with its last sentence, as a row of `flow_runs`."""

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables.campaign import FlowRunRow


@dataclass(frozen=True)
class NotedRun:
    """Which run it is; `flow_run_id` is Prefect's."""

    lake: Lake
    flow: str
    flow_run_id: str
    campaign_id: str | None
    seed: int

    def of(self, work: Callable[[], str]) -> str:
        """Do the work and write down the sentence that it ends with, or its error."""
        started_at = datetime.now(UTC)
        try:
            sentence = work()
        except BaseException as error:
            self._note(started_at, "failed", str(error) or type(error).__name__)
            raise
        self._note(started_at, "completed", sentence)
        return sentence

    def _note(self, started_at: datetime, status: Literal["completed", "failed"], reason: str) -> None:
        row = FlowRunRow(
            flow_run_id=self.flow_run_id,
            flow=self.flow,
            name=f"{self.flow} {self.campaign_id or self.lake.address}",
            campaign_id=self.campaign_id,
            status=status,
            reason=reason,
            started_at=started_at,
            ended_at=datetime.now(UTC),
            host=socket.gethostname(),
            process_id=os.getpid(),
        )
        self.lake.append([row], current_provenance(seed=self.seed))

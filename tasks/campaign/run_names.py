"""Names of task runs that say how far they are: `B07 gantry, tool 4, object 17 of 36`."""

import logging
import time
from uuid import UUID

from prefect import get_client

from fast.hardware.cell.cell import MeasuredGrasp
from fast.tasks.campaign.settings import ObjectPlan
from fast.tasks.campaign.state import Cell

logger = logging.getLogger(__name__)

INTERVAL_S = 10.0  # a grasp takes 15 s; on a virtual bench in lockstep they come much faster


class PlaceInName:
    """Names a tool's task run after the object it is at, as grasps are made.

    When the run ends, Prefect gives it its first name back.
    """

    def __init__(self, label: str, run_id: str, plan: ObjectPlan, done: set[Cell]) -> None:
        self._label = label
        self._run_id = UUID(run_id)
        self._n_objects, self._n_grasps = len(plan.object_ids), plan.n_grasps
        self._done = set(done)
        self._renamed_s = time.monotonic()

    @property
    def name(self) -> str:
        """The name that fits now."""
        return f"{self._label}, object {len({object_id for object_id, _ in self._done})} of {self._n_objects}"

    def count(self, grasp: MeasuredGrasp) -> None:
        """A grasp was made, whatever came of it; the name follows now and then, and at the end."""
        self._done.add((grasp.object_id, grasp.repeat))
        is_last = len(self._done) >= self._n_grasps
        if not is_last and time.monotonic() - self._renamed_s < INTERVAL_S:
            return
        self._renamed_s = time.monotonic()
        try:
            with get_client(sync_client=True) as client:
                client.set_task_run_name(self._run_id, self.name)
        except Exception as error:  # a server that restarts, or has not heard of the run yet: only the name is old
            logger.debug("the run %s keeps its name: %s", self._run_id, error)

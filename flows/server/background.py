"""The server's background work at a lab's pace: what Prefect does many times a second for thousands of flows.

Prefect hands its background work to a docket, a queue in memory, whose worker looks for work four times a second and
for cancelled work ten times. No lab needs that; it was two thirds of what a server uses while nothing happens.
"""

from datetime import timedelta
from typing import Any

LOOK_S = 1.0  # between looks for background work that is due; a form that is answered does not wait for it
HEARTBEAT_S = 60.0  # between signs of life to other servers of the same docket, of which there are none

# Seconds between the rounds of services, where Prefect has 5 to 20: late runs and workers that are gone are marked
# within a minute. New schedules are planned at Prefect's own pace. Whose process is gone, the sweeper finds.
ROUNDS = {
    "PREFECT_SERVER_SERVICES_LATE_RUNS_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_FOREMAN_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_PAUSE_EXPIRATIONS_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_REPOSSESSOR_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_CLEANUP_RECONCILER_LOOP_SECONDS": "60",
    "PREFECT_SERVER_SERVICES_CANCELLATION_CLEANUP_LOOP_SECONDS": "60",
    "PREFECT_SERVER_EVENTS_PROACTIVE_GRANULARITY": "PT60S",
}


def calm_worker() -> type[Any]:
    """The docket's worker, which looks seldom, and not for cancelled work: Prefect's server cancels none."""
    from docket import Docket, Worker

    class CalmWorker(Worker):
        def __init__(self, docket: Docket) -> None:
            docket.heartbeat_interval = timedelta(seconds=HEARTBEAT_S)
            look = timedelta(seconds=LOOK_S)
            super().__init__(docket, minimum_check_interval=look, scheduling_resolution=look)

        async def _cancellation_listener(self) -> None:
            session = self._processing_session
            if session is not None:
                session.cancellation_ready.set()
                await session.stopping.wait()

    return CalmWorker


def calm_down() -> None:
    """Have the server of this process do its background work so."""
    from prefect.server.api import background_workers

    background_workers.Worker = calm_worker()  # type: ignore[misc]

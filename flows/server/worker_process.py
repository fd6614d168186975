"""Body of the worker's own process: starts the runs that deployments ask for.

Arguments: how many runs at once, process id of the parent.
"""

import os
import sys
import warnings
from typing import Any

POOL = "lab"


def lab_worker(limit: int) -> Any:
    """A worker of the pool of prefect.yaml for so many runs at once."""
    from prefect.workers.process import ProcessWorker

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # it is to stand for the pool's type

        class LabWorker(ProcessWorker):
            async def _submit_scheduled_flow_runs(self, flow_run_response: Any) -> Any:
                """Leave a run whose process is still ending for the next look.

                A form that is answered within seconds is scheduled again before its suspended process is gone.
                Prefect's worker would take a second slot for it, which raises, and end with everything that it runs.
                """
                busy = set(self._limiter.statistics().borrowers) if self._limiter else set()
                ready = [one for one in flow_run_response if one.flow_run.id not in busy]
                return await super()._submit_scheduled_flow_runs(flow_run_response=ready)

    # The same name after a restart: one worker in the pages, not one for each start.
    return LabWorker(work_pool_name=POOL, name=f"{POOL}-{os.uname().nodename}", limit=limit)


def work(limit: int, parent_pid: int) -> None:
    """Work for the pool of prefect.yaml until the parent is gone."""
    import anyio

    from tasks.simulation.pool import follow_parent

    follow_parent(parent_pid)
    anyio.run(lab_worker(limit).start)


if __name__ == "__main__":
    work(int(sys.argv[1]), int(sys.argv[2]))

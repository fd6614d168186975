"""Body of the worker's own process: starts the runs that deployments ask for.

Arguments: how many runs at once, process id of the parent.
"""

import os
import sys

POOL = "lab"


def work(limit: int, parent_pid: int) -> None:
    """Work for the pool of prefect.yaml until the parent is gone."""
    import anyio
    from prefect.workers.process import ProcessWorker

    from tasks.pool import follow_parent

    follow_parent(parent_pid)
    # The same name after a restart: one worker in the pages, not one for each start.
    worker = ProcessWorker(work_pool_name=POOL, name=f"{POOL}-{os.uname().nodename}", limit=limit)
    anyio.run(worker.start)


if __name__ == "__main__":
    work(int(sys.argv[1]), int(sys.argv[2]))

"""Body of the worker's own process: starts the runs that deployments ask for.

Argument: process id of the parent.
"""

import os
import sys

POOL = "lab"


def work(parent_pid: int) -> None:
    """Work for the pool of prefect.yaml until the parent is gone.

    How many runs it does at once is a limit of the pool (`Lab`). A limit of the worker itself would count a run twice
    that is scheduled again while its process still ends, such as a form that is answered within seconds, and the
    worker would end with all its runs.
    """
    import anyio
    from prefect.workers.process import ProcessWorker

    from fast.tasks.simulation.pool import follow_parent

    follow_parent(parent_pid)
    # The same name after a restart: one worker in the pages, not one for each start.
    anyio.run(ProcessWorker(work_pool_name=POOL, name=f"{POOL}-{os.uname().nodename}").start)


if __name__ == "__main__":
    work(int(sys.argv[1]))

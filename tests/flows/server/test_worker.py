"""The worker of `fast serve`."""

from types import SimpleNamespace
from uuid import uuid4

import anyio
from prefect.workers.process import ProcessWorker

from flows.server.worker_process import lab_worker


def test_a_run_whose_process_is_still_ending_waits(monkeypatch):
    """Prefect's own worker fails on the slot that the run still holds, and ends all others with it."""
    taken = []

    async def submit(self, flow_run_response):
        for one in flow_run_response:
            self._limiter.acquire_on_behalf_of_nowait(one.flow_run.id)
            taken.append(one.flow_run.id)

    monkeypatch.setattr(ProcessWorker, "_submit_scheduled_flow_runs", submit)
    ending, other = uuid4(), uuid4()

    async def poll():
        worker = lab_worker(2)
        worker._limiter = anyio.CapacityLimiter(2)
        worker._limiter.acquire_on_behalf_of_nowait(ending)
        both = [SimpleNamespace(flow_run=SimpleNamespace(id=name)) for name in (ending, other)]
        await worker._submit_scheduled_flow_runs(flow_run_response=both)
        worker._limiter.release_on_behalf_of(ending)
        await worker._submit_scheduled_flow_runs(flow_run_response=both[:1])

    anyio.run(poll)
    assert taken == [other, ending]

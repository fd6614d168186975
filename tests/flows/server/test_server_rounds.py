"""The rounds of the server's services: seldom, but all of them."""

import asyncio
import time
from datetime import timedelta

import docket
from prefect.settings.models.root import Settings

from fast.flows.server.server import ROUNDS
from fast.flows.server.server_process import QUEUE_PACES, WORKER_PACES, slow_queue


def test_prefect_knows_every_round_and_had_it_more_often(monkeypatch):
    for name in ROUNDS:
        monkeypatch.delenv(name, raising=False)
    usual = Settings().server
    for name, value in ROUNDS.items():
        monkeypatch.setenv(name, value)
    ours = Settings().server
    for service in ("late_runs", "foreman", "pause_expirations", "repossessor", "cleanup_reconciler"):
        assert getattr(usual.services, service).loop_seconds < getattr(ours.services, service).loop_seconds
    assert usual.services.cancellation_cleanup.loop_seconds < ours.services.cancellation_cleanup.loop_seconds
    paces = [each.services.scheduler.recent_deployments_loop_seconds for each in (usual, ours)]
    assert paces[0] < paces[1]
    assert usual.events.proactive_granularity < ours.events.proactive_granularity == timedelta(seconds=60)


def test_the_queue_of_the_server_looks_seldom_for_work(monkeypatch):
    """A later version may call the parameters otherwise; then the server is busy again, but not in silence."""
    for made in (docket.Worker, docket.Docket):
        monkeypatch.setattr(made, "__init__", made.__init__)  # what is changed here is changed back
    slow_queue()
    queue = docket.Docket(name="x", url="memory://")
    worker = docket.Worker(queue)
    for made, paces in ((worker, WORKER_PACES), (queue, QUEUE_PACES)):
        assert {name: getattr(made, name).total_seconds() for name in paces} == paces
    assert docket.Worker(queue, scheduling_resolution=timedelta(seconds=1)).scheduling_resolution.total_seconds() == 1


def test_work_for_now_is_done_at_once(monkeypatch):
    """A run that is deleted, or a queue that is ready, does not wait for the next look."""
    for made in (docket.Worker, docket.Docket):
        monkeypatch.setattr(made, "__init__", made.__init__)
    slow_queue()

    async def put_in_and_wait() -> float:
        done = asyncio.Event()

        async def work() -> None:
            done.set()

        async with docket.Docket(name="y", url="memory://") as queue:
            queue.register(work)
            async with docket.Worker(queue) as worker:
                running = asyncio.create_task(worker.run_forever())
                await asyncio.sleep(0.5)  # it waits for work
                began_s = time.monotonic()
                await queue.add(work)()
                await asyncio.wait_for(done.wait(), 30)
                took_s = time.monotonic() - began_s
                running.cancel()
                await asyncio.gather(running, return_exceptions=True)
        return took_s

    assert asyncio.run(put_in_and_wait()) < min(WORKER_PACES.values()) / 2

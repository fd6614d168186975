"""The background work of the server: seldom, but all of it."""

import asyncio
import contextlib
import time
from datetime import timedelta

from docket import Docket, Perpetual, Worker
from prefect.settings.models.root import Settings

from flows.server.background import ROUNDS, calm_down, calm_worker


def test_prefect_knows_every_round_and_had_it_more_often(monkeypatch):
    for name in ROUNDS:
        monkeypatch.delenv(name, raising=False)
    usual = Settings().server
    for name, value in ROUNDS.items():
        monkeypatch.setenv(name, value)
    calm = Settings().server
    for service in ("late_runs", "foreman", "pause_expirations", "repossessor", "cleanup_reconciler"):
        assert getattr(usual.services, service).loop_seconds < getattr(calm.services, service).loop_seconds
    assert usual.services.cancellation_cleanup.loop_seconds < calm.services.cancellation_cleanup.loop_seconds
    assert calm.services.scheduler == usual.services.scheduler  # plans of a new schedule come as soon as ever
    assert usual.events.proactive_granularity < calm.events.proactive_granularity == timedelta(seconds=60)


def test_the_servers_worker_is_ours(monkeypatch):
    from prefect.server.api import background_workers

    monkeypatch.setattr(background_workers, "Worker", Worker)
    calm_down()
    assert background_workers.Worker.__name__ == "CalmWorker"
    # What it replaces is private to docket: another version must not drop it in silence.
    assert callable(Worker._cancellation_listener)


def test_work_is_done_within_a_look_and_comes_again():
    rounds: list[float] = []

    every = Perpetual(every=timedelta(seconds=0.1), automatic=True)

    async def often(perpetual: Perpetual = every) -> None:
        rounds.append(time.monotonic())

    async def run() -> None:
        async with Docket(name="calm", url="memory://calm") as docket, calm_worker()(docket) as worker:
            docket.register(often)
            task = asyncio.create_task(worker.run_forever())
            deadline = time.monotonic() + 20.0
            while len(rounds) < 2 and time.monotonic() < deadline:
                await asyncio.sleep(0.1)
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    asyncio.run(run())
    assert len(rounds) >= 2

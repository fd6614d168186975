"""The rounds of the server's services: seldom, but all of them."""

from datetime import timedelta

from prefect.settings.models.root import Settings

from flows.server.server import ROUNDS


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
    assert ours.services.scheduler == usual.services.scheduler  # plans of a new schedule come as soon as ever
    assert usual.events.proactive_granularity < ours.events.proactive_granularity == timedelta(seconds=60)

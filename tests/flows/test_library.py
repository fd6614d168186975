"""FAST from Python: the functions pass on what was asked, and fail in the sentences of the command line."""

from types import SimpleNamespace

import pytest

from fast.flows.gap import search
from fast.flows.library import find_gap
from fast.lake.store import Lake
from fast.models.errors import UsageError


def test_a_search_from_python_is_the_one_that_was_asked_for(tmp_path, monkeypatch):
    asked = []

    def run(lake, order, reporter):
        reporter.progress("simulated 1/2")
        asked.append((lake.address, order))
        return SimpleNamespace(run=SimpleNamespace(findings="found"))

    monkeypatch.setattr(search, "run_gap", run)
    Lake.open(tmp_path, create=True)
    heard = []
    assert (
        find_gap(tmp_path, "quick", n_designs=8, budget_minutes=2.0, n_workers=1, on_progress=heard.append) == "found"
    )
    (address, order), *_ = asked
    assert address == str(tmp_path)
    assert (order.campaign_id, order.panel.designs, order.budget_minutes, order.settings.workers) == (
        "quick",
        8,
        2.0,
        1,
    )
    assert heard == ["simulated 1/2"]


def test_a_lake_without_measurements_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(UsageError, match="measure"):
        find_gap(Lake.open(tmp_path, create=True))
    with pytest.raises(UsageError, match="is not a lake"):
        find_gap(tmp_path / "none")

"""`fast doctor --speed`: times of this computer, and what follows from them."""

import os

import pytest

from fast.flows.cli import speed
from tests.flows.cli.cli_lakes import Fast


def test_what_takes_hours_follows_from_the_time_of_a_grasp(capsys, monkeypatch):
    monkeypatch.setattr(speed, "time_grasp", lambda: 0.5)
    monkeypatch.setattr(speed, "time_scientist", lambda: (2.0, 3.0))
    rows = Fast(capsys)("doctor", "--speed", "--json").json
    assert [row["cpu_s"] for row in rows[:4]] == [0.5, 25_300, 2.0, 3.0]
    assert rows[1]["hours"] == pytest.approx(50_608 * 0.5 / os.cpu_count() / 3600, rel=0.05)
    assert [row["hours"] is None for row in rows] == [True, False, True, True, False]
    assert "10 tools on 8 objects, 3840 grasps" in rows[4]["work"]  # 48 simulators of a wide bank


def test_a_grasp_and_the_scientist_take_time(monkeypatch):
    monkeypatch.setattr(speed, "N_DESIGNS", 1)
    monkeypatch.setattr(speed, "OBJECTS", (2,))
    monkeypatch.setattr(speed, "N_SIM", 30)
    monkeypatch.setattr(speed, "N_REAL", 20)
    assert 0.0 < speed.time_grasp() < 60.0
    assert all(0.0 < cpu_s < 60.0 for cpu_s in speed.time_scientist())

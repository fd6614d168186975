"""Names of task runs follow the object that a tool is at."""

from contextlib import contextmanager
from types import SimpleNamespace
from uuid import UUID, uuid4

import pytest

from fast.tasks.campaign import prefect_tasks
from fast.tasks.campaign.prefect_tasks import PlaceInName
from fast.tasks.campaign.settings import ObjectPlan

RUN = str(uuid4())


def grasp(object_id, repeat):
    return SimpleNamespace(object_id=object_id, repeat=repeat)


@pytest.fixture
def named(monkeypatch):
    names = []

    @contextmanager
    def client(sync_client):
        yield SimpleNamespace(set_task_run_name=lambda run_id, name: names.append((run_id, name)))

    monkeypatch.setattr(prefect_tasks, "get_client", client)
    return names


def test_the_name_says_which_object_of_how_many(named, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(prefect_tasks.time, "monotonic", lambda: now_s[0])
    place = PlaceInName("B07 gantry, tool 4", RUN, ObjectPlan(ids=(3, 9), repeats=2), {(3, 0)})
    place.count(grasp(3, 1))
    assert named == []  # too soon
    now_s[0] = 11.0
    place.count(grasp(9, 0))
    place.count(grasp(9, 1))  # the last is told at once
    assert named == [(UUID(RUN), "B07 gantry, tool 4, object 2 of 2")] * 2


def test_a_server_that_does_not_answer_changes_nothing_else(monkeypatch):
    asked = []

    def broken(sync_client):
        asked.append(sync_client)
        raise ConnectionError("refused")

    monkeypatch.setattr(prefect_tasks, "get_client", broken)
    place = PlaceInName("B07 gantry, tool 4", RUN, ObjectPlan(ids=(3, 9), repeats=1), {(3, 0)})
    place.count(grasp(9, 0))
    assert (asked, place.name) == ([True], "B07 gantry, tool 4, object 2 of 2")

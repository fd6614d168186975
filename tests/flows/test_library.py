"""FAST from Python: the functions pass on what was asked, and fail in the sentences of the command line."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import torch

import fast
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


PULL = """
name = "pull"
seed = 1
schedule = {initial_tools = 3, guided_batches = 0, initial_simulations = 0, simulations_per_batch = 0}
objects = {ids = [2, 14], repeats = 1}
simulator = {simulate_tools = false}
bench = {kind = "folder"}
"""


@pytest.fixture
def pull(tmp_path: Path) -> fast.Campaign:
    (tmp_path / "pull.toml").write_text(PULL)
    return fast.Campaign(tmp_path / "pull.toml", tmp_path / "lake")


def rows_of(batch: Any) -> list[dict[str, Any]]:
    named = [{"tool_id": one.tool_id, "object_id": one.object_id, "repeat": one.repeat} for one in batch.grasps]
    return [one | {"peak_force_n": 10.0 + place, "reason": None} for place, one in enumerate(named)]


@pytest.mark.parametrize(
    "shape",
    [
        pd.DataFrame,
        lambda rows: [row for _, row in pd.DataFrame(rows).iterrows()],
        pa.Table.from_pylist,
        lambda rows: [{**row, "peak_force_n": torch.tensor(row["peak_force_n"])} for row in rows],
        lambda rows: (row for row in rows),
    ],
    ids=["pandas", "rows of pandas", "Arrow", "torch", "generator"],
)
def test_grasps_are_told_in_the_shapes_that_people_have(pull: fast.Campaign, shape: Callable[[Any], Any]) -> None:
    rows = rows_of(pull.ask(say=lambda line: None))
    assert pull.tell(shape(rows)).n_written == 6
    told = fast.Lake.open(pull.lake).query("SELECT peak_force_n FROM grasps ORDER BY peak_force_n")
    assert told["peak_force_n"].to_pylist() == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0]


def test_what_a_data_frame_lacks_was_not_told(pull: fast.Campaign) -> None:
    rows = rows_of(pull.ask(say=lambda line: None))
    rows[0] |= {"peak_force_n": None, "reason": "the finger tore"}
    taken = pull.tell(pd.DataFrame(rows).replace({None: np.nan}))
    assert (taken.n_written, taken.n_failed) == (6, 1)
    failed = fast.Lake.open(pull.lake).query("SELECT reason FROM grasps WHERE reason <> ''")
    assert failed["reason"].to_pylist() == ["the finger tore"]


def test_one_grasp_or_file_may_come_without_a_list(pull: fast.Campaign, tmp_path: Path) -> None:
    row, *others = rows_of(pull.ask(say=lambda line: None))
    assert pull.tell(row).n_written == 1
    pd.DataFrame(others).to_csv(tmp_path / "others.csv", index=False)
    assert pull.tell(str(tmp_path / "others.csv")).n_written == 5


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        ([3.0], "grasp 1 is of type float; tell mappings, a data frame or paths of files"),
        (
            {"tool_id": "B01T0", "object_id": 2, "repeat": 0, "trace": [0.0, 1.0]},
            "grasp 1: trace is of type list, it must be a fast.Trace",
        ),
    ],
)
def test_what_cannot_be_told_is_refused(pull: fast.Campaign, told: Any, sentence: str) -> None:
    pull.ask(say=lambda line: None)
    with pytest.raises(UsageError, match=sentence):
        pull.tell(told)


def test_numbers_of_numpy_ask_the_lake(pull: fast.Campaign) -> None:
    pull.tell(rows_of(pull.ask(say=lambda line: None)))
    lake = fast.Lake.open(pull.lake)
    number = pd.Series([14])[0]
    assert lake.query("FROM grasps WHERE object_id = $1", [number]).num_rows == 3
    assert lake.query("FROM grasps WHERE object_id = $which", {"which": number}).num_rows == 3


@pytest.mark.parametrize("named", [2, 2.0, np.int64(2), np.float64(2.0), torch.tensor(2), "2", "large sphere"])
def test_an_object_is_named_by_any_whole_number(monkeypatch: pytest.MonkeyPatch, named: Any) -> None:
    met = []
    monkeypatch.setattr(
        "fast.models.simulation.grasp.simulate_grasp", lambda design, obj, *given, **along: met.append(obj.object_id)
    )
    fast.simulate(fast.BEST_PUBLISHED, named)
    assert met == [2]


@pytest.mark.parametrize("named", [2.5, None, True, [2]])
def test_what_names_no_object_is_refused(named: Any) -> None:
    sentence = "it must be a fast.RigidObject, a number, a name or a file"
    with pytest.raises(UsageError, match=sentence):
        fast.simulate(fast.BEST_PUBLISHED, named)
    with pytest.raises(UsageError, match=sentence):
        fast.simulate_many(fast.BEST_PUBLISHED, [named])

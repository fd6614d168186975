"""docs/how-to/ask-the-lake.md: every query is answered on a made-up lake, and checked against pandas and numpy."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast.lake.query.catalogue import catalogue
from fast.lake.query.sql import run_sql
from fast.lake.store import Lake
from fast.models.records import Trace
from tests.lake.query import query_lake
from tests.lake.query.query_lake import Facts

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "how-to" / "ask-the-lake.md").read_text()
SECTIONS = dict(enumerate(re.split(r"^### \d+\. ", PAGE, flags=re.MULTILINE)[1:], start=1))
N_QUERIES = 12
Check = Callable[[pd.DataFrame, Facts], None]
CHECKS: dict[int, Check] = {}


def checks(number: int) -> Callable[[Check], Check]:
    def register(check: Check) -> Check:
        CHECKS[number] = check
        return check

    return register


def sql_of(number: int) -> str:
    return re.findall(r"```sql\n(.*?)```", SECTIONS[number], flags=re.DOTALL)[0]


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Lake, Facts]]:
    lake = Lake.open(tmp_path_factory.mktemp("queries") / "lake", create=True)
    yield lake, query_lake.build(lake)
    lake.close()


def test_the_page_has_its_numbered_questions():
    assert [int(n) for n in re.findall(r"^### (\d+)\. .*\?$", PAGE, flags=re.MULTILINE)] == list(
        range(1, N_QUERIES + 1)
    )
    assert PAGE.count("```sql\n") == N_QUERIES
    assert sorted(CHECKS) == sorted(SECTIONS)


@pytest.mark.parametrize("number", SECTIONS)
def test_query_is_answered_as_by_pandas(made_up, number):
    lake, facts = made_up
    table = run_sql(lake, sql_of(number))
    assert table.num_rows > 0
    CHECKS[number](table.to_pandas(), facts)
    assert lake.query(sql_of(number)).num_rows == table.num_rows


@pytest.mark.parametrize("number", SECTIONS)
def test_the_table_on_the_page_belongs_to_its_query(made_up, number):
    shown = re.findall(r"```text\n(.*?)\n", SECTIONS[number])
    assert [line.split() for line in shown] == [run_sql(made_up[0], sql_of(number)).column_names]


@pytest.mark.parametrize("number", SECTIONS)
def test_query_can_be_pasted_between_double_quotes(number):
    assert not set(sql_of(number)) & set('"$`\\!')


@pytest.mark.parametrize("entry", catalogue(), ids=lambda entry: entry.name)
def test_every_view_macro_and_table_says_what_it_shows(entry):
    assert len(entry.comment) > 10


def lift_of(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Lift and force of the samples from the last one before the lift."""
    return trace.lift_mm[trace.is_lift], trace.force_n[trace.is_lift]


def separation_mm(trace: Trace) -> float:
    lift, force = lift_of(trace)
    holding = np.flatnonzero(force >= max(0.5, force.max() / 10)) if force.size else np.array([], dtype=int)
    return float(lift[holding[-1]]) if holding.size else float("nan")


def above_mm(trace: Trace, fraction: float) -> float:
    lift, force = lift_of(trace)
    if not lift.size:
        return 0.0
    return float(np.diff(lift)[(force[1:] + force[:-1]) / 2 >= fraction * force.max()].sum())


def with_feature(facts: Facts, **features: Callable[[Trace], float]) -> pd.DataFrame:
    frame = facts.grasps.copy()
    for name, feature in features.items():
        frame[name] = [feature(trace) for trace in frame["trace"]]
    return frame


def pairs(facts: Facts) -> pd.DataFrame:
    """One row per tool and object."""
    keys = ["batch", "tool_id", "design_id", "object_id", "object_name", "object_class"]
    peaks = facts.grasps.groupby(keys)["peak_force_n"]
    return peaks.agg(["mean", "std"]).reset_index().rename(columns={"mean": "peak_force_n", "std": "repeat_sd_n"})


def quality(facts: Facts) -> pd.DataFrame:
    """One row per tool with the mean peak over its objects."""
    return pairs(facts).groupby(["batch", "tool_id", "design_id"])["peak_force_n"].mean().rename("q").reset_index()


def gaps(facts: Facts) -> pd.DataFrame:
    """One row per tool, object and tier with both peaks."""
    simulated = facts.simulations[facts.simulations["status"] == "ok"][
        ["design_id", "object_id", "tier", "peak_force_n"]
    ]
    joined = pairs(facts).merge(simulated.rename(columns={"peak_force_n": "sim_n"}), on=["design_id", "object_id"])
    return joined.assign(gap_n=joined["peak_force_n"] - joined["sim_n"])


def assert_by(table: pd.DataFrame, key: str, column: str, expected: pd.Series) -> None:
    """A column of the result equals what pandas says, key by key."""
    got = table.set_index(key)[column]
    for name, value in got.items():
        assert value == pytest.approx(expected[name], rel=1e-9, abs=1e-12), (name, column)


@checks(1)
def _worst_of_the_best(table, facts):
    best = quality(facts).set_index("tool_id")["q"].idxmax()
    expected = pairs(facts).query("tool_id == @best").set_index("object_name").nsmallest(3, "peak_force_n")
    assert set(table["tool_id"]) == {best}
    assert table["object_name"].tolist() == expected.index.tolist()
    assert table["repeat_sd_n"].tolist() == pytest.approx(expected["repeat_sd_n"].tolist())


@checks(2)
def _loses_first(table, facts):
    frame = with_feature(facts, separation=separation_mm)
    expected = frame[frame["tool_id"] == "quick/B03T2"].groupby("object_name")["separation"].mean().sort_values()
    assert table["object_name"].tolist() == expected.index[:5].tolist()
    assert_by(table, "object_name", "separation_lift_mm", expected)


@checks(3)
def _weakest_compared(table, facts):
    peaks = pairs(facts).pivot_table(index="object_name", columns="tool_id", values="peak_force_n")
    expected = (peaks["quick/B02T0"] / peaks.max(axis=1)).sort_values()
    assert table["object_name"].tolist() == expected.index[:5].tolist()
    assert_by(table, "object_name", "of_best", expected)
    assert table["best_tool_id"].tolist() == peaks.loc[table["object_name"]].idxmax(axis=1).tolist()


@checks(4)
def _missing(table, facts):
    assert (table.loc[0, "tool_id"], list(table.loc[0, "missing"])) == (query_lake.INCOMPLETE, ["hourglass"])
    assert table["n_objects"].tolist() == [7, 8, 8, 8, 8]
    assert table["missing"][1:].isna().all()


@checks(5)
def _parameter(table, facts):
    frame = quality(facts).merge(facts.designs, on="design_id")
    expected = frame.drop(columns=["batch", "tool_id", "design_id", "family", "parameters_json"]).corr()["q"].drop("q")
    assert set(table["parameter"]) == set(expected.index)
    assert_by(table, "parameter", "r", expected)
    assert table["r"].abs().is_monotonic_decreasing


@checks(6)
def _batches(table, facts):
    by_batch = quality(facts).groupby("batch")["q"]
    assert_by(table, "batch", "mean_n", by_batch.mean())
    assert_by(table, "batch", "best_n", by_batch.max())
    assert table["best_so_far_n"].tolist() == pytest.approx(by_batch.max().cummax().tolist())


@checks(7)
def _samples(table, facts):
    frame = facts.grasps.query("tool_id == 'quick/B03T2' and object_name == 'cube'").sort_values("repeat")
    assert table["repeat"].is_monotonic_increasing
    for column in ("time_s", "lift_mm", "force_n"):
        expected = np.concatenate([getattr(trace, column) for trace in frame["trace"]])
        np.testing.assert_allclose(table[column], expected, rtol=1e-6)


@checks(8)
def _force_at(table, facts):
    frame = with_feature(facts, at_20=lambda trace: float(np.interp(20, *lift_of(trace))))
    assert_by(table, "object_class", "at_20_mm_n", frame[frame["batch"] == 3].groupby("object_class")["at_20"].mean())


@checks(9)
def _repeatability(table, facts):
    frame = pairs(facts)
    pooled = frame.groupby("batch")["repeat_sd_n"].apply(lambda sd: np.sqrt((sd**2).mean()))
    assert_by(table, "batch", "repeat_sd_n", pooled)
    assert_by(table, "batch", "pair_sd_n", frame.groupby("batch")["peak_force_n"].std())


@checks(10)
def _drift(table, facts):
    frame = facts.grasps.copy()
    keys = ["tool_id", "object_id"]
    for name in ("order", "peak_force_n"):
        frame[name] = frame[name] - frame.groupby(keys)[name].transform("mean")
    for _, row in table.iterrows():
        group = frame[frame["batch"] == row["batch"]]
        assert row["drift_n_per_grasp"] == pytest.approx(np.polyfit(group["order"], group["peak_force_n"], 1)[0])
        assert row["drift_n_per_grasp"] == pytest.approx(query_lake.DRIFT_N_PER_GRASP, abs=0.2)


@checks(11)
def _failures(table, facts):
    counted = facts.attempts.groupby(["batch", "reason"]).size().to_dict()
    got = {(row["batch"], row["reason"]): row["n_attempts"] for _, row in table.iterrows()}
    assert got == counted
    assert got[(1, "gripper")] == got[(3, "overload")] == 1
    assert table.groupby("batch")["batch_part"].sum().tolist() == pytest.approx([1, 1, 1])


@checks(12)
def _simulation_error(table, facts):
    frame = gaps(facts).query("tier == 'production'")
    groups = frame.groupby("object_class")
    rmse = groups["gap_n"].apply(lambda gap: np.sqrt((gap**2).mean()))
    too_high = 100 * (groups["sim_n"].sum() / groups["peak_force_n"].sum() - 1)
    assert_by(table, "object_class", "gap_n", groups["gap_n"].mean())
    assert_by(table, "object_class", "simulated_too_high_percent", too_high)
    assert_by(table, "object_class", "rmse_n", rmse)
    assert_by(table, "object_class", "relative", rmse / groups["peak_force_n"].mean())


@pytest.fixture(scope="module")
def connection(tmp_path_factory: pytest.TempPathFactory) -> Iterator[duckdb.DuckDBPyConnection]:
    lake = Lake.open(tmp_path_factory.mktemp("macros") / "lake", create=True)
    with lake.connect() as connection:
        yield connection
    lake.close()


STEPS = st.lists(st.tuples(st.integers(0, 8), st.floats(-40, 40, allow_subnormal=False)), max_size=12)


@settings(max_examples=80, deadline=None)
@given(samples=STEPS, n_closing=st.integers(0, 3), at_mm=st.floats(0, 30), fraction=st.sampled_from([0.0, 0.5, 0.8]))
def test_feature_macros_agree_with_numpy_on_any_trace(connection, samples, n_closing, at_mm, fraction):
    lift_mm = np.cumsum([0.0 if i <= n_closing else step / 4 for i, (step, _) in enumerate(samples)])
    force_n = np.array([force for _, force in samples], dtype=float)
    trace = Trace(time_s=np.arange(len(samples), dtype=float), lift_mm=lift_mm, force_n=force_n)
    sql = (
        "SELECT separation_lift_mm(l, f), lift_above_mm(l, f, $fraction), force_at_n(l, f, $at_mm), peak_lift_mm(l, f) "
        "FROM (SELECT $lift::DOUBLE[] AS l, $force::DOUBLE[] AS f)"
    )
    values = {"lift": lift_mm.tolist(), "force": force_n.tolist(), "at_mm": at_mm, "fraction": fraction}
    ((separation, above, force_at, peak_lift),) = connection.execute(sql, values).fetchall()
    lift, force = lift_of(trace)
    if not lift.size:
        assert (separation, above, force_at, peak_lift) == (None, 0, None, None)
        return
    expected = separation_mm(trace)
    assert separation == (None if np.isnan(expected) else expected)
    assert above == pytest.approx(above_mm(trace, fraction), abs=1e-9)
    assert peak_lift == lift[np.argmax(force)]
    if at_mm > lift[-1]:
        assert force_at is None
    else:
        assert force_at == pytest.approx(_interpolated(lift, force, at_mm), abs=1e-9)


def _interpolated(lift: np.ndarray, force: np.ndarray, at_mm: float) -> float:
    """Force at a lift: the first sample that reaches it, or on the line to it from the sample before."""
    after = int(np.flatnonzero(lift >= at_mm)[0])
    if after == 0:
        return float(force[0])
    return float(np.interp(at_mm, lift[after - 1 : after + 1], force[after - 1 : after + 1]))

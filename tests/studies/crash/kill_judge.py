"""What must hold in the lake of a batch whose processes were killed, and what of it does not."""

import json
import os
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from fast.hardware.virtual.world.file import World
from fast.lake.maintenance import check
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GraspRow, Row, TraceRow
from fast.models.records import BENCH_FAULT
from fast.models.traces import peak_force_n
from fast.tasks.bench.plan import order_grasps
from fast.tasks.campaign.campaign import Campaign
from tests.studies.benchmarks.fingerprints import Label
from tests.studies.benchmarks.made_up_batch import CAMPAIGN_ID, Batch
from tests.studies.crash.labels import SparseTraceError, label_problem, read_fingerprint

Grasp = dict[str, Any]
UNKILLED_LIVES = 3  # the first, the last, and one that was faster than its kill


@dataclass(frozen=True)
class Told:
    """What the lives of a batch told their killer before they died, and the killer itself: lines of a file."""

    path: Path

    def tell(self, *words: object) -> None:
        """Add a line; it is whole or not there."""
        out = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(out, (" ".join(map(str, words)) + "\n").encode())
        os.close(out)

    def lines(self, kind: str) -> list[list[str]]:
        """Words of the lines that begin with `kind`, without it."""
        text = self.path.read_text() if self.path.exists() else ""
        return [line.split()[1:] for line in text.splitlines() if line.split()[0] == kind]


@dataclass(frozen=True)
class Found:
    """What a killed batch left: a row of numbers, and everything that is not as it must be."""

    row: Mapping[str, float]
    problems: list[str]


def judge(root: Path, batch: Batch, world: World, told: Told) -> Found:
    """Look at everything in the lake of a complete batch."""
    lake, n_killed = Lake.open(root), len(told.lines("killed"))
    grasps = sorted(lake.rows(GraspRow, campaign_id=CAMPAIGN_ID), key=lambda row: row["order"])
    good = [grasp for grasp in grasps if grasp["status"] == "ok"]
    n_written, mislabelled = _count(lake, GraspRow), _content_problems(lake, world, good)
    problems = [
        *_set_problems(batch, good),
        *_failure_problems(grasps),
        *_order_problems(Campaign(lake, batch.config), grasps),
        *mislabelled,
        *_story_problems(lake.rows(EventRow, campaign_id=CAMPAIGN_ID), told),
        *(finding.message for finding in check(lake)),
    ]
    if n_written != len(grasps):
        problems.append(f"{n_written} grasps were written for {len(grasps)}")
    row = {
        "kills": n_killed,
        "grasps": len(good),
        "cut_short_and_kept": len(grasps) - len(good),
        "died_between_trace_and_row": _count(lake, TraceRow) - n_written,
        "died_while_writing": len(list(root.rglob(".writing-*"))),
        "persons_called": len(told.lines("person")),
        "missing": len(set(batch.labels) - {_label(grasp) for grasp in good}),
        "made_twice": len(good) - len({_label(grasp) for grasp in good}),
        "mislabelled": len(mislabelled),
        "too_sparse_to_judge": _n_sparse(lake, good),
        "problems": len(problems),
    }
    return Found(row, problems)


def _set_problems(batch: Batch, good: list[Grasp]) -> list[str]:
    """Every grasp good once, and no other."""
    found = Counter(_label(grasp) for grasp in good)
    problems = [f"{label} is missing" for label in sorted(set(batch.labels) - set(found))]
    return problems + [
        f"{label} is there {n} times" for label, n in found.items() if n > 1 or label not in batch.labels
    ]


def _failure_problems(grasps: list[Grasp]) -> list[str]:
    """A grasp fails only where the bench could not go on, and its attempts are counted from 0."""
    problems, attempts = [], Counter[Label]()
    for grasp in grasps:
        label = _label(grasp)
        if grasp["attempt"] != attempts[label]:
            problems.append(f"{label} has attempt {grasp['attempt']} where {attempts[label]} is next")
        attempts[label] += 1
        if grasp["status"] != "ok" and json.loads(grasp["details_json"])["end"] != BENCH_FAULT:
            problems.append(f"{label} failed: {grasp['reason']}")
    return problems


def _order_problems(campaign: Campaign, grasps: list[Grasp]) -> list[str]:
    """Places from 0 on without gap or double, in the order of time; the good ones in the planned order."""
    problems = []
    if [grasp["order"] for grasp in grasps] != list(range(len(grasps))):
        problems.append(f"the places of the grasps are {[grasp['order'] for grasp in grasps]}")
    tools = campaign.state().tools_of(1)
    planned = [(tool.tool_id, *cell) for tool in tools for cell in order_grasps(campaign, tool)]
    if [_label(grasp) for grasp in grasps if grasp["status"] == "ok"] != planned:
        problems.append("the grasps were not made in the planned order")
    for before, after in pairwise(grasps):
        if before["started_at"] >= after["started_at"]:
            problems.append(f"{_label(after)} began before {_label(before)}, which comes before it")
    return problems


def _content_problems(lake: Lake, world: World, good: list[Grasp]) -> list[str]:
    """The force of every grasp says the label under which it is stored, and its scalars are of its trace."""
    problems = []
    for grasp in good:
        trace = lake.trace(grasp["grasp_id"])
        with suppress(SparseTraceError):  # counted by `_n_sparse`
            problems.append(label_problem(world, _label(grasp), trace))
        if peak_force_n(trace) != grasp["peak_force_n"]:
            problems.append(f"{_label(grasp)} has the peak of another trace")
    return [problem for problem in problems if problem]


def _n_sparse(lake: Lake, good: list[Grasp]) -> int:
    """Grasps whose readings are too few to say what was gripped: the machine was too busy, nothing is wrong."""
    n_sparse = 0
    for grasp in good:
        try:
            read_fingerprint(lake.trace(grasp["grasp_id"]))
        except SparseTraceError:
            n_sparse += 1
        except ValueError:
            continue  # a problem, told elsewhere
    return n_sparse


def _story_problems(events: list[dict[str, Any]], told: Told) -> list[str]:
    """A line for every life that came that far, and at most one for the end (a kill may come between)."""
    kinds = Counter(event["kind"] for event in events)
    problems = []
    n_started, n_lives = len(told.lines("started")), len(told.lines("killed")) + UNKILLED_LIVES
    if not n_started <= kinds["started"] <= n_lives:
        problems.append(f"{kinds['started']} events of a start for {n_lives} lives, {n_started} of which told of it")
    if kinds["batch_measured"] > 1:
        problems.append(f"the batch was measured {kinds['batch_measured']} times")
    return problems


def _label(grasp: Grasp) -> Label:
    return grasp["tool_id"], grasp["object_id"], grasp["repeat"]


def _count(lake: Lake, table: type[Row]) -> int:
    """Rows of a table that were ever written, replaced ones too."""
    return int(lake.query(f"SELECT count(*) AS n FROM raw_{table.table}")["n"][0].as_py())

"""Panels that hold nothing out: one finger on two objects, and a simulator of the lab's own beside ours."""

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fast.flows.cli.common import table_text
from fast.flows.gap import search, weigh
from fast.flows.gap.search import GapRequest, describe_cpu
from fast.flows.gap.weigh import describe_cost, is_small, weigh_panel
from fast.flows.progress import ProgressReporter
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, GraspRow, SimulationRow, TraceRow
from fast.lake.tables.row import Row
from fast.models.errors import UsageError
from fast.models.gap.evidence.candidates import weigh_candidates, weigh_quantities
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.objects.catalogue import get_object
from fast.models.records import EffectValue, Trace
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.mean_data import TooLittleDataError
from fast.tasks.gap.data import read_grasps
from fast.tasks.gap.moved import QUESTION
from fast.tasks.gap.panel import PanelSize
from fast.tasks.gap.simulated import read_simulated
from fast.tasks.simulation.plan import SimulationPlan
from tests.flows.cli.cli_lakes import Fast
from tests.synthetic.gap import made_up_gap
from tests.tasks.calibration.trace_lake import PROVENANCE
from tests.tasks.gap.gap_lake import BASE, DESIGNS, OBJECTS, SETUP, measured_rows, plan_rows, simulated_trace

ORDER = GapRequest("demo", rehearsed=16).with_workers(1)
LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.6})
pytestmark = pytest.mark.timeout(300)


def silent() -> ProgressReporter:
    return ProgressReporter(lambda _: None, lambda _: None)


@pytest.fixture(autouse=True)
def no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made-up answers in the place of finite elements."""

    def simulate(lake: Lake, plans: Sequence[SimulationPlan], *_: Any) -> None:
        lake.append(plan_rows(plans), PROVENANCE)

    monkeypatch.setattr(search, "simulate_missing", simulate)


def small_lake(root: Path, n_objects: int, hidden: Sequence[EffectValue] = (), wobble_n: float = 0.0) -> Lake:
    """One finger, gripping so many objects twice each. wobble_n: a force along the lift that no effect makes."""
    lake = Lake.open(root, create=True)
    rows: list[Row] = [DesignRow.of(DESIGNS[0])]
    for object_id in OBJECTS[:n_objects]:
        for repeat in range(2):
            for row in measured_rows(DESIGNS[0], "demo/B01T0", object_id, repeat, hidden=hidden):
                of_bench = {"bench": "virtual", "peak_force_n": 5.0}
                if isinstance(row, TraceRow):
                    trace = row.trace
                    force_n = trace.force_n + wobble_n * np.sin(trace.lift_mm)
                    row = TraceRow.of(row.grasp_id, Trace(trace.time_s, trace.lift_mm, force_n))
                rows.append(row.model_copy(update=of_bench) if isinstance(row, GraspRow) else row)
    lake.append(rows, PROVENANCE)
    return lake


def test_one_finger_on_two_objects_is_a_panel(tmp_path: Path) -> None:
    lake = small_lake(tmp_path / "lake", 2, [LAG])
    assert is_small(lake, ORDER)
    cost = describe_cost(lake, ORDER, silent())
    assert re.fullmatch(r"To simulate: \d+ of the 96 grasps of the bank; how long one takes is not known yet\.", cost)
    assert describe_cpu(60.0, 1) == "about 60 s of CPU, 60 s on 1 free core"
    found = weigh_panel(lake, ORDER, silent())
    assert describe_cost(lake, ORDER, silent()).startswith("To simulate: 0 of ")
    assert found.sentence.startswith("4 grasps of 1 tool on 2 objects; nothing is held out")
    assert "held-out" not in found.sentence
    assert f"Right with probability {found.naming.named.probability:.2f}." in found.sentence
    effects = [row["may be missing"] for row in found.list_rows()]
    assert len(effects) == len(set(effects))
    evidence = [row["evidence"] for row in found.list_rows()]
    assert evidence == sorted(evidence, reverse=True)
    for value in found.naming.values:
        row = next(row for row in found.list_rows() if row["may be missing"] == value.effect)
        assert all(f"{number:.3g}" in row["value"] for number in value.parameters.values())
    assert "load_cell_lag" in effects
    if found.naming.named.kind != "none":
        assert found.asked is not None or "No grasp of this bench would tell more." in found.sentence


def test_what_explains_little_is_not_called_alike_and_evidence_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lake = small_lake(tmp_path / "lake", 2, wobble_n=2.0)
    answer = Fast(capsys)("gap", "--lake", str(lake.root), "--rehearse", "16", "--workers", "1")
    assert "no effect of the catalogue explains" in answer.out
    assert "cannot be told apart" not in answer.out
    assert "evidence: natural logarithm of how much more probable" in answer.out
    assert " -0 " not in answer.out


def test_one_object_tells_nothing_and_is_refused_before_simulating(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "simulate_missing", lambda *_: pytest.fail("simulated"))
    lake = small_lake(tmp_path / "lake", 1)
    for refused in (lambda: weigh_panel(lake, ORDER, silent()), lambda: describe_cost(lake, ORDER, silent())):
        with pytest.raises(TooLittleDataError, match="1 object was gripped: .* 2 objects are the least"):
            refused()


def test_a_page_that_is_not_written_is_not_promised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    refused = Fast(capsys).refused("gap", "--lake", str(lake.root), "--out", str(tmp_path / "page"))
    assert "so small a panel gets no page, its answer is printed; leave out --out" in refused


def write_simulated(
    path: Path, lake: Lake, version: SimulatorVersion, n_objects: int, with_names: bool = False
) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("tool_id", "object_id", "lift_mm", "force_n"))
        (tool,) = read_grasps(lake, "demo").grasps.tools
        for object_id in OBJECTS[:n_objects]:
            trace = simulated_trace(DESIGNS[0], version, SETUP, object_id)
            for lift_mm, force_n in zip(trace.lift_mm.tolist(), trace.force_n.tolist(), strict=True):
                writer.writerow((tool, get_object(object_id).name if with_names else object_id, lift_mm, force_n))
    return path


def test_a_simulator_of_the_labs_own_stands_beside_ours(tmp_path: Path) -> None:
    """One that is ours at another theta is found there; what it lacks is what ours would lack."""
    lake = small_lake(tmp_path / "lake", 2)
    theta = BASE.theta.model_copy(update={"young_modulus_mpa": 7.0, "friction": 0.6})
    file = write_simulated(tmp_path / "own.csv", lake, BASE.model_copy(update={"theta": theta}), 2)
    found = weigh_panel(lake, ORDER, silent(), file)
    assert found.beside is not None
    assert found.beside.apart < 0.02
    assert found.beside.theta[0] == pytest.approx(7.0, rel=0.1)
    assert found.beside.theta[1] == pytest.approx(0.6, abs=0.06)
    assert "Your simulator is " in found.sentence
    soft = replace(found.beside, theta=found.naming.trials.fit.theta / np.array([9.81, 1.0, 1.0]))
    in_kg = replace(soft, factor=9.0)
    said = "The factor is about 9.81: check that its forces are in N, not in kg."
    assert soft.factor == pytest.approx(1.5, abs=0.5)  # forces of the same size, another friction: no unit
    assert [said in replace(found, beside=one).sentence for one in (found.beside, soft, in_kg)] == [False, False, True]
    assert np.isfinite(found.grasps.steps_n).all()


def test_an_object_of_a_file_may_be_called_by_its_name(tmp_path: Path) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    grasps = read_grasps(lake, "demo").grasps
    by_number = read_simulated(write_simulated(tmp_path / "own.csv", lake, BASE, 2), grasps)
    file = write_simulated(tmp_path / "names.csv", lake, BASE, 2, with_names=True)
    assert np.array_equal(read_simulated(file, grasps), by_number)
    file.write_text(file.read_text().replace(get_object(OBJECTS[0]).name, "quube"))
    with pytest.raises(UsageError, match="object_id is `quube`, it must be a number or a name; did you mean"):
        read_simulated(file, grasps)


def test_what_is_simulated_for_a_question_is_told_before_it_begins(tmp_path: Path) -> None:
    """Some 240 grasps began without a word of how long they take."""
    told: list[str] = []
    lake = small_lake(tmp_path / "lake", 2, [LAG])
    weigh_panel(lake, ORDER, ProgressReporter(lambda _: None, told.append))
    (said,) = (line for line in told if line.startswith(QUESTION))
    assert re.match(QUESTION + r": \d+ of \d+ simulations are in the lake, \d+ are made now; ", said)


def test_curves_that_are_missing_or_no_forces_are_named(tmp_path: Path) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    file = write_simulated(tmp_path / "own.csv", lake, BASE, 1)
    with pytest.raises(UsageError, match=f"lacks the curve of .* on object {OBJECTS[1]}; give 10 points or more"):
        weigh_panel(lake, ORDER, silent(), file)
    file.write_text("tool_id,object_id,lift_mm,force_n\nT,1,-3,2\n")
    with pytest.raises(UsageError, match="row 2: lift_mm is -3"):
        describe_cost(lake, ORDER, silent(), file)
    file.write_text("tool_id,object_id,lift_mm\nT,1,3\n")
    with pytest.raises(UsageError, match="force_n: the column is missing"):
        weigh_panel(lake, ORDER, silent(), file)


@pytest.mark.parametrize(
    ("lift_factor", "force_factor", "until_mm", "message"),
    [
        (1.0, 0.001, 60.0, "forces are .* times the measured ones; give them in N"),
        (1.0, 0.0, 60.0, "forces are 0 times the measured ones"),
        (1.0, -1.0, 5.0, "other sign than the measured ones"),
        (1.0, -1.0, 60.0, "other sign than the measured ones; a force is positive where the object pulls"),
        (0.001, 1.0, 60.0, "ends at 0.0[0-9]* mm of lift; give it in mm, from 0"),
        (1.0, 1.0, 5.0, "with .* N on the fingers, and what comes next is not known"),
    ],
)
def test_curves_of_another_unit_or_sign_or_cut_short_are_refused(
    tmp_path: Path, lift_factor: float, force_factor: float, until_mm: float, message: str
) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    file, grasps = write_simulated(tmp_path / "own.csv", lake, BASE, 2), read_grasps(lake, "demo").grasps
    header, *lines = file.read_text().splitlines()
    points = [(tool, obj, float(lift), float(force)) for tool, obj, lift, force in (line.split(",") for line in lines)]
    rows = [
        f"{tool},{obj},{lift_factor * lift},{force_factor * force}"
        for tool, obj, lift, force in points
        if lift < until_mm
    ]
    file.write_text("\n".join([header, *rows]))
    with pytest.raises(UsageError, match=message):
        read_simulated(file, grasps)


def test_a_curve_that_is_doubled_or_has_a_hole_is_refused(tmp_path: Path) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    file, grasps = write_simulated(tmp_path / "own.csv", lake, BASE, 2), read_grasps(lake, "demo").grasps
    header, *lines = file.read_text().splitlines()
    file.write_text("\n".join([header, *lines, *lines]))
    with pytest.raises(UsageError, match="the lift goes back from .* to 0 mm; give one curve of each grasp"):
        read_simulated(file, grasps)
    kept = [line for line in lines if not 2.0 < float(line.split(",")[2]) < 15.0]
    file.write_text("\n".join([header, *kept]))
    with pytest.raises(
        UsageError, match="stops at [12].* mm of lift with .* comes next is not known; give it without a hole"
    ):
        read_simulated(file, grasps)


@pytest.mark.parametrize(("factor", "said"), [(1000.0, "factor of about 1000 is suspected"), (-1.0, "the other sign")])
def test_measured_forces_that_are_not_in_n_are_refused_by_the_middle_of_the_bank(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float, said: str
) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    measured = read_grasps(lake, "demo")
    wrong = replace(measured, grasps=replace(measured.grasps, steps_n=factor * measured.grasps.steps_n))
    monkeypatch.setattr(weigh, "read_grasps", lambda *_: wrong)
    with pytest.raises(UsageError, match=said):
        weigh_panel(lake, ORDER, silent())
    assert len(lake.rows(SimulationRow)) <= 10  # of 96: two in the middle, and what tells how long one takes


def test_curves_that_a_spreadsheet_wrote_are_the_same(tmp_path: Path) -> None:
    lake = small_lake(tmp_path / "lake", 2)
    file, grasps = write_simulated(tmp_path / "own.csv", lake, BASE, 2), read_grasps(lake, "demo").grasps
    wanted = read_simulated(file, grasps)
    header, *lines = file.read_text().splitlines()
    cells = [(place, *line.split(",")) for place, line in enumerate(lines)]
    rows = [f"{n};{tool};{obj}.0;{lift};{force}".replace(".", ",") for n, tool, obj, lift, force in cells]
    # Numbers of rows, decimal commas, capitals.
    file.write_text("\n".join([";" + header.replace(",", ";").replace("tool_id", "Tool_ID"), *rows]))
    np.testing.assert_array_equal(read_simulated(file, grasps), wanted)


def test_a_panel_of_a_larger_lake_may_be_asked_for() -> None:
    assert PanelSize(1, 2).objects == 2
    with pytest.raises(UsageError, match="a panel of 1 objects tells nothing, 2 are the least"):
        PanelSize(objects=1)


def test_names_of_patterns_look_apart_in_the_printed_table() -> None:
    """A table cuts what is longer than its cells: of three clocks of a drift all looked the same."""
    fit = fit_evidence(Problem.of(made_up_gap(3, 3, 0).usable))
    names = {one.name for one in (*weigh_candidates(fit, ()), *weigh_quantities(fit))}
    assert len(names) > 30
    assert set(table_text([{"name": name} for name in names]).split("\n")[2:]) == names


def test_a_small_panel_of_the_example_is_weighed(capsys: pytest.CaptureFixture[str]) -> None:
    """The folder that its lake is unpacked into was taken for one that a person gave for the page."""
    assert "of the bank" in Fast(capsys)("gap", "--example", "--tools", "2", "--objects", "2", "--dry-run").out

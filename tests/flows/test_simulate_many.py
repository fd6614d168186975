"""`fast.simulate_many`: the same grasps as one by one, and what results show of themselves."""

import math
import re
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.progress import Progress

import fast
from fast.flows import library
from fast.flows.campaign.ask_tell import AskedBatch
from fast.flows.progress import ProgressReporter
from fast.flows.simulation import many_designs
from fast.flows.simulation.many_designs import SimulatedGrasps
from fast.models.objects.catalogue import OBJECTS
from fast.models.records import GraspSimulation, Trace
from fast.tasks.campaign.own_designs import OwnDesign
from fast.tasks.simulation.attempt import Attempt


class NoPool:
    """Workers that do nothing."""

    def __init__(self, n_workers: int) -> None:
        self.submit = lambda function, job: None
        self.call = lambda function: None

    def lend(self):
        return nullcontext(self)

    def close(self) -> None:
        pass


TRACE = Trace(np.arange(5.0), np.array([0.0, 0.0, 1.0, 2.0, 3.0]), np.array([-2.0, -3.0, 4.0, 1.0, 0.0]))
RESULT = GraspSimulation(TRACE, 4.0, 3.0, 0.006, 5, 20, 300, 0.1)


def make_object(**changed: object) -> fast.RigidObject:
    sizes = {"size_x_mm": 38, "size_y_mm": 34, "size_z_mm": 48}
    told = {"object_id": 100, "name": "egg", "object_class": "ellipsoid", "parameters": sizes, "orientation": "axis z"}
    return fast.RigidObject(**{**told, "mirror_x": True, "mirror_y": True, **changed})


def test_it_is_a_table_of_every_design_on_every_object(monkeypatch: pytest.MonkeyPatch) -> None:
    def attempt(worker, job, future):
        is_lost = job.obj.name == "cube"
        return Attempt(None if is_lost else RESULT, "time_out" if is_lost else "", "", 0.1, 0.0, 0.1)

    monkeypatch.setattr(many_designs, "WorkerPool", NoPool)
    monkeypatch.setattr(many_designs, "await_attempt", attempt)
    found = fast.simulate_many([fast.BEST_PUBLISHED] * 2, ["cube", 2], workers=1, show_progress=False)
    assert isinstance(found, SimulatedGrasps)
    assert found.peak_force_n.shape == (2, 2)
    assert [[math.isnan(force) for force in row] for row in found.peak_force_n] == [[True, False]] * 2
    frame = found.to_pandas()
    assert frame["object"].tolist() == ["cube", "large sphere"] * 2
    assert frame["failed"].tolist() == ["time_out", ""] * 2
    assert frame["peak_force_n"].dropna().tolist() == [4.0, 4.0]
    assert "<td>failed</td><td>4.0</td>" in found._repr_html_()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (([], ["cube"], 2), "0 designs and 1 objects are given; give at least one of each"),
        (([fast.BEST_PUBLISHED], ["cube"], 0), "workers is 0, it must be a whole number from 1 to 256"),
        (([fast.BEST_PUBLISHED], ["cube"], "2"), "workers is '2', it must be a whole number from 1 to 256"),
        ((["best"], ["cube"], 2), "design 0 is of type str, it must be a fast.Design"),
        ((fast.BEST_PUBLISHED.model_copy(update={"rib_count": 80}), "cube", 2), "design 0: `rib_count` is 80"),
        (([fast.BEST_PUBLISHED], ["cubic"], 2), "cubic"),
        ((None, 2, 2), "design 0 is of type NoneType, it must be a fast.Design"),
        ((fast.BEST_PUBLISHED, np.int64(99), 2), "object 99 does not exist"),
    ],
)
def test_what_cannot_be_simulated_is_refused(given: tuple, sentence: str) -> None:
    with pytest.raises(fast.FastError, match=sentence):
        fast.simulate_many(*given[:2], workers=given[2])


def test_a_trace_is_a_table_and_a_plot_of_its_lift() -> None:
    assert TRACE.to_pandas().to_dict("list")["force_n"] == TRACE.force_n.tolist()
    axes = Figure().subplots()
    assert RESULT.plot(axes) is axes
    assert axes.lines[0].get_xydata().tolist() == [[0.0, -3.0], [1.0, 4.0], [2.0, 1.0], [3.0, 0.0]]


def test_a_grasp_shows_its_numbers_and_its_force_in_a_notebook() -> None:
    shown = RESULT._repr_html_()
    assert "<th>peak pull-off force</th><td>4.00 N</td>" in shown
    assert shown.count("<svg") == shown.count("</svg>") == 1
    assert "flag" not in shown


def test_a_batch_to_measure_shows_its_tools() -> None:
    shown = AskedBatch("pull/B01", {"pull/B01T0": fast.BEST_PUBLISHED}, ())._repr_html_()
    assert "<th>pull/B01, 0 grasps</th><th>length_mm</th>" in shown
    assert "<th>pull/B01T0</th><td>30.83</td>" in shown


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: fast.FinRay(**{**fast.BEST_PUBLISHED.model_dump(), "length_mm": 99}),
            "FinRay: `length_mm` is 99 mm, it must be at most 35.0 mm; change it.",
        ),
        (lambda: fast.Theta(friction=9), "Theta: `friction` is 9, it must be at most 2.0; change it."),
        (
            lambda: fast.SimulatorVersion(tier="fine"),
            "SimulatorVersion: `tier` is 'fine': it must be production or reference; change it.",
        ),
        (
            lambda: make_object(object_class="elipsoid"),
            "RigidObject: unknown `object_class` `elipsoid`; did you mean `ellipsoid`?",
        ),
        (
            lambda: make_object(parameters={"size_x_mm": 38, "size_y_mm": 34}),
            "RigidObject: `parameters` of the class ellipsoid need `size_z_mm`; add it.",
        ),
        (
            lambda: make_object(parameters={"size_x_mm": -38}),
            "RigidObject: `parameters.size_x_mm` is -38 mm, it must be at least 0.0 mm; change it.",
        ),
        (lambda: fast.GraspSetup(closed_gap=3), "GraspSetup: unknown key `closed_gap`; did you mean `closed_gap_mm`?"),
    ],
)
def test_a_bad_number_is_one_sentence(make, sentence: str) -> None:
    with pytest.raises(fast.FastError) as refused:
        make()
    assert str(refused.value) == sentence


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            (fast.BEST_PUBLISHED.model_copy(update={"rib_count": 80}),),
            "design: `rib_count` is 80, it must be at most 10",
        ),
        ((fast.BEST_PUBLISHED.model_copy(update={"length_mm": math.nan}),), "design: `length_mm` is nan"),
        ((fast.BEST_PUBLISHED.model_copy(update={"rib_cout": 8}),), "unknown key `rib_cout`; did you mean `rib_count`"),
        (("best",), "design is of type str, it must be a fast.Design; change it"),
        ((fast.BEST_PUBLISHED, fast.Theta()), "version is of type Theta, it must be a fast.SimulatorVersion"),
        (
            (fast.BEST_PUBLISHED, None, fast.GraspSetup(closed_gap_mm=100)),
            "closed_gap_mm 100 is not below open_gap_mm 70 mm, so the jaws would not close",
        ),
        (
            (fast.BEST_PUBLISHED, fast.SimulatorVersion(fem_version="99")),
            "version: `fem_version` is '99', this program simulates by the code '4' or '3'; leave it out",
        ),
        ((fast.BEST_PUBLISHED, None, {"closed_gap_mm": 20}), "setup is of type dict, it must be a fast.GraspSetup"),
        (
            (fast.BEST_PUBLISHED, fast.SimulatorVersion(theta=fast.Theta().model_copy(update={"friction": 9}))),
            "version: `theta.friction` is 9, it must be at most 2.0",
        ),
    ],
)
def test_a_changed_copy_is_checked_where_it_is_used(given: tuple, sentence: str) -> None:
    with pytest.raises(fast.FastError, match=sentence):
        fast.simulate(given[0], "cube", *given[1:])
    with pytest.raises(fast.FastError, match=sentence):
        fast.grasp_function("cube", *given)


@pytest.mark.parametrize("names", [3, [None], ["friction", 3]])
def test_names_of_parameters_are_texts(names: Any) -> None:
    sentence = re.escape(f"is {names!r}, it must be names of parameters")
    with pytest.raises(fast.FastError, match=sentence):
        fast.simulate(fast.BEST_PUBLISHED, "cube", along=names)
    with pytest.raises(fast.FastError, match=sentence):
        fast.grasp_function("cube", names=names)


def test_a_script_that_is_read_by_its_own_workers_is_told_so_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("import fast\nfast.simulate_many(fast.BEST_PUBLISHED, range(36))\n", encoding="utf-8")
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False, timeout=100)
    assert ended.returncode == 1
    assert ended.stderr.count("RuntimeError") == 0
    assert ended.stderr.count('call `fast.simulate_many` there below `if __name__ == "__main__":`') == 1


def test_an_interrupt_waits_for_the_grasps_under_way_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = []

    def attempt(worker, job, future):
        simulated.append(job.obj.object_id)
        time.sleep(0.05)
        return Attempt(RESULT, "", "", 0.1, 0.0, 0.1)

    def interrupt(sentence, bars):
        if sentence.startswith("first"):
            raise KeyboardInterrupt

    monkeypatch.setattr(many_designs, "WorkerPool", NoPool)
    monkeypatch.setattr(many_designs, "await_attempt", attempt)
    own = [OwnDesign("", name, fast.BEST_PUBLISHED) for name in ("first", "second")]
    given = (fast.SimulatorVersion(), fast.GraspSetup(), fast.Placement(), 2, ProgressReporter(print, print, interrupt))
    with pytest.raises(KeyboardInterrupt):
        many_designs.simulate_designs(own, OBJECTS, *given)
    assert len(simulated) < len(OBJECTS)


def test_a_notebook_without_widgets_shows_no_warning(monkeypatch):
    """Rich showed `install "ipywidgets" for Jupyter support` above the result."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr(library, "find_spec", lambda name: None)
    with Progress(console=library._make_console(), transient=True) as display:  # a warning is an error here
        display.add_task("simulated", total=1)
    assert not display.console.is_jupyter

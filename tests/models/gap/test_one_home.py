"""An effect has one home: what a new one needs stands in one module, and gap discovery knows none by name."""

import ast
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from fast.flows.report.gap.page import write_gap_report
from fast.flows.report.gap.sentences import GapPage, describe_findings
from fast.models.gap.findings import Findings, Gap, RoundFindings
from fast.models.gap.naming.name import NamingResult, name_effect
from fast.models.records import EffectValue
from fast.models.simulation.effects.base import USUAL_LIFT_MM_PER_S, Effect, Number, Readings
from fast.models.simulation.effects.catalogue import CATALOGUE, catalogue_entries
from fast.models.simulation.effects.spec import EffectSpec, Measurement, amplitude
from fast.models.simulation.effects.states import FORCE, Quantity
from tests.docs.generated import write_effects, write_laws, write_searches
from tests.synthetic.gap import GapTruth, made_up_gap
from tests.synthetic.rehearsal import USUAL

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class LoadCellCurve(Effect):
    """The load cell is not linear: it reports F [1 + c F / 10 N], `curve_share` c. Made up for this test."""

    scales_with_modulus: ClassVar[bool] = False

    curve_share: float

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Reported over true force, at forces in N."""
        return 1.0 + self.curve_share * state / 10.0

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """The forces as they are reported."""
        return force_n * self.law(force_n)


LOAD_CELL_CURVE = EffectSpec(
    effect="load_cell_curve",
    title="The load cell is not linear",
    code="S7",
    layer="sensor",
    kind=LoadCellCurve,
    formula="F' = F (1 + curve_share F / 10 N)",
    source="non-linearity of force transducers: ISO 376",
    cost="P",
    parameters=(amplitude("curve_share", -0.9, 0.9, (0.0, 0.2)),),
    state=FORCE,
    quantity=Quantity("reported over true force", 1.0),
    family="curve of the load cell",
    experiment="hang dead weights of 0.5, 1 and 2 kg on the load cell",
    measurement=Measurement(
        kind="three_weights",
        words="hang 0.5, 1 and 2 kg on the load cell, and note its curve",
        label="Curve of the load cell",
        parameter="curve_share",
        sd=0.01,
        minutes=15.0,
        values=(-1.0, 1.0),
    ),
)
NEW = LOAD_CELL_CURVE.effect
NAMES = (NEW, "load_cell_lag", "static_kinetic_friction", "force_limited_closing", "load_cell_offset")


@pytest.fixture
def result(monkeypatch: pytest.MonkeyPatch) -> NamingResult:
    """The answer to a made-up world that hides the new effect."""
    monkeypatch.setitem(CATALOGUE, NEW, LOAD_CELL_CURVE)  # type: ignore[arg-type]  # a dict, but nobody writes into it
    hidden = EffectValue(effect=NEW, parameters={"curve_share": 0.6})
    data = made_up_gap(7, 7, 0, GapTruth(effects=(hidden,)), n_repeats=2)
    return name_effect(data, USUAL, catalogue=NAMES)


def test_a_new_effect_of_one_module_is_named_shown_and_documented(result: NamingResult, tmp_path: Path) -> None:
    named = result.named
    assert (named.kind, named.effects, named.family) == ("effect", (NEW,), LOAD_CELL_CURVE.family)
    assert named.parameters["curve_share"].median == pytest.approx(0.6, abs=0.2)
    assert named.law is not None
    assert (named.law.quantity, named.law.state) == ("reported over true force", "force, N")
    found = RoundFindings(where=(), candidates=result.candidates, named=named)
    gap = Gap(rmse_before_n=0.5, rmse_after_n=0.2, rmse_floor_n=0.1, closed_fraction=0.75, ci95=None)
    findings = Findings(alarm=True, rounds=(found,), gap=gap, aliases=(), next_experiment=None, seed=0, budget={})
    assert describe_findings(findings).startswith("Missing: The load cell is not linear.")
    page = write_gap_report(GapPage(findings), tmp_path, "X2").read_text(encoding="utf-8")
    assert "The load cell is not linear" in page
    assert any(entry["effect"] == NEW for entry in catalogue_entries())
    (parameters,) = (line for line in write_effects().splitlines() if NEW in line)
    (law,) = (line for line in write_laws().splitlines() if LOAD_CELL_CURVE.formula in line)
    (search,) = (line for line in write_searches().splitlines() if LOAD_CELL_CURVE.family in line)
    assert [line.split(" | ")[0] for line in (parameters, law, search)] == ["| S7"] * 3
    assert "hang dead weights" in search


@pytest.mark.parametrize("package", ["models/gap", "tasks/gap"])
def test_gap_discovery_names_no_effect(package: str) -> None:
    named = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sorted((ROOT / package).glob("**/*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if any(effect in node.value for effect in CATALOGUE)
    ]
    assert not named, "ask the entry of the effect (`EffectSpec`) instead of its name"

"""The simulator calibrated together with the effects that gap discovery named; the lake keeps each that was made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, PosteriorDrawsRow, SimulationRow, SimulatorVersionRow
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.inference.summary import check_quality, find_theta, summarise_theta
from fast.models.calibration.means.problem import THETA
from fast.models.errors import FastError
from fast.models.gap.ask.answers import Answers
from fast.models.gap.bank.bank import WIDE, BankPlan
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.data import GapData
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.findings import ParameterEstimate
from fast.models.ids import canonical_json
from fast.models.records import EffectValue
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import spell_share
from fast.tasks.calibration.calibrate import CalibrationData, Progress, calibrate_once, write_settings
from fast.tasks.gap.bank import list_plan_ids, plan_bank
from fast.tasks.gap.theta import count_training
from fast.tasks.simulation.plan import SimulationPlan

_NOT_JUDGED = "its held-out error has not been compared yet"

Simulate = Callable[[str, Sequence[SimulationPlan]], None]


@dataclass(frozen=True, eq=False)
class SearchInputs:
    """What every round of a search works with."""

    lake: Lake
    """That has the grasps, and gets what is simulated."""
    gap_id: str
    """Of the search."""
    data: GapData
    """With the bank of `bank_plan`."""
    base: SimulatorVersion
    """The simulator of the bank, without effects."""
    campaign_id: str | None
    """None: all measurements of the lake."""
    settings: CalibrationSettings
    """Of the calibrations."""
    simulate: Simulate
    """Makes what the lake lacks of plans, which the first argument names; it fails if it cannot make all."""
    rehearsal: Rehearsal
    """Made-up worlds of the wide bank, from which thresholds and probabilities come."""
    bank_plan: BankPlan = WIDE
    """Which bank answers."""
    answers: Answers | None = None
    """What came of earlier questions; None where nothing was asked."""
    progress: Progress | None = None
    """Takes what is done now, a sentence; None where nobody looks on."""


@dataclass(frozen=True, eq=False)
class CalibratedSimulator:
    """A calibrated simulator. names, draws: k and n x k, theta and `<effect>.<parameter>`, in their units."""

    version: SimulatorVersion
    calibration_id: str
    names: tuple[str, ...]
    draws: np.ndarray
    warnings: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[EffectValue, ...]:
        """Effects with the medians of their parameters."""
        return self.version.effects

    @property
    def theta(self) -> np.ndarray:
        """Medians of theta, 3."""
        theta = self.version.theta
        return np.array([theta.young_modulus_mpa, theta.friction, theta.poisson_ratio])

    def estimate_parameters(self, effects: Sequence[str]) -> dict[str, ParameterEstimate]:
        """Estimate the posterior of the parameters of effects, named `<effect>.<parameter>`."""
        found = {}
        for place, name in enumerate(self.names):
            if name.partition(".")[0] in effects:
                low, median, high = np.quantile(self.draws[:, place], [0.05, 0.5, 0.95])
                found[name] = ParameterEstimate(median=float(median), ci90=(float(low), float(high)))
        return found

    def draw(self, n: int, seed: int) -> list[tuple[np.ndarray, tuple[EffectValue, ...]]]:
        """Return draws (n), each theta (3) and effects."""
        from fast.models.gap.fit.posterior import effects_at

        rows = self.draws[np.random.default_rng(seed).integers(len(self.draws), size=n)]
        return [(row[: len(THETA)], effects_at(self.names, row.tolist())) for row in rows]


def calibrate_simulator(
    search: SearchInputs, effects: Sequence[EffectValue], *, is_on_trial: bool = False
) -> CalibratedSimulator:
    """Calibrate the simulator with effects on training grasps; from the lake if it has been made before.

    is_on_trial: it is written as one that nobody may use, until `admit_simulator`.

    Raises:
        FastError: no simulator may be built on the draws.
    """
    lake, data = search.lake, gather_effects(search, effects)
    if is_on_trial:
        data = replace(data, held_back=_NOT_JUDGED)
    row = calibrate_once(lake, data, search.settings, search.progress).row
    if row.version_id is None:
        raise FastError(f"calibration {row.calibration_id} with {', '.join(data.names) or 'theta alone'}: {row.reason}")
    (version,) = lake.records(SimulatorVersionRow, version_id=row.version_id)
    names, draws = _read_draws(lake, row.calibration_id)
    return CalibratedSimulator(version.version, row.calibration_id, names, draws, row.warnings)


def admit_simulator(lake: Lake, simulator: CalibratedSimulator, refused: str = "") -> None:
    """Write down that campaigns may use a simulator that was on trial, or why not (`refused`)."""
    row = lake.rows(CalibrationRow, calibration_id=simulator.calibration_id)[-1]
    found = CalibrationRow.model_validate({name: row[name] for name in CalibrationRow.model_fields})
    judged = found.model_copy(update={"status": "failed" if refused else "ok", "reason": refused})
    if judged != found:
        lake.append([judged], current_provenance(row["config_hash"], row["seed"], row["parents"]))


@dataclass(frozen=True, eq=False)
class EffectData(CalibrationData):
    """Grasps that may be learnt from, the bank around them, and the effects whose parameters are inferred with theta.

    `training`: of `GapData.training`. `effects`: with the values at which a fit may begin; without any,
    theta alone is inferred.
    """

    kind = "trace"

    training: Surrogate
    effects: tuple[EffectValue, ...]

    @property
    def summary(self) -> str:
        """How much there is to learn from."""
        names = ", ".join(self.names) or "no effect"
        return f"{len(self.grasp_ids)} traces, {len(self.simulation_ids)} simulated grasps, theta with {names}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(value.effect for value in self.effects)

    def describe(self, settings: CalibrationSettings) -> str:
        """Describe settings, effects and samples: what decides the result besides simulator, rows and seed."""
        return canonical_json([write_settings(settings), list(self.names), self.training.grasps.content_id])

    def learn(
        self, settings: CalibrationSettings, progress: Progress | None
    ) -> tuple[CalibrationResult, SimulatorVersion | None, dict[str, Any]]:
        """Infer theta and the parameters of the effects.

        Raises:
            UsageError: the bank has no simulations of an effect.
        """
        from fast.models.gap.fit.posterior import sample_posterior  # ArviZ takes seconds to import

        result = sample_posterior(self._fit, settings, progress)
        counts = count_training(self.training)
        n_held_out = len(self.training.grasps.tools) - counts["n_designs"]
        columns = counts | {"n_simulations": len(self.simulation_ids), "n_held_out": n_held_out}
        return result, make_version(self.base, result), columns

    @cached_property
    def _fit(self) -> Any:
        from fast.models.gap.fit.recalibrate import recalibrate

        return recalibrate(self.training, self.effects)


def gather_effects(search: SearchInputs, effects: Sequence[EffectValue]) -> EffectData:
    """Gather what a calibration with effects is made of; without any, of theta alone."""
    training = search.data.training
    wanted = list_plan_ids(plan_bank(search.base, search.data.grasps.cells, search.bank_plan))
    known = tuple(sorted(search.lake.ids(SimulationRow, simulation_id=wanted, status="ok")))
    share = training.bank.failed_share
    warnings = (f"{spell_share(share, 1)} of the simulations of the bank failed.",) if share > 0 else ()
    ids = training.grasps.grasp_ids
    return EffectData(search.campaign_id, search.base, ids, known, warnings, training=training, effects=tuple(effects))


def make_version(base: SimulatorVersion, result: CalibrationResult) -> SimulatorVersion | None:
    """Make the simulator with the medians of theta and effect parameters; None if the draws cannot be trusted."""
    from fast.models.gap.fit.posterior import effects_at

    if check_quality(result):
        return None
    medians = [float(np.median(result.of(name))) for name in result.names]
    effects = effects_at(result.names, medians)
    return base.model_copy(update={"theta": find_theta(summarise_theta(result)), "effects": (*base.effects, *effects)})


def _read_draws(lake: Lake, calibration_id: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Read names and draws (n x k) of a calibration, theta first."""
    rows = sorted(lake.records(PosteriorDrawsRow, calibration_id=calibration_id), key=lambda row: row.chain)
    names = sorted({row.parameter for row in rows}, key=lambda name: (THETA.index(name) if name in THETA else 9, name))
    columns = [np.concatenate([row.draws for row in rows if row.parameter == name]) for name in names]
    return tuple(names), np.stack(columns, axis=1)

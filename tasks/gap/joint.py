"""Calibration of theta together with the effects that gap discovery named: what goes in, what is built on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lake.store import Lake
from lake.tables.campaign import CalibrationRow, SimulationRow
from models.calibration.inference.result import CalibrationResult
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.inference.summary import check_quality, find_theta, summarise_theta
from models.gap.problem import GapProblem
from models.ids import canonical_json
from models.records import EffectValue, SimulatorVersion
from tasks.calibration.calibrate import CalibrationSource, Learned, Progress, write_settings
from tasks.gap.bank import bank_ids


@dataclass(frozen=True, eq=False)
class JointCalibrationData(CalibrationSource):
    """Grasps that may be learnt from, the bank around them, and the effects whose parameters are inferred with theta.

    `training`: of `models.gap.fit.whiten.training`. `effects`: with the values at which a fit may begin; without any,
    theta alone is inferred. `known_ids`: simulations of the bank that the lake has.
    """

    data = "trace"

    training: GapProblem
    effects: tuple[EffectValue, ...]
    known_ids: tuple[str, ...]

    @property
    def grasp_ids(self) -> tuple[str, ...]:
        """Ids of the grasps that went in; held-out ones are not among them."""
        return self.training.grasps.grasp_ids

    @property
    def simulation_ids(self) -> tuple[str, ...]:
        """Ids of the simulations that went in."""
        return self.known_ids

    @property
    def warnings(self) -> tuple[str, ...]:
        """Simulations that failed."""
        share = self.training.bank.failed_share
        return (f"{100 * share:.1f} % of the simulations of the bank failed.",) if share > 0 else ()

    @property
    def summary(self) -> str:
        """How much there is to learn from."""
        names = ", ".join(self.names) or "no effect"
        return f"{len(self.grasp_ids)} traces, {len(self.known_ids)} simulated grasps, theta with {names}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(value.effect for value in self.effects)

    def calibration_id(self, settings: CalibrationSettings) -> str:
        """Id of the calibration of these data with these effects and settings."""
        text = canonical_json([write_settings(settings), list(self.names)])
        return CalibrationRow.make_id(self.base.version_id, self.data, self.row_ids, text, settings.seed)

    def learn(self, settings: CalibrationSettings, progress: Progress | None) -> Learned:
        """Infer theta and the parameters of the effects.

        Raises:
            UsageError: the bank has no simulations of an effect.
        """
        from models.gap.fit.posterior import joint_posterior  # ArviZ takes seconds to import

        result = joint_posterior(self._fit, settings, progress)
        grasps = self.training.grasps
        columns: dict[str, Any] = {
            "n_designs": len(np.unique(grasps.tool)),
            "n_objects": len(np.unique(grasps.obj)),
            "n_simulations": len(self.known_ids),
            "n_held_out": len(grasps.tools) - len(np.unique(grasps.tool)),
        }
        return Learned(result, version_with(self.base, result), columns)

    @cached_property
    def _fit(self) -> Any:
        from models.gap.fit.frame import recalibrated

        return recalibrated(self.training, self.effects)


def joint_data(
    lake: Lake,
    training: GapProblem,
    base: SimulatorVersion,
    campaign_id: str | None,
    effects: Sequence[EffectValue],
) -> JointCalibrationData:
    """What a joint calibration is made of; `base` is the simulator of the bank, without effects."""
    grasps = training.grasps
    wanted = bank_ids(base, grasps.designs, grasps.objects, grasps.setup)
    known = tuple(sorted(lake.ids(SimulationRow, simulation_id=wanted, status="ok")))
    return JointCalibrationData(campaign_id, base, training, tuple(effects), known)


def version_with(base: SimulatorVersion, result: CalibrationResult) -> SimulatorVersion | None:
    """The simulator with the medians of theta and of the effects' parameters; None if the draws cannot be trusted."""
    from models.gap.fit.posterior import effects_at

    if check_quality(result):
        return None
    medians = [float(np.median(result.of(name))) for name in result.names]
    effects = effects_at(result.names, medians)
    return base.model_copy(update={"theta": find_theta(summarise_theta(result)), "effects": (*base.effects, *effects)})

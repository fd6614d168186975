"""Infer theta from what a calibration compares, and write what was found: calibration, draws, simulator version."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from fast.lake.provenance import Provenance, current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, PosteriorDrawsRow
from fast.lake.tables.catalogue_rows import append_version
from fast.lake.tables.row import Row
from fast.models.calibration.inference.lot_priors import TAIL, make_lot_priors
from fast.models.calibration.inference.result import CalibrationResult
from fast.models.calibration.inference.settings import WITH_EFFECTS, CalibrationSettings
from fast.models.calibration.inference.summary import check_quality, find_theta, find_worst, summarise_theta
from fast.models.calibration.means.problem import THETA
from fast.models.ids import canonical_json, content_id
from fast.models.material import modulus_of_hardness_mpa
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.calibration.drift import find_drift, read_theta_history
from fast.tasks.campaign.material import StoredLot, find_lot

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class CalibrationData(ABC):
    """Everything that decides a calibration but its settings, of whatever kind of data.

    `grasp_ids`, `simulation_ids`: of what went in. `warnings`: what was left out or is doubtful. `material_ids`: the
    measured quantities of a material lot behind the priors of the settings.
    """

    kind: ClassVar[Literal["design_mean", "trace"]]

    campaign_id: str | None
    base: SimulatorVersion
    grasp_ids: tuple[str, ...]
    simulation_ids: tuple[str, ...]
    warnings: tuple[str, ...]
    material_ids: tuple[str, ...] = field(default=(), kw_only=True)
    held_back: str = field(default="", kw_only=True)

    @property
    @abstractmethod
    def summary(self) -> str:
        """How much there is to learn from."""

    @abstractmethod
    def learn(
        self, settings: CalibrationSettings, progress: Progress | None
    ) -> tuple[CalibrationResult, SimulatorVersion | None, dict[str, Any]]:
        """Return draws of theta, the simulator to build on them, and columns of `calibrations` that this kind fills.

        Raises:
            UsageError: there is too little to learn from.
        """

    @property
    def row_ids(self) -> list[str]:
        """Ids of the grasps and simulations that went in."""
        return [*self.grasp_ids, *self.simulation_ids]

    @property
    def parents(self) -> list[str]:
        """Ids of all rows that the calibration is made from."""
        return [*self.row_ids, *self.material_ids]

    def describe(self, settings: CalibrationSettings) -> str:
        """Describe what decides the result besides simulator, rows and seed."""
        return write_settings(settings)

    def calibration_id(self, settings: CalibrationSettings) -> str:
        """Return the id of the calibration of these data with these settings."""
        return CalibrationRow.make_id(
            self.base.version_id, self.kind, self.row_ids, self.describe(settings), settings.seed
        )


@dataclass(frozen=True)
class CalibrationOutcome:
    """The calibration of some data; `is_new`: it was made just now."""

    row: CalibrationRow
    is_new: bool
    n_grasps: int

    @property
    def sentence(self) -> str:
        """What happened, for people and for the state of a flow run."""
        row = self.row
        made = "simulated grasps" if row.data == "trace" else "simulated designs"
        n_tools = row.n_designs + (row.n_held_out or 0)
        what = f"{self.n_grasps} grasps of {n_tools} tools and {row.n_simulations} {made}"
        if row.version_id is None:
            return f"calibration {row.calibration_id} of {what} gave no simulator version: {row.reason}"
        if not self.is_new:
            return f"nothing new since calibration {row.calibration_id}: the same {what}"
        return f"calibration {row.calibration_id} of {what} gave simulator version {row.version_id}"


def calibrate_once(
    lake: Lake, data: CalibrationData, settings: CalibrationSettings, progress: Progress | None = None
) -> CalibrationOutcome:
    """Return the calibration of these data with these settings: the lake's, else a new one, which `infer` writes.

    Raises:
        UsageError: there is too little to learn from.
    """
    calibration_id = data.calibration_id(settings)
    known = lake.records(CalibrationRow, calibration_id=calibration_id)
    if known:
        return CalibrationOutcome(known[-1], False, len(data.grasp_ids))
    if progress is not None:
        progress(f"{data.summary}; {settings.chains} chains of {settings.tune} + {settings.draws} draws")
    row, _ = infer(lake, data, settings, progress)
    return CalibrationOutcome(row, True, len(data.grasp_ids))


def write_settings(settings: CalibrationSettings) -> str:
    """Write the settings that decide the result, as JSON; the seed has its own column, processes change nothing."""
    return canonical_json(settings.model_dump(mode="json", exclude={"workers", "seed"}))


def infer(
    lake: Lake, data: CalibrationData, settings: CalibrationSettings, progress: Progress | None = None
) -> tuple[CalibrationRow, CalibrationResult]:
    """Infer theta and write calibration, draws and, if the draws can be trusted, a simulator version.

    The version is the base with the medians of theta. Drift since the calibration before, of the same kind of data, is
    a warning. The draws are written first: a killed process leaves draws without a calibration, which the next call
    replaces.

    Raises:
        UsageError: there is too little to learn from.
    """
    result, version, columns = data.learn(settings, progress)
    calibration_id = data.calibration_id(settings)
    provenance = current_provenance(content_id("H", write_settings(settings)), settings.seed)
    lake.append(make_draw_rows(calibration_id, result), provenance)
    if version is not None:
        append_version(lake, version, _with_parents(provenance, [calibration_id]))
    history = read_theta_history(lake, data.base.version_id, data.campaign_id, data.kind)
    can_drift = version is not None and result.method != WITH_EFFECTS
    drift = find_drift(history, summarise_theta(result)) if can_drift else ()
    row = CalibrationRow(
        calibration_id=calibration_id,
        campaign_id=data.campaign_id,
        base_version_id=data.base.version_id,
        version_id=version.version_id if version is not None else None,
        data=data.kind,
        status="ok" if version is not None else "failed",
        settings_json=write_settings(settings),
        n_tune=settings.tune,
        **_describe_draws(result),
        **columns,
        warnings=(*data.warnings, *result.warnings, *drift),
        cpu_s=result.cpu_s,
    )
    if data.held_back and not row.reason:
        row = row.model_copy(update={"status": "failed", "reason": data.held_back})
    lake.append([row], _with_parents(provenance, data.parents))
    return row, result


def make_version(base: SimulatorVersion, result: CalibrationResult) -> SimulatorVersion | None:
    """Make the simulator with the theta that was found, or None where nothing may be built on the draws."""
    if check_quality(result):
        return None
    return base.model_copy(update={"theta": find_theta(summarise_theta(result))})


def make_draw_rows(calibration_id: str, result: CalibrationResult) -> list[Row]:
    """Make a row for each parameter and chain."""
    return [
        PosteriorDrawsRow.of(calibration_id, chain, name, result.draws[chain, :, place])
        for chain in range(result.draws.shape[0])
        for place, name in enumerate(result.names)
    ]


def _with_parents(provenance: Provenance, parents: list[str]) -> Provenance:
    return provenance.model_copy(update={"parents": tuple(parents)})


def _describe_draws(result: CalibrationResult) -> dict[str, Any]:
    """Describe the draws in columns of `calibrations`: Table 2, and how far they can be trusted."""
    summary = summarise_theta(result)
    r_hat, ess = find_worst(result)
    unit = {"young_modulus_mpa": "_mpa"}
    table_2 = {
        f"{name.removesuffix('_mpa')}_{column}{unit.get(name, '')}": getattr(summary[name], column)
        for name in THETA
        for column in ("mean", "sd", "q05", "median", "q95", "mode")
    }
    return {
        **table_2,
        "reason": check_quality(result),
        "n_chains": result.draws.shape[0],
        "n_draws": result.draws.shape[1],
        "sampler": result.method,
        "r_hat_max": r_hat,
        "ess_bulk_min": ess,
        "n_divergences": result.n_divergences,
        "k_hat": result.k_hat,
    }


def take_lot(
    lake: Lake, settings: CalibrationSettings, asked: str | None, campaign_ids: Collection[str]
) -> tuple[CalibrationSettings, StoredLot | None]:
    """Return settings with the priors of the lot that was asked for or that the campaigns name, and the lot.

    Without a lot the settings stay as they are; `asked` as in `tasks.campaign.material.find_lot`.

    Raises:
        UsageError: the lot is not there, cannot be used, or makes no prior.
    """
    lot = find_lot(lake, asked, campaign_ids)
    if lot is None:
        return settings, None
    return settings.model_copy(update={"priors": make_lot_priors(lot.name, lot.lot)}), lot


def describe_lot(settings: CalibrationSettings, stored: StoredLot) -> str:
    """Describe the priors that a lot gave, in words, and what its hardness would say of the modulus."""
    lot, ends = stored.lot, settings.priors.quantile(np.outer([0.5, TAIL, 1.0 - TAIL], np.ones(3)))
    given = {"Young's modulus": lot.young_modulus, "friction": lot.static_friction or lot.dynamic_friction}
    parts = [
        f"{words} {ends[0, k]:.3g}{unit} ({ends[1, k]:.3g} to {ends[2, k]:.3g})"
        + ("" if given[words] is not None else " from Table 3")
        for k, (words, unit) in enumerate((("Young's modulus", " MPa"), ("friction", "")))
    ]
    sentence = f"priors of material lot {stored.name}, median and 90 % interval: {', '.join(parts)}"
    if lot.hardness is None:
        return sentence
    modulus_mpa = modulus_of_hardness_mpa(lot.hardness.value)
    return f"{sentence}; only to check: {lot.hardness.value:g} Shore A is about {modulus_mpa:.3g} MPa by Gent's formula"

"""The simulator of a round of gap discovery: its effects, their joint posterior with theta, and its version."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lake.store import Lake
from lake.tables.campaign import PosteriorDrawsRow, SimulatorVersionRow
from models.calibration.inference.settings import CalibrationSettings
from models.calibration.means.problem import THETA
from models.errors import FastError
from models.gap.findings import NamedParameter
from models.gap.problem import GapProblem
from models.records import EffectValue, SimulatorVersion, Theta
from tasks.calibration.calibrate import Progress, find_calibration, infer
from tasks.gap.joint import joint_data


@dataclass(frozen=True, eq=False)
class GapModel:
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

    def parameters(self, effects: Sequence[str]) -> dict[str, NamedParameter]:
        """Posterior of the parameters of effects, named `<effect>.<parameter>`."""
        found = {}
        for place, name in enumerate(self.names):
            if name.partition(".")[0] in effects:
                low, median, high = np.quantile(self.draws[:, place], [0.05, 0.5, 0.95])
                found[name] = NamedParameter(median=float(median), ci90=(float(low), float(high)))
        return found

    def drawn(self, n: int, seed: int) -> list[tuple[np.ndarray, tuple[EffectValue, ...]]]:
        """Draws (n), each theta (3) and effects."""
        from models.gap.fit.posterior import effects_at

        rows = self.draws[np.random.default_rng(seed).integers(len(self.draws), size=n)]
        return [(row[: len(THETA)], effects_at(self.names, row.tolist())) for row in rows]


def calibrated_model(
    lake: Lake,
    training: GapProblem,
    base: SimulatorVersion,
    campaign_id: str | None,
    effects: Sequence[EffectValue],
    settings: CalibrationSettings,
    progress: Progress | None = None,
) -> GapModel:
    """The simulator `base` with effects, calibrated on training grasps, from the lake if it has been made before.

    Raises:
        FastError: no simulator may be built on the draws.
    """
    data = joint_data(lake, training, base, campaign_id, effects)
    calibration_id = data.calibration_id(settings)
    row = find_calibration(lake, calibration_id)
    if row is None:
        row, _ = infer(lake, data, settings, progress)
    if row.version_id is None:
        raise FastError(f"calibration {calibration_id} with {', '.join(data.names) or 'theta alone'}: {row.reason}")
    (version,) = lake.records(SimulatorVersionRow, version_id=row.version_id)
    names, draws = _draws(lake, calibration_id)
    return GapModel(version.version, calibration_id, names, draws, row.warnings)


def theta_record(theta: np.ndarray) -> Theta:
    """Theta (3) as a record."""
    return Theta(young_modulus_mpa=float(theta[0]), friction=float(theta[1]), poisson_ratio=float(theta[2]))


def _draws(lake: Lake, calibration_id: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and draws (n x k) of a calibration, theta first."""
    rows = sorted(lake.records(PosteriorDrawsRow, calibration_id=calibration_id), key=lambda row: row.chain)
    names = sorted({row.parameter for row in rows}, key=lambda name: (THETA.index(name) if name in THETA else 9, name))
    columns = [np.concatenate([row.draws for row in rows if row.parameter == name]) for name in names]
    return tuple(names), np.stack(columns, axis=1)

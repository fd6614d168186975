"""Theta over time: the calibrations of one simulator, and whether the newest contradicts the one before."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow
from fast.models.calibration.inference.parameter import ParameterSummary
from fast.models.calibration.inference.settings import WITH_EFFECTS
from fast.models.calibration.means.problem import THETA

_WORDS = {
    "young_modulus_mpa": ("Young's modulus", " MPa"),
    "friction": ("friction", ""),
    "poisson_ratio": ("Poisson's ratio", ""),
}


class PastCalibration(NamedTuple):
    """Median and 90 % interval of each parameter of theta, as one calibration found them."""

    calibration_id: str
    made_at: datetime
    intervals: Mapping[str, tuple[float, float, float]]  # 5 % quantile, median, 95 % quantile

    @staticmethod
    def of(row: Mapping[str, Any]) -> "PastCalibration":
        """Return what a row of `calibrations` says."""
        intervals = {}
        for name in THETA:
            stem, unit = name.removesuffix("_mpa"), "_mpa" if name.endswith("_mpa") else ""
            q05, median, q95 = (float(row[f"{stem}_{column}{unit}"]) for column in ("q05", "median", "q95"))
            intervals[name] = q05, median, q95
        return PastCalibration(row["calibration_id"], row["created_at"], intervals)


def read_theta_history(lake: Lake, base_version_id: str, campaign_id: str | None, data: str) -> list[PastCalibration]:
    """Read a simulator's calibrations with this kind of data of these measurements that gave a version, oldest first.

    Means and traces of the same grasps say different things of theta, as do calibrations of a search for the gap, each
    with other effects: nothing has drifted between them.
    """
    where = {"base_version_id": base_version_id, "campaign_id": campaign_id, "data": data, "status": "ok"}
    return [PastCalibration.of(row) for row in lake.rows(CalibrationRow, **where) if row["sampler"] != WITH_EFFECTS]


def find_drift(history: Sequence[PastCalibration], summary: Mapping[str, ParameterSummary]) -> tuple[str, ...]:
    """Find each parameter whose 90 % interval excludes the last calibration's median: a sentence for each."""
    if not history:
        return ()
    last = history[-1]
    sentences = []
    for name, (words, unit) in _WORDS.items():
        median, new = last.intervals[name][1], summary[name]
        if not new.q05 <= median <= new.q95:
            sentences.append(
                f"{words} has drifted: {median:.3g}{unit} on {last.made_at:%Y-%m-%d} ({last.calibration_id}), now "
                f"{new.median:.3g}{unit} with 90 % interval {new.q05:.3g} to {new.q95:.3g}; look for another lot of "
                "material or a change of the bench."
            )
    return tuple(sentences)

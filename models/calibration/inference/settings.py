"""Priors and sampler settings of a calibration."""

import json
import math
from typing import Literal

import numpy as np
from pydantic import Field

from fast.models.records import Record

_LN_PA_PER_MPA = math.log(1e6)
# Method of a result: theta and the effects that gap discovery named, inferred together.
WITH_EFFECTS = "trace with effects"


class ThetaPriors(Record):
    """Table 3 of the paper, as printed; the modulus in ln MPa instead of ln Pa.

    The printed log-normal (16.138 in ln Pa) has its median at 10.2 MPa and its mode at 3.75 MPa; the paper's text
    calls 10.2 MPa the mode.
    """

    young_modulus_median_mpa: float = Field(default=math.exp(16.138 - _LN_PA_PER_MPA), gt=0)
    young_modulus_log_sd: float = Field(default=1.0, gt=0, le=5, description="standard deviation of ln E")
    friction_shape: float = Field(default=6.6, gt=0, description="alpha of the gamma distribution")
    friction_rate: float = Field(default=10.0, gt=0, description="beta of the gamma distribution")
    poisson_ratio_lower: float = Field(default=0.2, ge=0, lt=0.5)
    poisson_ratio_upper: float = Field(default=0.5, gt=0, le=0.5)

    @property
    def young_modulus_mode_mpa(self) -> float:
        """Mode of the log-normal."""
        return self.young_modulus_median_mpa * math.exp(-(self.young_modulus_log_sd**2))

    def draw(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta, n x 3: young_modulus_mpa, friction, poisson_ratio."""
        modulus_mpa = self.young_modulus_median_mpa * np.exp(self.young_modulus_log_sd * rng.standard_normal(n))
        friction = rng.gamma(self.friction_shape, 1.0 / self.friction_rate, n)
        return np.column_stack(
            [modulus_mpa, friction, rng.uniform(self.poisson_ratio_lower, self.poisson_ratio_upper, n)]
        )

    def quantile(self, shares: np.ndarray) -> np.ndarray:
        """Return theta (... x 3) with prior probabilities `shares` (... x 3) below it."""
        from scipy.special import gammaincinv, ndtri  # not with the settings, which every command reads

        modulus, friction, poisson_ratio = np.moveaxis(np.asarray(shares), -1, 0)
        width = self.poisson_ratio_upper - self.poisson_ratio_lower
        values = [
            self.young_modulus_median_mpa * np.exp(self.young_modulus_log_sd * ndtri(modulus)),
            gammaincinv(self.friction_shape, friction) / self.friction_rate,
            self.poisson_ratio_lower + width * poisson_ratio,
        ]
        return np.stack(values, axis=-1)


class CalibrationSettings(Record):
    """How theta is inferred. The defaults of chains, draws and tune are the paper's."""

    priors: ThetaPriors = ThetaPriors()
    """Of theta."""
    rho: Literal["fixed", "free"] = Field(
        default="fixed", description="scale between simulation and measurement: 1, or a parameter with prior N(1, 0.1)"
    )
    method: Literal["auto", "factorised", "joint"] = Field(
        default="auto", description="auto: factorised, checked by k-hat; where that fails, joint for small problems"
    )
    print_scatter: float = Field(
        default=0.0,
        ge=0,
        le=0.5,
        description="relative sd of stiffness between prints, of means; the paper: 0, equal noise for all",
    )
    chains: int = Field(default=8, ge=2, le=64)
    """Of NUTS."""
    draws: int = Field(default=8000, ge=50, le=1_000_000, description="kept per chain")
    tune: int = Field(default=8000, ge=50, le=1_000_000, description="dropped per chain")
    target_accept: float = Field(default=0.9, ge=0.5, lt=1)
    """Share of steps that NUTS aims to take."""
    seed: int = Field(default=0, ge=0)
    """Of the chains."""
    workers: int = Field(default=2, ge=1, le=64, description="processes; changes no result")

    def at_most(self, draws: int, tune: int) -> "CalibrationSettings":
        """Return the same with at most so many draws kept and dropped per chain."""
        return self.model_copy(update={"draws": min(self.draws, draws), "tune": min(self.tune, tune)})


def read_settings(settings_json: str) -> CalibrationSettings:
    """Read settings as a stored calibration has them, except `method`: other program versions knew other methods.

    Which one made the draws is the column `sampler`. Fields that are unknown today are left out.
    """
    stored = json.loads(settings_json)
    known = CalibrationSettings.model_fields.keys() - {"method"}
    return CalibrationSettings(**{name: stored[name] for name in known if name in stored})

"""Row records of what was inferred: calibrations with their posterior draws, effects, findings about the gap."""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from fast.lake.tables.row import Channel, Row, Status
from fast.models.ids import content_id
from fast.models.units import unit_of


class CalibrationRow(Row):
    """One inference of theta: what went in, Table 2 of the paper, and whether the sampler can be trusted.

    Every other inferred parameter (rho, lengthscales, noise, effects) is in `posterior_draws`.
    """

    table: ClassVar[str] = "calibrations"
    calibration_id: str
    """Of what went in."""
    campaign_id: str | None = Field(default=None, description="empty: all measurements of the lake")
    base_version_id: str = Field(description="simulator version that made the simulations")
    version_id: str | None = Field(default=None, description="simulator version with the theta found here")
    data: Literal["design_mean", "object_mean", "trace"] = Field(description="what was compared with measurements")
    status: Status
    """Failed: no simulator may be built on it."""
    reason: str = ""
    """Why it failed."""
    n_designs: int = Field(description="measured designs")
    n_objects: int
    """That they met."""
    n_simulations: int
    """Designs; grasps where `data` is trace."""
    n_chains: int
    """Of the sampler."""
    n_draws: int = Field(description="kept per chain")
    n_tune: int = Field(description="dropped per chain")
    sampler: str
    """The algorithm."""
    settings_json: str = Field(default="{}", description="priors, ranges and options")
    young_modulus_mean_mpa: float | None = None
    """Mean of the posterior of Young's modulus."""
    young_modulus_sd_mpa: float | None = None
    """Standard deviation of the posterior of Young's modulus."""
    young_modulus_q05_mpa: float | None = None
    """5 % quantile of the posterior of Young's modulus."""
    young_modulus_median_mpa: float | None = None
    """Median of the posterior of Young's modulus."""
    young_modulus_q95_mpa: float | None = None
    """95 % quantile of the posterior of Young's modulus."""
    young_modulus_mode_mpa: float | None = None
    """Mode of the posterior of Young's modulus."""
    friction_mean: float | None = None
    """Mean of the posterior of friction."""
    friction_sd: float | None = None
    """Standard deviation of the posterior of friction."""
    friction_q05: float | None = None
    """5 % quantile of the posterior of friction."""
    friction_median: float | None = None
    """Median of the posterior of friction."""
    friction_q95: float | None = None
    """95 % quantile of the posterior of friction."""
    friction_mode: float | None = None
    """Mode of the posterior of friction."""
    poisson_ratio_mean: float | None = None
    """Mean of the posterior of the Poisson ratio."""
    poisson_ratio_sd: float | None = None
    """Standard deviation of the posterior of the Poisson ratio."""
    poisson_ratio_q05: float | None = None
    """5 % quantile of the posterior of the Poisson ratio."""
    poisson_ratio_median: float | None = None
    """Median of the posterior of the Poisson ratio."""
    poisson_ratio_q95: float | None = None
    """95 % quantile of the posterior of the Poisson ratio."""
    poisson_ratio_mode: float | None = None
    """Mode of the posterior of the Poisson ratio."""
    noise_sd_n: float | None = Field(default=None, description="posterior median of the measurement noise")
    r_hat_max: float | None = Field(default=None, description="largest R-hat of theta")
    ess_bulk_min: float | None = Field(default=None, description="smallest bulk effective sample size of theta")
    n_divergences: int | None = None
    """After tuning."""
    k_hat: float | None = Field(default=None, description="Pareto k of the importance weights")
    correlation_before: float | None = Field(default=None, description="simulated against measured, held-out designs")
    correlation_after: float | None = Field(default=None, description="simulated against measured, held-out designs")
    rmse_before_n: float | None = Field(default=None, description="held-out designs")
    rmse_after_n: float | None = Field(default=None, description="held-out designs")
    n_held_out: int | None = Field(default=None, description="measured designs that were not learned from")
    held_out_by: Literal["emulator", "simulator"] | None = Field(
        default=None, description="what predicted the held-out designs"
    )
    warnings: tuple[str, ...] = Field(default=(), description="sentences on what is doubtful")
    cpu_s: float = 0.0
    """Of all processes."""

    @staticmethod
    def make_id(base_version_id: str, data: str, data_ids: list[str], settings_json: str, seed: int) -> str:
        """Make an id from what decides the result; `data_ids` are the grasps and simulations that went in."""
        return content_id("C", [base_version_id, data, sorted(data_ids), settings_json, seed])


class PosteriorDrawsRow(Row):
    """All draws of one parameter in one chain; draw k of each parameter of a chain is one joint draw.

    One row per parameter and chain, so that 29 parameters x 64,000 draws are 232 rows, and a new parameter is
    no new column. A parameter of an effect is named `<effect>.<parameter>`.
    """

    table: ClassVar[str] = "posterior_draws"
    draws_id: str
    calibration_id: str
    chain: int = Field(ge=0)
    parameter: str = Field(description="its unit is the suffix of its name")
    unit: str | None = Field(default=None, description="unit of the draws")
    draws: Channel

    @classmethod
    def of(cls, calibration_id: str, chain: int, parameter: str, draws: np.ndarray) -> Self:
        """Make the row of the draws (n) of one parameter in one chain."""
        return cls(
            draws_id=content_id("Q", [calibration_id, chain, parameter]),
            calibration_id=calibration_id,
            chain=chain,
            parameter=parameter,
            unit=unit_of(parameter),
            draws=draws,
        )


class EffectRow(Row):
    """One effect of a simulator version; `lake.tables.catalogue_rows` makes them with the version's own row."""

    table: ClassVar[str] = "effects"
    effect_id: str
    """Of version and place."""
    version_id: str
    """The simulator."""
    place: int = Field(ge=0, description="order in the version; effects act layer by layer, within one in this order")
    effect: str
    """Its name in the catalogue."""
    title: str
    """In words."""
    code: str = Field(description="row in the catalogue of effects")
    layer: str
    """Where it acts."""
    effect_version: int
    """Of its law."""
    parameters: tuple[str, ...] = Field(description="names; the unit is the suffix")
    parameter_values: tuple[float, ...] = Field(description="in the order of `parameters`")

    @staticmethod
    def make_id(version_id: str, place: int, effect: str) -> str:
        """Make an id from which effect of which version it is."""
        return content_id("X", [version_id, place, effect])


class GapFindingRow(Row):
    """One line of what `fast gap` found; `gap_id` is one run of it, and rounds count from 1.

    kind `where`: a place of disagreement, with `sentence`, `phase`, `stratum`, `size_n`.
    kind `candidate`: an effect that was tried, with its probability and what it gains on held-out data.
    kind `named`: the answer of the round. A set is one row per effect with the probability of the set; `none`
    and `unknown` are one row without effect. It also holds the gap before and after.
    """

    table: ClassVar[str] = "gap_findings"
    finding_id: str
    """Of search, round, kind and rank."""
    gap_id: str
    """The search."""
    campaign_id: str | None = Field(default=None, description="empty: all measurements of the lake")
    round: int = Field(ge=1)
    """From 1."""
    kind: Literal["where", "candidate", "named"]
    """What the row is."""
    place: int = Field(ge=0, description="rank within round and kind, best first")
    sentence: str = ""
    """In words."""
    phase: str | None = Field(default=None, description="part of the grasp")
    stratum: str | None = Field(default=None, description="which tools, objects, repeats")
    size_n: float | None = Field(default=None, description="measured minus simulated")
    ci90_lower_n: float | None = None
    """Lower end of its 90 % interval."""
    ci90_upper_n: float | None = None
    """Upper end of its 90 % interval."""
    p_value: float | None = None
    """Of the test behind it."""
    q_value: float | None = Field(default=None, description="false-discovery rate at which it is a finding")
    effect: str | None = None
    """Its name in the catalogue."""
    answer: Literal["effect", "set", "none", "unknown"] | None = None
    """Of the round."""
    probability: float | None = Field(default=None, ge=0, le=1)
    """Of the effect; of the answer."""
    visible_fraction: float | None = Field(default=None, description="left of the signature when theta is refitted")
    evidence_nats: float | None = Field(default=None, description="log of how much more probable it makes the data")
    grouped_r2: float | None = Field(default=None, description="of searches before 0.3, as are the next two")
    held_out_gain_nats: float | None = None
    """What it gained on held-out grasps."""
    held_out_rmse_change: float | None = None
    """What it changed their error by."""
    parameters: tuple[str, ...] = Field(default=(), description="of the effect; the unit is the suffix")
    parameter_values: tuple[float, ...] = Field(default=(), description="posterior medians")
    parameter_ci90_lower: tuple[float, ...] = ()
    """Lower ends of their 90 % intervals."""
    parameter_ci90_upper: tuple[float, ...] = ()
    """Upper ends of their 90 % intervals."""
    rmse_before_n: float | None = Field(default=None, description="of traces, held-out designs and objects")
    rmse_after_n: float | None = Field(default=None, description="of traces, held-out designs and objects")
    rmse_floor_n: float | None = Field(default=None, description="noise and numerical error")
    closed_fraction: float | None = Field(default=None, description="of the gap above the floor")
    closed_ci95_lower: float | None = None
    """Lower end of its 95 % interval."""
    closed_ci95_upper: float | None = None
    """Upper end of its 95 % interval."""
    base_version_id: str = Field(description="simulator version that was compared")
    version_id: str | None = Field(default=None, description="simulator version with what was named")
    calibration_id: str | None = Field(default=None, description="inference of the new version's parameters")

    @staticmethod
    def make_id(gap_id: str, round_number: int, kind: str, place: int) -> str:
        """Make an id from which line of which run it is."""
        return content_id("N", [gap_id, round_number, kind, place])

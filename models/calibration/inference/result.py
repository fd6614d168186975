"""What a calibration found: draws, and whether they can be trusted, with a sentence for every problem."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fast.models.calibration.inference.libraries import quiet_import
from fast.models.calibration.inference.parameter import find_prior, summarise
from fast.models.calibration.inference.settings import CalibrationSettings, ThetaPriors
from fast.models.calibration.means.problem import THETA, CalibrationProblem
from fast.models.errors import UsageError
from fast.models.units import spell_share

R_HAT_LIMIT, ESS_LIMIT, K_HAT_LIMIT = 1.01, 1000.0, 0.7
WEIGHTED = "factorised"  # the method whose draws are as good as their importance weights
EDGE_SHARE, EDGE_LIMIT, OUTSIDE_LIMIT = 0.05, 0.2, 0.05
OVERLAP_LIMIT = 0.85
CORRELATION_LIMIT = 0.7
GRAVITY_N_PER_KG = 9.81
GRAMS_PER_N = 1000.0 / GRAVITY_N_PER_KG
_UNIT_TOLERANCE = 0.4  # of the logarithm: how near a factor counts as suspected
_FAR_SD = 2.0  # prior standard deviations of ln E that call for a suspicion
_WORDS = {"young_modulus_mpa": "Young's modulus", "friction": "friction", "poisson_ratio": "Poisson's ratio"}
_UNITS = {"young_modulus_mpa": " MPa", "friction": "", "poisson_ratio": ""}


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """Posterior draws of every parameter, and diagnostics."""

    names: tuple[str, ...]
    """Of the parameters."""
    draws: np.ndarray
    """Chains x n x len(names), constrained: theta in physical units, `lengthscale_*` in unit-cube lengths, `sd_e_n` and
    `noise_sd_n` in N, `sd_h` and `nugget` standardised."""
    settings: CalibrationSettings
    """What was asked for."""
    method: str
    """The algorithm that made the draws."""
    r_hat: Mapping[str, float]
    """By parameter, rank-normalised (Vehtari et al. 2021)."""
    ess_bulk: Mapping[str, float]
    """Effective draws of the bulk, by parameter."""
    ess_tail: Mapping[str, float]
    """Effective draws of the tails, by parameter."""
    n_divergences: int
    """After tuning."""
    k_hat: float | None = None
    """Pareto k of the importance weights (Vehtari et al. 2024), None where none were tried; with a `method` other than
    "factorised" it is why that one was replaced."""
    warnings: tuple[str, ...] = ()
    """Sentences on what is wrong or doubtful, never hidden."""
    cpu_s: float = 0.0
    """Of all processes."""
    steps: Mapping[str, float] = field(default_factory=dict)
    """CPU seconds by step of the algorithm."""
    n_gradients: int = 0
    """All that NUTS evaluated, tuning included."""

    def of(self, name: str) -> np.ndarray:
        """Return the draws of one parameter, chains x n."""
        return self.draws[:, :, self.names.index(name)]

    def flat(self, *names: str) -> np.ndarray:
        """Return joint draws of some parameters, (chains n) x len(names)."""
        columns = [self.names.index(name) for name in names]
        return self.draws[:, :, columns].reshape(-1, len(columns))


class SamplerCounts(NamedTuple):
    """What NUTS did: divergences and trees cut at their greatest depth after tuning, gradients in all."""

    n_divergences: int = 0
    n_deepest: int = 0
    n_gradients: int = 0


def make_result(
    problem: CalibrationProblem,
    names: tuple[str, ...],
    draws: np.ndarray,
    settings: CalibrationSettings,
    method: str,
    counts: SamplerCounts,
    chains: np.ndarray | None = None,
) -> CalibrationResult:
    """Make a result of constrained draws (chains x n x len(names)), diagnosed.

    chains: c x m x k, what the sampler drew of the last k names, where `draws` are resampled from it by weight. Draws
    that were weighted and drawn again look more alike from chain to chain, so the larger R-hat of both counts.
    """
    r_hat, ess_bulk, ess_tail = measure_convergence(names, draws)
    if chains is not None:
        sampled = names[-chains.shape[2] :]
        raw = measure_convergence(sampled, chains)[0]
        r_hat |= {name: max(r_hat[name], raw[name]) for name in sampled}
    flat = {name: draws[:, :, i].ravel() for i, name in enumerate(names)}
    sentences = [
        *_sampler_sentences(draws.shape[0] * draws.shape[1], settings, counts),
        *_convergence_sentences(r_hat, ess_bulk, ess_tail),
        *_range_sentences(problem, flat),
        *_overlap_sentences(settings.priors, flat),
        *_correlation_sentences(flat),
    ]
    return CalibrationResult(
        names=names,
        draws=draws,
        settings=settings,
        method=method,
        r_hat=r_hat,
        ess_bulk=ess_bulk,
        ess_tail=ess_tail,
        n_divergences=counts.n_divergences,
        warnings=tuple(sentences),
        n_gradients=counts.n_gradients,
    )


def measure_convergence(
    names: Sequence[str], draws: np.ndarray
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Measure rank-normalised R-hat, bulk and tail ESS by name (Vehtari et al. 2021), of chains x n x len(names)."""
    with quiet_import():
        import arviz as az
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        columns = {name: np.ascontiguousarray(draws[:, :, i]) for i, name in enumerate(names)}
        r_hat = {name: float(az.rhat(column)) for name, column in columns.items()}
        ess_bulk = {name: float(az.ess(column, method="bulk")) for name, column in columns.items()}
        ess_tail = {name: float(az.ess(column, method="tail")) for name, column in columns.items()}
    return r_hat, ess_bulk, ess_tail


def _sampler_sentences(n_draws: int, settings: CalibrationSettings, counts: SamplerCounts) -> list[str]:
    n_divergences, n_deepest = counts.n_divergences, counts.n_deepest
    found = []
    if n_divergences:
        found.append(
            f"{n_divergences} of {n_draws} draws diverged: the sampler may have missed a narrow part of the posterior; "
            f"raise target_accept above {settings.target_accept:g}."
        )
    if n_deepest > 0.01 * n_draws:
        found.append(
            f"{n_deepest} of {n_draws} draws used the greatest tree depth: the posterior is long and narrow, draws "
            "are costly and correlated; tune longer."
        )
    return found


def _convergence_sentences(
    r_hat: Mapping[str, float], ess_bulk: Mapping[str, float], ess_tail: Mapping[str, float]
) -> list[str]:
    found = []
    late = sorted((name for name in r_hat if not r_hat[name] < R_HAT_LIMIT), key=lambda name: -r_hat[name])
    if late:
        others = f" and {len(late) - 1} others" if len(late) > 1 else ""
        found.append(
            f"R-hat of {late[0]} is {r_hat[late[0]]:.3f}{others}, above {R_HAT_LIMIT:g}: the chains do not agree yet; "
            "sample longer."
        )
    for kind, sizes in (("bulk", ess_bulk), ("tail", ess_tail)):
        worst = min(THETA, key=lambda name: sizes[name])
        if not sizes[worst] >= ESS_LIMIT:
            found.append(
                f"the {kind} effective sample size of {worst} is {sizes[worst]:.0f}, below {ESS_LIMIT:.0f}; "
                "draw more before quoting intervals to two digits."
            )
    return found


def _range_sentences(problem: CalibrationProblem, flat: Mapping[str, np.ndarray]) -> list[str]:
    """Tell of theta where the emulator has no or few simulations. E is not an emulator input where it is a factor."""
    found = []
    for k, name in enumerate(THETA):
        if name == "young_modulus_mpa" and problem.scales_with_modulus:
            continue
        is_log = name == "young_modulus_mpa"
        draws, sampled = flat[name], problem.theta_sim[:, k]
        position = np.log(draws) if is_log else draws
        lower, upper = (np.log(sampled.min()), np.log(sampled.max())) if is_log else (sampled.min(), sampled.max())
        edge = EDGE_SHARE * (upper - lower)
        outside = float(np.mean((position < lower) | (position > upper)))
        text = f"{sampled.min():.3g} to {sampled.max():.3g}{_UNITS[name]}"
        if outside > OUTSIDE_LIMIT:
            found.append(
                f"{spell_share(outside)} of the posterior of {_WORDS[name]} lies outside the simulated range {text}, "
                "where the emulator extrapolates; simulate a wider range."
            )
        for side, share in (
            ("lower", float(np.mean(position < lower + edge))),
            ("upper", float(np.mean(position > upper - edge))),
        ):
            if share > EDGE_LIMIT:
                found.append(
                    f"{spell_share(share)} of the posterior of {_WORDS[name]} piles up at the {side} end of the "
                    f"simulated range {text}; simulate beyond it, or look for what the model lacks."
                )
    return found


def _overlap_sentences(priors: ThetaPriors, flat: Mapping[str, np.ndarray]) -> list[str]:
    found = []
    for name in THETA:
        common = summarise(flat[name], find_prior(name, priors)).overlap
        if common is not None and common > OVERLAP_LIMIT:
            found.append(
                f"the measurements say little about {_WORDS[name]}: posterior and prior overlap by "
                f"{spell_share(common)}; measure designs that depend on it, or calibrate on traces."
            )
    return found


def _correlation_sentences(flat: Mapping[str, np.ndarray]) -> list[str]:
    logs = {name: np.log(flat[name]) for name in THETA}
    pairs = [(THETA[0], THETA[1], logs[THETA[0]], logs[THETA[1]])]
    if "rho" in flat:
        pairs += [("rho", name, flat["rho"], logs[name]) for name in THETA]
    found = []
    for first, second, a, b in pairs:
        r = float(np.corrcoef(a, b)[0, 1])
        if abs(r) > CORRELATION_LIMIT:
            found.append(
                f"{_WORDS.get(first, first)} and {_WORDS[second]} are correlated by {r:.2f}: the measurements fix "
                "their combination, not each of them; quote them jointly" + (", or fix rho." if first == "rho" else ".")
            )
    return found


def find_unit_warnings(modulus_mpa: float, priors: ThetaPriors) -> list[str]:
    """Tell what a first estimate of Young's modulus far from its prior says about the unit of the forces.

    Raises:
        UsageError: it is off by about a thousand.
    """
    ratio = np.log(modulus_mpa / priors.young_modulus_median_mpa)
    if abs(ratio) < _FAR_SD * priors.young_modulus_log_sd:
        return []
    found = f"Measured forces ask for a Young's modulus of {modulus_mpa:.3g} MPa, the prior says "
    found += f"{priors.young_modulus_median_mpa:.3g}"
    if abs(abs(ratio) - np.log(1000.0)) < np.log(4.0):
        raise UsageError(f"{found}; a factor of about 1000 is suspected in the unit of the forces: give them in N.")
    if abs(abs(ratio) - np.log(GRAVITY_N_PER_KG)) < _UNIT_TOLERANCE:
        return [f"{found}; a factor of 9.81 is suspected: check that forces are in N, not in kg."]
    if abs(ratio - np.log(GRAMS_PER_N)) < _UNIT_TOLERANCE:
        return [f"{found}; a factor of 102 is suspected: check that forces are in N, not in grams."]
    return [f"{found}; check the unit of the forces and the simulator."]

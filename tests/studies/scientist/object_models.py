"""Whether a model per object learns faster than one of the mean, and what objects without a result cost."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fast.models.design.space import numbered_design, to_unit
from fast.models.scientist.acquisition.candidates import Spacing
from fast.models.scientist.acquisition.front import Criterion, select_by_hypervolume
from fast.models.scientist.acquisition.paths import real_paths
from fast.models.scientist.object_surrogate import fit_objects
from fast.models.scientist.propose import NO_PENDING
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.imputation import mean_over_objects
from fast.models.scientist.surrogate.observations import REAL, ObjectValues, ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.models.traces.quality import mean_of_tools
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import Outcome, read_records

FORCES = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "object-forces.json"
SIZES, SHARES, SEED = (10, 20, 40, 80), (0.1, 0.33), 20261124
PRINT_SD, PLACEMENT_SD, NOISE_SD_N = 0.04, 0.05, 0.1  # of a tool on all objects; of a tool on one; of a reading
N_FIRST, N_ROUNDS, PER_ROUND = 10, 8, 3
N_WORLDS = 12

# (points n x 9, forces n x m) -> draws of the forces at other points: (k x 9, number, rng) -> k x m x number
Draw = Callable[[np.ndarray, int, np.random.Generator], np.ndarray]
Model = Callable[[np.ndarray, np.ndarray], Draw]
Quality = Callable[[np.ndarray], np.ndarray]  # forces k x m (x number) -> k (x number)


@dataclass(frozen=True)
class Forces:
    """Simulated peaks of random designs (n x 9, unit cube) on several objects, n x m, N."""

    x: np.ndarray
    peaks_n: np.ndarray

    def measure(self, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Peaks of prints of designs as a bench would give them."""
        true_n = self.peaks_n[rows]
        prints, places = PRINT_SD * rng.normal(size=(len(rows), 1)), PLACEMENT_SD * rng.normal(size=true_n.shape)
        return np.asarray(true_n * np.exp(prints + places) + NOISE_SD_N * rng.normal(size=true_n.shape))


def measure_object_models(options: Options) -> Tables:
    """Surrogates of the mean and per object, and rules for objects without a result; --results: own grasps.

    The stored peaks are of `robustness --designs 240 --objects 2,6,10,14,17,19,22,24,27,28,31,32 --results FILE`.
    """
    forces = _read_forces(options.results)
    n_worlds = options.worlds or N_WORLDS
    return {
        "models": _learning(forces, n_worlds, options.tell),
        "races": _races(forces, n_worlds, options.tell),
        "missing": _missing(forces, n_worlds, options.tell),
    }


def _read_forces(path: Path | None) -> Forces:
    if path is None:
        stored = json.loads(FORCES.read_text())
        return Forces(to_unit([numbered_design(n) for n in stored["designs"]]), np.array(stored["peaks_n"]))
    peaks: dict[int, dict[int, float]] = {}
    for outcome in read_records(path, Outcome, "grasp"):
        if outcome.peak_force_n is not None:
            peaks.setdefault(outcome.design, {})[outcome.object_id] = outcome.peak_force_n
    objects = sorted({object_id for own in peaks.values() for object_id in own})
    numbers = [number for number in sorted(peaks) if len(peaks[number]) == len(objects)]
    peaks_n = np.array([[peaks[number][object_id] for object_id in objects] for number in numbers])
    return Forces(to_unit([numbered_design(number) for number in numbers]), peaks_n)


def model_mean(x: np.ndarray, forces_n: np.ndarray) -> Draw:
    """What the scientist does: one Gaussian process of the logarithm of the mean over the objects."""
    return _draws_of([_fit(x, forces_n.mean(axis=1))])


def model_worst(x: np.ndarray, forces_n: np.ndarray) -> Draw:
    """The same of the object that is held worst."""
    return _draws_of([_fit(x, forces_n.min(axis=1))])


def model_each(x: np.ndarray, forces_n: np.ndarray) -> Draw:
    """One Gaussian process per object."""
    return _draws_of([_fit(x, column) for column in forces_n.T])


def model_components(x: np.ndarray, forces_n: np.ndarray) -> Draw:
    """One Gaussian process per principal component: what the scientist does where single objects count."""
    known = ObjectValues(x, np.full(len(x), REAL), forces_n)
    return fit_objects(known, lambda values: values).draw


MODELS: Mapping[str, Model] = {"mean": model_mean, "per object": model_each, "components": model_components}


def _fit(x: np.ndarray, force_n: np.ndarray) -> Surrogate:
    return fit_surrogate(_observed(x, force_n).in_logs())


def _observed(x: np.ndarray, y: np.ndarray) -> ObservationSet:
    return ObservationSet(x, np.full(len(y), REAL), y, np.zeros(len(y)))


def _draws_of(parts: Sequence[Surrogate]) -> Draw:
    return lambda points, n, rng: np.stack(
        [part.data.force_n(real_paths(part, points, n, rng)) for part in parts], axis=1
    )


def _learning(forces: Forces, n_worlds: int, tell: Callable[[str], None]) -> Rows:
    """Error of the predicted quality at designs that were not measured, against that of one surrogate of it."""
    rows: Rows = []
    qualities: dict[str, tuple[Quality, Model]] = {
        "mean": (lambda n: n.mean(axis=1), model_mean), "worst object": (lambda n: n.min(axis=1), model_worst)
    }  # fmt: skip
    for quality, (over_objects, plain) in qualities.items():
        models = {"mean": plain, **{name: model for name, model in MODELS.items() if name != "mean"}}
        for n in SIZES:
            tell(f"{quality}, {n} tools")
            errors = np.array([_errors(forces, models, over_objects, n, world) for world in range(n_worlds)])
            row: dict[str, object] = {"quality": quality, "tools": n, "one surrogate": float(errors[:, 0].mean())}
            for name, ratios in zip([*models][1:], (errors[:, 1:] / errors[:, :1]).T, strict=True):
                row[name] = _with_interval(ratios)
            rows.append(row)
    return rows


def _errors(forces: Forces, models: Mapping[str, Model], quality: Quality, n: int, world: int) -> list[float]:
    rng = np.random.default_rng([SEED, n, world])
    order = rng.permutation(len(forces.x))
    own, unseen = order[:n], order[n:]
    measured_n, true = forces.measure(own, rng), np.log1p(quality(forces.peaks_n[unseen]))
    errors = []
    for model in models.values():
        drawn = quality(model(forces.x[own], measured_n)(forces.x[unseen], 64, rng))
        errors.append(float(np.sqrt(np.mean((np.median(np.log1p(np.maximum(drawn, 0)), axis=1) - true) ** 2))))
    return errors


def _races(forces: Forces, n_worlds: int, tell: Callable[[str], None]) -> Rows:
    """Mean regret of the expected improvement on joint paths among the stored designs, by each model."""
    regrets = {name: np.zeros(n_worlds) for name in MODELS}
    for world in range(n_worlds):
        tell(f"race {world + 1} of {n_worlds}")
        for name, model in MODELS.items():
            regrets[name][world] = _race(forces, model, world)
    return [
        {"model": name, "mean regret, N": float(found.mean()),
         "less than the mean's, N": _with_interval(regrets["mean"] - found)}
        for name, found in regrets.items()
    ]  # fmt: skip


def _race(forces: Forces, model: Model, world: int) -> float:
    true_n, rng, regret = forces.peaks_n.mean(axis=1), np.random.default_rng([SEED, world]), 0.0
    taken = list(rng.permutation(len(true_n))[:N_FIRST])
    measured_n = forces.measure(np.array(taken), rng)
    for _ in range(N_ROUNDS):
        x = forces.x[taken]
        criterion = Criterion(_mean_of(model(x, measured_n)), is_objective=True)
        spacing = Spacing(x, np.zeros((0, x.shape[1])), 0.0)
        select, model_of_means = select_by_hypervolume([criterion]), _fit(x, measured_n.mean(axis=1))
        chosen = select(model_of_means, forces.x, REAL, PER_ROUND, NO_PENDING, spacing, rng)
        new = [row for row, _ in chosen]
        taken += new
        measured_n = np.concatenate([measured_n, forces.measure(np.array(new), rng)])
        regret += float(true_n.max() - true_n[taken].max()) / N_ROUNDS
    return regret


def _mean_of(draw: Draw) -> Draw:
    return lambda points, n, rng: draw(points, n, rng).mean(axis=1)


def take_paper_means(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The paper's rule (Methods, Bayesian calibration): a gap takes the mean of its object, and its variance."""
    gaps = np.isnan(values)
    filled = np.where(gaps, np.nanmean(values, axis=0), values)
    return filled.mean(axis=1), gaps @ np.nanvar(values, axis=0, ddof=1) / values.shape[1] ** 2


def _missing(forces: Forces, n_worlds: int, tell: Callable[[str], None]) -> Rows:
    """Error of the mean of tools with gaps, coverage of its interval, and error of a surrogate of such means."""
    rules = {"paper": take_paper_means, "from the others": mean_over_objects}
    rows: Rows = []
    for share in SHARES:
        for n in SIZES:
            tell(f"{share:.0%} missing, {n} tools")
            found = np.array([_gaps(forces, rules, share, n, world) for world in range(n_worlds)])
            for (name, *_), own in zip([*rules.items(), ("nothing missing",)], found.transpose(1, 0, 2), strict=True):
                rows.append(
                    {"missing": share, "tools": n, "rule": name, "error of the mean": float(np.nanmean(own[:, 0])),
                     "in the 90 % interval": float(np.nanmean(own[:, 1])),
                     "error at unseen designs": float(own[:, 2].mean())}
                )  # fmt: skip
    return rows


def _gaps(forces: Forces, rules: Mapping[str, Callable], share: float, n: int, world: int) -> list[tuple[float, ...]]:
    rng = np.random.default_rng([SEED, n, world, round(100 * share)])
    order = rng.permutation(len(forces.x))
    own, unseen = order[:n], order[n:]
    whole_n = forces.measure(own, rng)
    holed = np.where(rng.random(whole_n.shape) < share, np.nan, whole_n)
    usable = np.isfinite(holed).any(axis=1)
    x, holed, true_n = forces.x[own][usable], holed[usable], whole_n[usable].mean(axis=1)
    gaps, true_log = np.isnan(holed).any(axis=1), np.log1p(forces.peaks_n[unseen].mean(axis=1))
    results: list[tuple[float, ...]] = []
    for rule in (*(one(holed) for one in rules.values()), (true_n, np.zeros(len(true_n)))):
        y, variance = rule
        off = np.log1p(np.maximum(y, 0)) - np.log1p(true_n)
        held = np.abs(y - true_n) <= 1.645 * np.sqrt(variance)
        surrogate = fit_surrogate(ObservationSet(x, np.full(len(y), REAL), y, variance).in_logs())
        unseen_error = np.sqrt(np.mean((surrogate.mean(forces.x[unseen], REAL) - true_log) ** 2))
        results.append((float(np.sqrt(np.mean(off[gaps] ** 2))), float(held[gaps].mean()), float(unseen_error)))
    return results


def _with_interval(values: np.ndarray) -> str:
    found = mean_of_tools(values)
    return f"{found.mean:.2f} [{found.lower:.2f}, {found.upper:.2f}]"

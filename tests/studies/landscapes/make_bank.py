"""The bank that landscapes are made of: designs simulated under hidden truths, and as a night finds.

Eight truths hide a theta and one to three laws of `flows.challenge.hidden`. The same designs are simulated under each
truth, by the simulator that a campaign believes in, and by the simulator after a night (`landscape_night`).
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import spearmanr

from fast.models.design.space import from_unit, random_unit, to_unit
from fast.models.errors import MeshingFailed, SimulationFailed, UsageError
from fast.models.ids import content_id
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, EffectValue, GraspSetup, Record, Theta
from fast.models.scientist.propose import Room, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import REAL, SIM, ObservationSet
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import build_effects
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import is_usable, step_means
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.grasp_laws.truth import TrueGrasp, hidden_law
from tests.studies.landscapes.bank import (
    BELIEVED,
    EFFECT,
    THETA,
    TRUE,
    DesignSet,
    LandscapeBank,
    Truth,
    mean_peaks,
)
from tests.studies.landscapes.landscape import find_best

if TYPE_CHECKING:
    from tests.studies.landscapes.night import ThetaModel

OBJECTS = (2, 28)
N_RANDOM, N_BELIEVED_ROUNDS, N_PER_ROUND = 120, 4, 25
N_COMMON_RANDOM, N_COMMON_BEST, TRUTH_ROUNDS = 40, 16, (2,)  # proposals a truth and round
N_CHECKS = 5  # times that the best design of every landscape is simulated
KNOWN = 0.03  # unit cube: a best design as near to one that was simulated is known
N_LEFT_OUT = 24  # random designs that are not simulated again with an effect
BELIEF = Theta()
# Theta is interpolated between these; forces are proportional to E.
LOW_FRICTION, HIGH_FRICTION, LOW_RATIO = 0.35, 0.9, 0.33
THETA_NODES = {
    "friction low": Theta(friction=LOW_FRICTION),
    "friction high": Theta(friction=HIGH_FRICTION),
    "ratio low": Theta(poisson_ratio=LOW_RATIO),
}
BIN = 10  # steps of the lift in one number of a fit: 5 mm
DEADLINE_S = 60.0
# From the weakest of the gap study to what the lab world has, or to the strongest of the gap study.
LAWS = {
    "static_kinetic_friction": {"kinetic_ratio": (0.6, 0.9), "slip_scale_mm": (0.8, 3.0)},
    "force_limited_closing": {"max_force_n": (6.0, 18.0)},
    "wall_thickness_offset": {"offset_mm": (0.05, 0.16)},
    "pressure_dependent_friction": {"strength": (0.08, 0.4)},
    "base_compliance": {"compliance_mm_per_n": (0.03, 0.07)},
    "print_anisotropy": {"excess": (0.2, 0.4)},
    "hyperelastic_stiffening": {"stiffening": (10.0, 20.0)},
    "shear_adhesion": {"shear_strength_mpa": (0.0007, 0.004)},
}
MODULI_MPA, FRICTIONS, RATIOS = (6.5, 13.0), (0.38, 0.95), (0.32, 0.47)  # the bulk of the priors
N_TRUTHS, SEED = 8, 23


class Answer(Record):
    """One grasp. No peak: it failed. `bins_n`: mean pull over 5 mm of lift."""

    key: str
    peak_force_n: float | None = None
    bins_n: tuple[float, ...] = ()
    cpu_s: float = 0.0


@dataclass(frozen=True)
class Simulator:
    """What decides a force beside design and object: theta, effects of the catalogue, or laws that a truth hides."""

    theta: Theta
    effects: tuple[EffectValue, ...] = ()
    laws: tuple[EffectValue, ...] = ()
    print_seed: int = 0

    def key(self, design: Design, object_id: int) -> str:
        """Id of one grasp by all that decides it."""
        values = [value.model_dump() for value in (*self.effects, *self.laws)]
        return content_id(
            "U",
            {"theta": self.theta.model_dump(), "values": values, "is_truth": bool(self.laws),
             "print": self.print_seed, "design": design.model_dump(), "object": object_id},
        )  # fmt: skip

    def built(self, object_id: int) -> list[Effect]:
        """Effects and laws, ready for a grasp; a truth prints all its tools alike."""
        grasp = TrueGrasp(theta=self.theta, design=self.print_seed, object_id=object_id)
        laws = [hidden_law(law.effect).build(law.parameters, grasp) for law in self.laws]
        return [*build_effects(self.effects), *laws]


@dataclass
class Grasps:
    """Grasps that are known, and those that are made now, one after the other."""

    options: Options
    file: RecordFile
    known: dict[str, Answer]
    started: float = field(default_factory=time.monotonic)
    n_made: int = 0

    def answer(self, simulator: Simulator, design: Design, object_id: int) -> Answer:
        """A grasp, known or made now.

        Raises:
            UsageError: the time is up; the file keeps what is done.
        """
        key = simulator.key(design, object_id)
        if key not in self.known:
            if time.monotonic() - self.started > 60.0 * self.options.limit_minutes:
                raise UsageError(f"the time is up after {self.n_made} grasps; start again to go on.")
            self.known[key] = _solve(key, simulator, design, object_id)
            self.file.append(self.known[key])
            self.n_made += 1
        return self.known[key]

    def peaks_n(self, simulator: Simulator, x: np.ndarray) -> np.ndarray:
        """Peaks, n x objects, of unit-cube designs; NaN where a grasp failed."""
        rows = [[self.answer(simulator, design, obj).peak_force_n for obj in OBJECTS] for design in from_unit(x)]
        return np.array(rows, dtype=float)

    def bins_n(self, simulator: Simulator, x: np.ndarray) -> np.ndarray:
        """Peak and binned pull, n x objects x 13; NaN where a grasp failed."""
        empty = (np.nan,) * (120 // BIN)
        answers = [[self.answer(simulator, design, obj) for obj in OBJECTS] for design in from_unit(x)]
        return np.array([[(a.peak_force_n or np.nan, *(a.bins_n or empty)) for a in row] for row in answers])

    def tell(self, line: str) -> None:
        """Where the study stands."""
        self.options.tell(f"{(time.monotonic() - self.started) / 60.0:.1f} min, {self.n_made} grasps: {line}")


def _solve(key: str, simulator: Simulator, design: Design, object_id: int) -> Answer:
    from fast.models.simulation.grasp import simulate_grasp  # heavy: compiles on first use

    started = time.process_time()
    try:
        made = simulate_grasp(
            design, get_object(object_id), SimulatorVersion(theta=simulator.theta), GraspSetup(),
            effects=simulator.built(object_id), deadline_s=DEADLINE_S,
        )  # fmt: skip
    except (SimulationFailed, MeshingFailed):
        return Answer(key=key, cpu_s=time.process_time() - started)
    bins = np.round(step_means(made.trace).reshape(-1, BIN).mean(axis=1), 4) if is_usable(made.trace) else ()
    cpu_s = round(time.process_time() - started, 3)
    return Answer(key=key, peak_force_n=round(made.peak_force_n, 4), bins_n=tuple(bins), cpu_s=cpu_s)


def draw_truths(n: int = N_TRUTHS, seed: int = SEED) -> list[Simulator]:
    """Hidden truths: theta over the bulk of the priors, and one, two or three laws, each law about as often."""
    rng = np.random.default_rng(seed)
    counts = [1 + number % 3 for number in range(n)]
    deck: list[str] = []
    while len(deck) < sum(counts):
        deck += [str(name) for name in rng.permutation(list(LAWS))]
    truths = []
    for number, count in enumerate(counts):
        modulus, friction, ratio = (round(float(rng.uniform(*ends)), 3) for ends in (MODULI_MPA, FRICTIONS, RATIOS))
        names = list(dict.fromkeys(deck))[:count]
        for name in names:
            deck.remove(name)
        laws = [
            EffectValue(
                effect=name, parameters={k: round(float(rng.uniform(*ends)), 5) for k, ends in LAWS[name].items()}
            )
            for name in names
        ]
        theta = Theta(young_modulus_mpa=modulus, friction=friction, poisson_ratio=ratio)
        truths.append(Simulator(theta, laws=tuple(laws), print_seed=number))
    return truths


def believed_designs(grasps: Grasps) -> np.ndarray:
    """Designs of the believed simulator: random ones, and rounds of an optimiser on it, n x 9."""
    rng = np.random.default_rng([SEED, 1])
    x = to_unit(from_unit(random_unit(N_RANDOM, rng)))
    for number in range(N_BELIEVED_ROUNDS):
        y = grasps.peaks_n(Simulator(BELIEF), x).mean(axis=1)
        grasps.tell(f"believed simulator, round {number}: best {np.nanmax(y):.1f} N of {len(y)}")
        usable = np.isfinite(y)
        data = ObservationSet(x[usable], np.full(usable.sum(), REAL), y[usable], np.zeros(usable.sum()))
        x = np.concatenate([x, best_of(data, x, N_PER_ROUND, rng)])
    return x


def best_of(data: ObservationSet, taken: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Designs that should improve most on the real results of `data`, n x 9, none of `taken`."""
    pending = np.zeros((0, 10))
    found = propose(fit_surrogate(data), REAL, n, pending, rng, Rule("ei"), Room(taken=taken, min_distance=0.1))
    return to_unit([proposal.design for proposal in found])


def common_designs(grasps: Grasps, believed_x: np.ndarray, truths: Sequence[Simulator]) -> np.ndarray:
    """Designs that every truth is simulated with: random ones, best ones of the belief, and best ones of the truths."""
    rng = np.random.default_rng([SEED, 2])
    believed_n = grasps.peaks_n(Simulator(BELIEF), believed_x).mean(axis=1)
    order = [row for row in np.argsort(-np.nan_to_num(believed_n)) if row >= N_COMMON_RANDOM]
    x = np.concatenate([believed_x[:N_COMMON_RANDOM], _apart(believed_x[order], N_COMMON_BEST)])
    for n in TRUTH_ROUNDS:
        grasps.tell(f"truths with {len(x)} designs")
        new: list[np.ndarray] = []
        for truth in truths:
            y = grasps.peaks_n(truth, x).mean(axis=1)
            grasps.tell(f"{[law.effect for law in truth.laws]}: best {np.nanmax(y):.1f} N")
            data = two_fidelities(believed_x, believed_n, x, y)
            new.append(best_of(data, np.concatenate([x, *new]), n, rng))
        x = np.concatenate([x, *new])
    return _with_optima(grasps, believed_x, believed_n, x, truths)


def _with_optima(
    grasps: Grasps, believed_x: np.ndarray, believed_n: np.ndarray, x: np.ndarray, truths: Sequence[Simulator]
) -> np.ndarray:
    """The designs x, and where interpolation has its largest force, until that is where a simulation was made.

    Else the optimum that strategies are held against would be one of the interpolation, which no simulator knows of.
    """
    rng = np.random.default_rng([SEED, 3])
    starts = np.concatenate([believed_x, random_unit(20_000, rng)])
    for number in range(N_CHECKS):
        new: list[np.ndarray] = []
        for truth in truths:
            y = grasps.peaks_n(truth, x).mean(axis=1)
            data = two_fidelities(believed_x, believed_n, x, y)
            surrogate = fit_surrogate(replace(data, y=np.log(data.y)))  # as a landscape is
            best = to_unit(from_unit(find_best(partial(surrogate.mean, s=REAL), starts, rng)[None]))
            top_n = float(np.exp(surrogate.mean(best, REAL))[0])
            grasps.tell(f"check {number}, {[law.effect for law in truth.laws]}: {top_n:.1f} of {np.nanmax(y):.1f} N")
            if np.linalg.norm(np.concatenate([x, *new]) - best, axis=1).min() > KNOWN:
                new.append(best)
        if not new:
            break
        x = np.concatenate([x, *new])
    return x


def two_fidelities(believed_x: np.ndarray, believed_n: np.ndarray, x: np.ndarray, y: np.ndarray) -> ObservationSet:
    """Results of the believed simulator as simulated, those of another one as real; failed ones left out."""
    all_x, all_y = np.concatenate([believed_x, x]), np.concatenate([believed_n, y])
    s = np.repeat([SIM, REAL], [len(believed_x), len(x)])
    usable = np.nan_to_num(all_y) > 0.0
    return ObservationSet(all_x[usable], s[usable], all_y[usable], np.zeros(usable.sum()))


def _apart(x: np.ndarray, n: int, least: float = 0.25) -> np.ndarray:
    """The first n of points that keep a distance from each other."""
    kept: list[np.ndarray] = []
    for point in x:
        if len(kept) < n and all(np.linalg.norm(point - other) >= least for other in kept):
            kept.append(point)
    return np.array(kept)


def measure_landscape_bank(options: Options) -> Tables:
    """Bank of landscapes under hidden truths: half an hour of a core, continued from its file.

    Raises:
        UsageError: no `--results`, or the time is up.
    """
    if options.results is None:
        raise UsageError("give --results, a JSON-lines file that keeps every grasp.")
    known = {answer.key: answer for answer in read_records(options.results, Answer, "grasp of the bank")}
    with RecordFile(options.results) as file:
        bank = _make_bank(Grasps(options, file, known))
    options.results.with_suffix(".bank.json").write_text(bank.model_dump_json() + "\n")
    return {"truths": [_row(bank, truth) for truth in bank.truths]}


def _make_bank(grasps: Grasps) -> LandscapeBank:
    from tests.studies.landscapes.night import theta_model

    truths = draw_truths()
    believed_x = believed_designs(grasps)
    x = common_designs(grasps, believed_x, truths)
    for truth in truths:
        grasps.peaks_n(truth, x)
        grasps.tell(f"{[law.effect for law in truth.laws]} at all {len(x)} designs")
    model = theta_model(grasps, x)
    everything = np.concatenate([x, _without(believed_x, x)])
    believed = DesignSet.of(everything, grasps.peaks_n(Simulator(BELIEF), everything))
    stored = [_truth(grasps, model, x, number, truth) for number, truth in enumerate(truths)]
    return LandscapeBank(objects=OBJECTS, believed=believed, n_common=len(x), truths=tuple(stored))


def _truth(grasps: Grasps, model: "ThetaModel", x: np.ndarray, number: int, truth: Simulator) -> Truth:
    """A truth, and the simulator after its night, at the common designs."""
    from tests.studies.landscapes.night import Night

    laws = tuple(law.effect for law in truth.laws)
    night = Night(grasps, model, truth, x, laws, number)
    theta, found = night.fit_theta(), night.fit_effects()
    grasps.tell(f"truth {number}: {laws}: {theta}, {found}")
    sets = {TRUE: grasps.peaks_n(truth, x), THETA: model.peaks_n(theta)}
    sets[EFFECT] = sets[THETA]
    if found.effects:
        # Where forces are high an emulator of the new simulator has to be right: most random designs are left out.
        left_out = np.full((N_LEFT_OUT, len(OBJECTS)), np.nan)
        sets[EFFECT] = np.concatenate([left_out, grasps.peaks_n(found, x[N_LEFT_OUT:])])
    return Truth(
        name=f"truth {number}",
        theta=truth.theta,
        laws=truth.laws,
        theta_only=theta,
        theta_found=found.theta,
        found=found.effects,
        sets={name: mean_peaks(peaks_n) for name, peaks_n in sets.items()},
    )


def _without(x: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Points of x that are none of the others."""
    return np.array([point for point in x if np.abs(others - point).max(axis=1).min() > 1e-9])


def _row(bank: LandscapeBank, truth: Truth) -> dict[str, object]:
    """What a truth hides, what was found, and how alike the mean peaks are."""
    sets = {name: np.array(values, dtype=float) for name, values in truth.sets.items()}
    sets[BELIEVED] = bank.believed.y[: bank.n_common]
    usable = np.isfinite(np.array(list(sets.values()))).all(axis=0)
    true_n = sets.pop(TRUE)[usable]
    row: dict[str, object] = {
        "truth": truth.name,
        "laws": ", ".join(law.effect for law in truth.laws),
        "found": ", ".join(effect.effect for effect in truth.found),
        "best_n": float(true_n.max()),
    }
    for name, values in sets.items():
        scale = values[usable] @ true_n / (values[usable] @ values[usable])
        row[f"{name}: rank"] = float(spearmanr(values[usable], true_n).statistic)
        row[f"{name}: error"] = float(np.std(scale * values[usable] - true_n) / np.std(true_n))
    return row

"""How often intervals hold: worlds in which the truth has the catalogue's own law, with values drawn from its priors.

Naming is judged by laws that are not the catalogue's, of which a parameter has no true value. Here each effect acts on
true grasps, of another mesh and contact, just as the catalogue says. Then its parameters are inferred as a search does
once it knows the name, by NUTS: in the wide bank, or in one around the fitted theta if workers are given.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fast.flows.challenge.grade import clopper_pearson
from fast.flows.challenge.hidden.lab import Variants
from fast.flows.challenge.hidden.lab_laws import LabLaw, Moment, lift_on, tool_draws
from fast.flows.challenge.hidden.panels import MODULUS_MPA, RESPONDING, TOOL_MODULUS_SD, raw_strength
from fast.flows.challenge.hidden.worlds import WorldKey, Worlds
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.calibration.means.problem import THETA
from fast.models.errors import SimulationFailed
from fast.models.gap.data import GapData
from fast.models.ids import seed_from
from fast.models.records import EffectValue, Record, Theta, Trace
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.answers import measure_held_out_n, naming_code
from tests.studies.gap.development import open_panels
from tests.studies.gap.grasp_laws.truth import TrueGrasp
from tests.studies.gap.grasp_laws.truth import _solve as solve_with
from tests.studies.gap.local_banks import LocalBanks
from tests.studies.gap.truth import results_folder

PUBLIC_SEED = "intervals"
N_WORLDS = 46  # two of each effect
STRENGTHS = (0.02, 0.2)  # of the effect, as the bank expects: what is seen, and no more than is plausible
_TRIES = 200
_LEAST_SOLVED = 0.9  # of the cells
_HAS_MEMORY = ("friction_wear", "pressure_droop")  # they act through sets of true grasps that one base has
_ANY = Theta(young_modulus_mpa=10.0, friction=0.5, poisson_ratio=0.4)
_LEVELS = (0.05, 0.5, 0.95)
_LEAST_GAIN = 0.05  # of the held-out error: less than that leaves no gap to speak of


class IntervalOutcome(Record):
    """A world of the catalogue's own law, and what was inferred of it.

    truth: theta and `<effect>.<parameter>`. intervals: low, median and high of each, by the same names; empty if the
    effect explained nothing. before_n, after_n, twin_n: held-out errors without the effect, with the medians, and in
    the same world without it.
    """

    number: int
    effect: str
    base: str
    code: str
    strength: float
    truth: dict[str, float]
    intervals: dict[str, tuple[float, float, float]] = {}
    before_n: float = 0.0
    after_n: float = 0.0
    twin_n: float = 0.0
    warnings: tuple[str, ...] = ()
    cpu_s: float = 0.0

    def holds(self, name: str) -> bool:
        """Whether the interval of a parameter holds its true value."""
        low, _, high = self.intervals[name]
        return low <= self.truth[name] <= high


class OwnLaw(LabLaw):
    """An effect of the catalogue that acts on true traces just as the catalogue says."""

    def __init__(self, value: EffectValue) -> None:
        super().__init__(1.0)
        self.effect = build_effect(value)

    def modulus_factor(self, moment: Moment) -> float:
        """Factor on the modulus in this grasp."""
        return self._at(moment).modify_theta(_ANY, moment.design).young_modulus_mpa / _ANY.young_modulus_mpa

    def friction_factor(self, moment: Moment) -> float:
        """Factor on the friction coefficient in this grasp."""
        nothing = np.zeros(1)
        return float(np.ravel(self._at(moment).friction_factor(nothing, nothing))[0])

    def wider_mm(self, moment: Moment) -> float:
        """How much earlier each jaw stops in this grasp, mm."""
        setup = self._at(moment).modify_setup(moment.setup, moment.design)
        return 0.5 * (setup.closed_gap_mm - moment.setup.closed_gap_mm)

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """What the load cell reports of a true trace."""
        time_s, lift_mm = lift_on(trace)
        longer = Trace(time_s, lift_mm, np.interp(time_s, trace.time_s, trace.force_n))
        return self._at(moment).modify_trace(longer)

    def _at(self, moment: Moment) -> Effect:
        return self.effect.in_grasp(moment.design, moment.setup, moment.context)


def build_effect(value: EffectValue) -> Effect:
    """The effect of the catalogue with these parameters."""
    spec = CATALOGUE[value.effect]
    return spec.kind(**(spec.neutral.parameters | value.parameters))


@dataclass(frozen=True, eq=False)
class OwnWorld:
    """A world in which `value` acts. worlds: of the panel it is made from; key: of the world without it."""

    worlds: Worlds
    key: WorldKey
    value: EffectValue
    strength: float

    @property
    def theta(self) -> np.ndarray:
        """The true theta, 3."""
        return np.array([MODULUS_MPA, *self.worlds.panels.sets[self.key.base].theta])

    @property
    def truth(self) -> dict[str, float]:
        """True values by the names of the posterior."""
        known = dict(zip(THETA, self.theta.tolist(), strict=True))
        return known | {f"{self.value.effect}.{name}": x for name, x in self.value.parameters.items()}

    @cached_property
    def problem(self) -> GapData:
        """The gap problem of this world, of true grasps that are solved now if the effect acts in them."""
        lab, panels = self.worlds.lab(self.key), self.worlds.of(self.key).panels
        if not CATALOGUE[self.value.effect].bank_runs:
            traces = lab.measure(panels.truth(self.key.base, 1.0), [OwnLaw(self.value)])
        else:
            cells = self._solve_cells()
            traces = lab.measure(lambda tool, obj: cells.get((tool, obj)), (), is_scaled=self._scales)
        return self.worlds.make_problem(self.key, traces)

    @property
    def _scales(self) -> bool:
        return CATALOGUE[self.value.effect].kind.scales_with_modulus

    def _solve_cells(self) -> dict[tuple[int, int], Variants]:
        found, (modulus_mpa, friction, ratio) = {}, self.theta
        panels = self.worlds.of(self.key).panels
        for tool, design in enumerate(panels.designs):
            draw = tool_draws(seed_from("true tool", design), 0xE, 1)[0]
            print_factor = 1.0 if self._scales else float(np.exp(TOOL_MODULUS_SD * draw))
            theta = Theta(young_modulus_mpa=modulus_mpa * print_factor, friction=friction, poisson_ratio=ratio)
            for obj, object_id in enumerate(panels.objects):
                try:
                    grasp = TrueGrasp(theta=theta, design=design, object_id=object_id)
                    found[tool, obj] = Variants(solve_with(grasp, [build_effect(self.value)]).trace)
                except SimulationFailed:
                    continue
        return found


def draw_world(worlds: Worlds, number: int) -> OwnWorld | None:
    """A world, always the same for a number; None if no value that is plausible is seen."""
    rng = np.random.default_rng(seed_from("interval world", PUBLIC_SEED, number))
    key = worlds.draw("null", int(rng.integers(2**31))).model_copy(update={"young_modulus_mpa": MODULUS_MPA})
    names = [name for name in CATALOGUE if name in worlds.bank.effects or not CATALOGUE[name].bank_runs]
    training = worlds.problem(key).training
    names = [name for name in names if name in training.names]
    effect = names[number % len(names)]
    if effect in _HAS_MEMORY:
        key = key.model_copy(update={"base": RESPONDING})
    theta = np.array([MODULUS_MPA, *worlds.panels.sets[key.base].theta])
    force_n = training.predict_steps(theta, ())
    for _ in range(_TRIES):
        value = draw_value(effect, rng)
        strength = raw_strength(training.predict_steps(theta, (value,)) - force_n, force_n)
        if STRENGTHS[0] <= strength <= STRENGTHS[1]:
            return OwnWorld(worlds, key, value, round(strength, 4))
    return None


def draw_value(effect: str, rng: np.random.Generator) -> EffectValue:
    """Parameters of an effect from the catalogue's priors: normal, within their bounds."""
    values = {}
    for parameter in CATALOGUE[effect].parameters:
        value = np.inf
        while not parameter.lower <= value <= parameter.upper:
            value = rng.normal(parameter.prior_median, parameter.prior_sd)
        values[parameter.name] = float(f"{value:.4g}")
    return EffectValue(effect=effect, parameters=values)


def infer(world: OwnWorld, banks: LocalBanks | None, settings: CalibrationSettings) -> IntervalOutcome:
    """What a search would say of the effect's parameters, given its name."""
    from fast.models.gap.fit.posterior import effects_at, sample_posterior
    from fast.models.gap.fit.recalibrate import recalibrate
    from fast.models.gap.naming.name import name_effect
    from tests.synthetic.rehearsal import USUAL

    started, effect = time.process_time(), world.value.effect
    outcome = IntervalOutcome(
        number=world.key.number,
        effect=effect,
        base=world.key.base,
        code=naming_code(),
        strength=world.strength,
        truth=world.truth,
    )
    data = world.problem
    found = name_effect(data, USUAL, catalogue=[effect])
    if not found.values:
        return outcome
    if banks is not None:
        found, data, _ = banks.name(data, (), USUAL, [effect])
    fit = recalibrate(data.training, found.values)
    result = sample_posterior(fit, settings)
    quantiles = np.quantile(result.draws.reshape(-1, len(result.names)), _LEVELS, axis=0)
    theta, effects = quantiles[1][:3], effects_at(result.names, quantiles[1].tolist())
    twin, without = world.worlds.problem(world.key), found.fit
    twin_fit = recalibrate(twin.training)
    return outcome.model_copy(
        update={
            "intervals": {name: tuple(row) for name, row in zip(result.names, quantiles.T.tolist(), strict=True)},
            "before_n": measure_held_out_n(data, without.theta, (), without.tool_factor),
            "after_n": measure_held_out_n(data, theta, effects, fit.tool_factor),
            "twin_n": measure_held_out_n(twin, twin_fit.theta, (), twin_fit.tool_factor),
            "warnings": result.warnings,
            "cpu_s": round(time.process_time() - started, 1),
        }
    )


def measure_gap_intervals(options: Options) -> Tables:
    """How often 90 % intervals of an effect's parameters hold, for the catalogue's own laws in true grasps."""
    folder, end = results_folder(options), time.monotonic() + 60.0 * options.limit_minutes
    worlds = Worlds(*open_panels(folder), PUBLIC_SEED)
    banks = None if options.workers is None else LocalBanks.of(folder, options.workers)
    records = read_records(options.results, IntervalOutcome, "world of the catalogue's own law")
    known = {one.number: one for one in records if one.code == naming_code()}
    settings = CalibrationSettings(chains=2, draws=500, tune=500, workers=1, target_accept=0.9)
    with RecordFile(options.results) as file:
        for number in range(options.worlds or N_WORLDS):
            if number in known:
                continue
            if time.monotonic() > end:
                break
            world = draw_world(worlds, number)
            if world is None:
                continue
            outcome = infer(world, banks, settings).model_copy(update={"number": number})
            known[number] = outcome
            file.append(outcome)
            options.tell(_line(outcome))
    return interval_tables(list(known.values()))


def interval_tables(outcomes: Sequence[IntervalOutcome]) -> Tables:
    """How often intervals hold, in all and by effect, and how much of the gap the medians close."""
    inferred = [one for one in outcomes if one.intervals]
    of_effects = [(one, name) for one in inferred for name in one.intervals if "." in name]
    rows = [
        _count("parameters of effects", of_effects),
        *(_count(name, [(one, name) for one in inferred]) for name in THETA),
    ]
    by_effect = [
        _count(effect, [pair for pair in of_effects if pair[0].effect == effect])
        for effect in dict.fromkeys(one.effect for one in outcomes)
    ]
    return {"intervals of 90 %": rows, "by effect": by_effect, "gap closed": _closed(inferred)}


def _count(what: str, pairs: Sequence[tuple[IntervalOutcome, str]]) -> dict[str, object]:
    k, n = sum(one.holds(name) for one, name in pairs), len(pairs)
    row: dict[str, object] = {"intervals of": what, "number": n, "hold": k}
    if n:
        low, high = clopper_pearson(k, n)
        row |= {"value": k / n, "low95": round(low, 3), "high95": round(high, 3)}
    return row


def _closed(outcomes: Sequence[IntervalOutcome]) -> Rows:
    def share(one: IntervalOutcome) -> float:
        return (one.before_n - one.after_n) / (one.before_n - one.twin_n)

    shares = [share(one) for one in outcomes if one.before_n - one.twin_n > _LEAST_GAIN * one.before_n]
    if not shares:
        return []
    return [{"worlds": len(shares), "median": np.median(shares), "worst quarter": np.quantile(shares, 0.25)}]


def _line(one: IntervalOutcome) -> str:
    said = [
        f"{name.partition('.')[2]} {one.truth[name]:.3g} in [{low:.3g}, {high:.3g}]{'' if one.holds(name) else ' NO'}"
        for name, (low, _, high) in one.intervals.items()
        if "." in name
    ]
    return f"{one.number}: {one.effect} {100 * one.strength:.1f} % -> {', '.join(said) or 'nothing'}, {one.cpu_s:.0f} s"

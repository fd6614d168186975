"""Rehearsal: made-up worlds of the panel at hand, answered as the real one is, for thresholds and probabilities.

How probable a name is, and what may be taken for what else, are outcomes of the lab's own tools, objects, repeats and
noise; so are thresholds beyond which signs are an alarm, where they are not below those that another solver's grasps
ask for (`LEAST`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fast.models.calibration.inference.processes import spread
from fast.models.gap.data import GapData
from fast.models.gap.evidence.candidates import weigh_candidates
from fast.models.gap.evidence.drifts import find_effect
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.trials import LEAST, N_DESCRIBED, Signs, Trials
from fast.models.gap.evidence.worlds import DRIFTS, LARGEST, NOTHING, SMALLEST, Group, World, make_world
from fast.models.gap.findings import FamilyTold
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_number, spell_share

FALSE_SHARE = 0.01  # of worlds with nothing hidden, that each line lets pass
SEEN = 0.9
LEAST_BEHIND = 0.1  # effects by another law than the catalogue's had up to 13 % less evidence than a kin of theirs
EVEN = 0.5  # a name is said if it is more probable than not
FEWEST_HIDDEN = 10  # worlds that hide something, of which it is said what is seen
FEWEST_OF_FAMILY = 4  # worlds that hide one family, the same
LARGE = 0.05  # of the force
_N_SIZES = 100


@dataclass(frozen=True)
class Named:
    """The name that an alarm gets. description: of `Trials.describe`. is_right: whether its family is.

    behind: how much less evidence than the best the true effect has, as a share of it; None where it was not tried.
    """

    name: str
    description: tuple[float, ...]
    is_right: bool
    behind: float | None = None


@dataclass(frozen=True)
class Rehearsed:
    """What the likelihood said of a world."""

    group: Group
    """Whether it hides nothing, an effect of the catalogue, or a cause that no catalogue has."""
    signs: Signs
    """By which it is an alarm or not."""
    cause: str = ""
    """Effect or kind of cause that is hidden; empty for nothing."""
    family: str = ""
    """Of the cause; empty where the catalogue has none."""
    size: float = 0.0
    """Of what is hidden, beyond what theta and prints make up for, as a share of the force."""
    named: Named | None = None
    """The name that an alarm gets; None where no name was asked for."""
    left_out: Named | None = None
    """The name that it would have had the catalogue nothing of the family that is hidden; None where not asked."""
    second: str = ""
    """Family of another effect that is hidden beside it; mostly empty."""


@dataclass(frozen=True)
class Rehearsal:
    """Rehearsed worlds, and what is learnt from them.

    thresholds: beyond which signs are an alarm. name: odds that the family of a name
    is right, of `Trials.describe`. behind: how much less evidence than the best, as a share of it, the true effect has
    at most, nine times in ten. possible_name, possible_unknown: probabilities of a name from which on it is not
    excluded, and up to which *unknown* is not; nine in ten of each kind are kept.
    """

    worlds: tuple[Rehearsed, ...]
    thresholds: Signs
    name: Odds
    behind: float
    possible_name: float
    possible_unknown: float

    @staticmethod
    def of(worlds: Sequence[Rehearsed]) -> "Rehearsal":
        """Draw each line where one in a hundred worlds with nothing hidden passes it: the largest of fewer."""
        listed = [one.named for one in worlds if one.family and one.named is not None]
        others = [one.named for one in worlds if not one.family and one.named is not None]
        others += [one.left_out for one in worlds if one.left_out is not None]
        name = _learn_names(listed, others)
        right = [name.judge(np.array(one.description)) for one in listed if one.is_right]
        wrong = [name.judge(np.array(one.description)) for one in others]
        behind = [one.behind for one in listed if one.is_right and one.behind is not None]
        return Rehearsal(
            worlds=tuple(worlds),
            thresholds=Signs(**{one.name: _find_threshold(worlds, one.name) for one in fields(Signs)}),
            name=name,
            behind=max(float(np.quantile(behind, SEEN)) if behind else 0.0, LEAST_BEHIND),
            possible_name=float(np.quantile(right, 1.0 - SEEN)) if right else 0.0,
            possible_unknown=float(np.quantile(wrong, SEEN)) if wrong else 1.0,
        )

    @property
    def suspicion_threshold(self) -> float:
        """Evidence that one in ten worlds with nothing hidden passes; what has more is worth a question, not a name."""
        nothing = [one.signs.nats for one in self.worlds if one.group == NOTHING]
        return float(np.quantile(nothing, SEEN)) if nothing else self.thresholds.nats

    def is_alarm(self, signs: Signs) -> bool:
        """Return whether a world with these is more than what honest simulators differ by."""
        return signs.measure_over(self.thresholds) > 1.0

    def judge_gap(self, signs: Signs) -> float:
        """Compute the chance that a world with these hides something: the share of worlds on its side of the threshold.

        As many hide something as not.
        """
        is_alarm = self.is_alarm(signs)
        same = [one for one in self.worlds if self.is_alarm(one.signs) == is_alarm]
        return (sum(one.group != NOTHING for one in same) + 0.5) / (len(same) + 1.0)

    def describe_families(self) -> list[FamilyTold]:
        """Tell of each family that was hidden how often it raised an alarm and got which name; of none, at the end."""
        hidden = [one for one in self.worlds if one.group != NOTHING and not one.second]
        families, found = sorted({one.family for one in hidden}, key=lambda family: (not family, family)), []
        sizes = self._find_seen_sizes(hidden, families)
        for family in families:
            own = [one for one in hidden if one.family == family]
            alarms = [one for one in own if self.is_alarm(one.signs)]
            names = [self._find_name(one) for one in alarms]
            others = [name for name in names if name not in (family, "")]
            found.append(
                FamilyTold(
                    family=family,
                    n=len(own),
                    n_alarms=len(alarms),
                    n_right=names.count(family),
                    n_unknown=names.count(""),
                    taken_for=tuple(dict.fromkeys(sorted(others, key=lambda name: -others.count(name)))),
                    seen_size=sizes[family] if len(own) >= FEWEST_OF_FAMILY else None,
                )
            )
        return found

    def _find_seen_sizes(self, hidden: Sequence[Rehearsed], families: Sequence[str]) -> dict[str, float | None]:
        """Find the size from which nine in ten of a family raise an alarm, by family; None: not even of the largest.

        Odds grow alike with the size in all families, from a constant of each: few worlds of one borrow of the others.
        """
        if len(hidden) < FEWEST_HIDDEN:
            return dict.fromkeys(families)
        own = dict(zip(families, np.eye(len(families)), strict=True))
        rows = np.array([[*_scale_sizes(np.array([one.size]))[0], *own[one.family]] for one in hidden])
        odds = Odds.learn(rows, [self.is_alarm(one.signs) for one in hidden])
        return {family: _find_size(odds, own[family]) for family in families}

    def _find_name(self, one: Rehearsed) -> str:
        """Tell the family that an alarm is given; empty for *unknown*."""
        if one.named is None or self.name.judge(np.array(one.named.description)) <= EVEN:
            return ""
        return CATALOGUE[one.named.name].family

    def find_seen_size(self) -> float | None:
        """Find the size from which on nine in ten causes raise an alarm, of the force; None: not of the largest.

        Causes are as probable of any size on a logarithmic scale; a cause is seen with odds that grow with its size.
        """
        hidden = [one for one in self.worlds if one.group != NOTHING]
        if len(hidden) < FEWEST_HIDDEN:
            return None
        alarms = [self.is_alarm(one.signs) for one in hidden]
        odds = Odds.learn(_scale_sizes(np.array([one.size for one in hidden])), alarms)
        return _find_size(odds)

    def describe_seen_size(self, force_n: float | None = None) -> str:
        """Tell from what size causes are seen, or that large ones are not, in words. force_n: of grasps, if known."""
        hidden = [one for one in self.worlds if one.group != NOTHING]
        size, made = self.find_seen_size(), f"{len(self.worlds)} made-up worlds of these tools and objects"
        if len(hidden) < FEWEST_HIDDEN:
            return f"What could still hide is not known: of {made} too few hide anything; rehearse 40 or more."
        if size is not None:
            newton = "" if force_n is None else f" ({spell_number(size * force_n)} N)"
            return (
                f"A cause that changes the force by {spell_number(100.0 * size)} %{newton} or more, beyond what the "
                f"simulator's constants make up for, is seen in nine of ten of {made}."
            )
        large = [one for one in hidden if one.size >= LARGE]
        n_seen = sum(self.is_alarm(one.signs) for one in large)
        return (
            f"Much could still hide: even of causes of {spell_share(LARGE)} of the force or more, {n_seen} of "
            f"{len(large)} are seen in {made}."
        )


def _find_size(odds: Odds, features: np.ndarray = np.zeros(0)) -> float | None:  # noqa: B008 - never changed
    """Find the size from which nine in ten are seen; None: not of the largest. features: of odds, besides the size."""
    sizes = np.geomspace(LARGEST, SMALLEST, _N_SIZES)
    seen = np.cumsum([odds.judge(np.append(row, features)) for row in _scale_sizes(sizes)]) / np.arange(1, _N_SIZES + 1)
    passed = np.flatnonzero(seen < SEEN)
    n = int(passed[0]) if len(passed) else _N_SIZES
    return float(sizes[n - 1]) if n else None


def _scale_sizes(sizes: np.ndarray) -> np.ndarray:
    """Scale sizes (n) to features (n x 1) of about unit size."""
    return np.log(np.maximum(sizes, 1e-3) / np.sqrt(SMALLEST * LARGEST))[:, None]


@dataclass(frozen=True, eq=False)
class Panel:
    """What a rehearsal needs. families: of every effect that may be missing. seed: of the worlds."""

    problem: Problem
    families: Mapping[str, str]
    seed: int = 0


def rehearse_panel(
    data: GapData,
    effects: Sequence[EffectValue],
    n: int,
    n_workers: int = 1,
    progress: Callable[[str], None] | None = None,
) -> Rehearsal:
    """Rehearse the panel of a search in n worlds; effects: of its simulator.

    Raises:
        FastError: a process died.
    """
    usable, known = data.usable, {value.effect for value in effects}
    families = {name: CATALOGUE[name].family for name in usable.names if name not in known}
    return rehearse(Panel(Problem.of(usable, effects, data.facts), families), n, n_workers, progress)


def rehearse(panel: Panel, n: int, n_workers: int = 1, progress: Callable[[str], None] | None = None) -> Rehearsal:
    """Rehearse n worlds of a panel; the same for a seed, however many processes make them.

    Raises:
        FastError: a process died.
    """
    return Rehearsal.of(spread(rehearse_world, panel, range(n), n_workers, progress, "made-up worlds")[0])


def rehearse_world(panel: Panel, number: int) -> Rehearsed:
    """Make the world of a number and tell what the likelihood says of it. Runs in a worker process."""
    names = list(panel.families)
    world = make_world(panel.problem, names, np.random.default_rng([panel.seed, number]), number)
    fit = fit_evidence(panel.problem.measured(world.steps_n, world.facts))
    weighed = weigh_candidates(fit, names)
    own, trials = _find_family(panel.families, world), Trials.of(fit, weighed, panel.families)
    second = panel.families.get(world.second, "")
    said = Rehearsed(world.group, trials.signs, world.cause, own, world.size, second=second)
    # A name is asked for where the real panel would: beyond the least thresholds at least.
    if world.group == NOTHING or trials.signs.measure_over(LEAST) < 1.0:
        return said
    left_out = _name(trials.without(own), panel.families, world) if own and not second else None
    return replace(said, named=_name(trials, panel.families, world), left_out=left_out)


def _name(trials: Trials, families: Mapping[str, str], world: World) -> Named | None:
    if not trials.tried:
        return None
    looked = trials.look_after_best(families)
    best = looked.tried[0]
    true_nats = next((one.nats for one in looked.tried if one.effect == world.cause), None)
    return Named(
        name=best.effect,
        description=tuple(looked.describe().tolist()),
        is_right=best.family in (_find_family(families, world), families.get(world.second)),
        behind=None if true_nats is None or world.second else 1.0 - true_nats / best.nats,
    )


def _find_family(families: Mapping[str, str], world: World) -> str:
    """Find the family of what a world hides; empty if the catalogue has none."""
    cause = find_effect(DRIFTS[world.cause], "batch") if world.cause in DRIFTS else world.cause
    return families.get(cause, "")


def _find_threshold(worlds: Sequence[Rehearsed], name: str) -> float:
    values = sorted((getattr(one.signs, name) for one in worlds if one.group == NOTHING), reverse=True)
    least: float = getattr(LEAST, name)
    return max(values[int(FALSE_SHARE * len(values))], least) if values else least


def _learn_names(listed: Sequence[Named], others: Sequence[Named]) -> Odds:
    """Learn odds of a name if a cause is as probably of the catalogue as not: what a lab's is, nobody knows before."""
    if not listed or not others:
        return Odds((0.0,) * (1 + N_DESCRIBED))
    seen = [*listed, *others]
    shares = 0.5 * len(seen) * np.repeat([1.0 / len(listed), 1.0 / len(others)], [len(listed), len(others)])
    return Odds.learn(np.array([one.description for one in seen]), [one.is_right for one in seen], shares)

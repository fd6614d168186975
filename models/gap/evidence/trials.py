"""Effects on trial: each in the simulator, everything fitted again, and what it leaves for something else.

Far from nothing, what an effect changes is not in proportion to its amplitude, and theta goes where the effect lets it.
So those for which there is most evidence at the fit without them are fitted in earnest; their evidence is that of the
whole fit. A right name leaves nothing that another effect, or a pattern without a name, would explain. One that only
looks like the truth leaves it as a quantity: as if the force came later, or jaws closed farther, on some objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import chdtri

from fast.models.gap.evidence.candidates import (
    QUANTITY,
    Candidate,
    weigh_drifts,
    weigh_effects,
    weigh_patterns,
    weigh_quantities,
)
from fast.models.gap.evidence.laws import N_KNOTS, has_memory, is_beyond_solvers
from fast.models.gap.evidence.likelihood import EvidenceFit, add_effect
from fast.models.records import EffectValue

N_FAMILIES, N_OF_FAMILY = 3, 3  # that are tried: the most evident families, and effects of each
NEEDED_NATS = 3.0  # of an effect in the simulator: with less evidence than that it is not needed
_N_BESIDES = 6  # effects of other families that are weighed beside the best: the most evident ones
N_DESCRIBED = 6
_USUAL_NATS = 100.0
# An effect whose law would have to go farther than one law in a hundred goes, is another one that has its form alone.
LARGEST_DEPARTURE = float(chdtri(N_KNOTS, 0.01))
_LEAST_SHARE, _MOST_SHARE = 0.02, 2.0  # of evidence: less is nothing, more is as good as that


@dataclass(frozen=True)
class Signs:
    """What raises an alarm where it is large.

    nats: the most evidence of any candidate at the fit without it. omnibus: how much is left as a whole. full_nats: the
    most evidence of an effect that is fitted in full; spread_nats: the same less that of the cell that it helps most,
    for a snap that another mesh has elsewhere is in a single cell. sure_nats: the most evidence of a pattern by which
    solvers do not differ.
    """

    nats: float
    omnibus: float
    full_nats: float = 0.0
    spread_nats: float = 0.0
    sure_nats: float = 0.0

    def find_threshold(self, pattern: Candidate) -> float:
        """Return the evidence beyond which a pattern is an alarm, if these are the thresholds."""
        return self.sure_nats if pattern.is_sure else self.nats

    def measure_over(self, thresholds: "Signs") -> float:
        """Return how many times over its line the one is that is most over it."""
        return max(getattr(self, one.name) / getattr(thresholds, one.name) for one in fields(self))


# Below these nothing is an alarm, however few worlds were rehearsed: another solver of the same physics, with nothing
# hidden, gave up to 31 nats, and 4.3 of what is left on three objects, 2.5 on six (190 worlds, decision 086); an effect
# in full 77, and 23 without one cell, but for 2 of 840 worlds of 2 to 20 cells (decision 052); patterns that are sure
# 23 in 3,500 worlds of five panels (decision 075).
LEAST = Signs(nats=45.0, omnibus=4.5, full_nats=90.0, spread_nats=25.0, sure_nats=25.0)


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect in the simulator.

    nats: its evidence over the fit without it; spread_nats: the same without the cell that it helps most.
    left: what there is most evidence for besides, only what is no effect of its family; empty until it is looked for.
    second: the effect that it leaves most for, in the simulator beside it; None if there is none.
    """

    effect: str
    family: str
    nats: float
    spread_nats: float
    fit: EvidenceFit
    left: tuple[Candidate, ...] = ()
    second: "Trial | None" = None

    @staticmethod
    def of(fit: EvidenceFit, candidate: Candidate, family: str) -> "Trial":
        """Put a candidate into the simulator of a fit, over which its evidence is: the best of where it may start.

        A start with a stiffer finger counts if the finger stays stiffer; else its law alone cancels the effect.
        """
        fits = [
            with_it
            for value, stiffer in candidate.starts
            if (with_it := add_effect(fit, value, stiffer)).theta[0] >= np.sqrt(stiffer) * fit.theta[0]
            or stiffer == 1.0
        ]
        with_it = max(fits, key=lambda one: one.nats, default=fit)
        nats, most = with_it.nats - fit.nats, (with_it.cell_nats - fit.cell_nats).max()
        return Trial(candidate.name, family, nats, nats - max(float(most), 0.0), with_it)

    @property
    def value(self) -> EffectValue:
        """The effect as fitted."""
        return self.fit.effects[-1]

    @property
    def is_refused(self) -> bool:
        """Whether it fits by a law alone that is hardly its own."""
        return self.fit.law_departure > LARGEST_DEPARTURE

    @property
    def _left_patterns(self) -> list[Candidate]:
        return [one for one in self.left if one.kind not in ("effect", QUANTITY) and not one.effect]

    @property
    def left_patterns_nats(self) -> float:
        """Evidence that is left for a pattern or a drift without a name."""
        return max((one.nats for one in self._left_patterns), default=0.0)

    @property
    def left_over_least(self) -> float:
        """How many times over the least evidence that is an alarm the one of these is that is most over it."""
        return max((one.nats / LEAST.find_threshold(one) for one in self._left_patterns), default=0.0)

    @property
    def left_quantities_nats(self) -> float:
        """Evidence that is left for jaws, objects or clocks that are otherwise than told."""
        return max((one.nats for one in self.left if one.kind == QUANTITY), default=0.0)

    @property
    def left_effects_nats(self) -> float:
        """Evidence that is left for another effect of the catalogue."""
        return max((one.nats for one in self.left if one.effect), default=0.0)


@dataclass(frozen=True, eq=False)
class Trials:
    """All that was tried, the best first. weighed: what there is evidence for without any, the most first.

    missing: families that the catalogue is taken not to have. refused: what would fit by another law than its own; it
    is not named.
    """

    fit: EvidenceFit
    weighed: tuple[Candidate, ...]
    tried: tuple[Trial, ...]
    missing: tuple[str, ...] = ()
    refused: tuple[Trial, ...] = ()

    @staticmethod
    def of(fit: EvidenceFit, weighed: Sequence[Candidate], families: Mapping[str, str]) -> "Trials":
        """Put the effects with most evidence on trial. families: of every effect that may be named."""
        found = [Trial.of(fit, one, families[one.name]) for one in _choose(weighed, families)]
        found.sort(key=lambda trial: -trial.nats)
        tried, refused = (tuple(one for one in found if one.is_refused == is_refused) for is_refused in (False, True))
        return Trials(fit, tuple(weighed), tried, refused=refused)

    @property
    def signs(self) -> Signs:
        """What may raise an alarm."""
        beyond = [one for one in self.tried if is_beyond_solvers(one.value)]
        weighed = (one.nats for one in self.weighed if one.value is None or is_beyond_solvers(one.value))
        return Signs(
            nats=max(weighed, default=0.0),
            omnibus=self.fit.omnibus,
            full_nats=max((one.nats for one in beyond), default=0.0),
            spread_nats=max((one.spread_nats for one in beyond), default=0.0),
            sure_nats=max((one.nats for one in self.weighed if one.is_sure), default=0.0),
        )

    def look_after_best(self, families: Mapping[str, str]) -> "Trials":
        """Add what the best trial leaves for patterns, drifts, and effects of other families."""
        if not self.tried or self.tried[0].left:
            return self
        best = self.tried[0]
        looked = replace(best, left=self._list_left(best.fit, families, (best.family,)))
        looked = replace(looked, second=self._try_beside(looked, families))
        return replace(self, tried=(looked, *self.tried[1:]))

    def _try_beside(self, best: Trial, families: Mapping[str, str]) -> Trial | None:
        """Try beside the best the effect that it leaves most for; None if that explains nothing, or is refused."""
        one = next((one for one in best.left if one.value is not None), None)
        if one is None or one.nats < NEEDED_NATS:
            return None
        second = Trial.of(best.fit, one, families[one.name])
        known = best.family, second.family
        return None if second.is_refused else replace(second, left=self._list_left(second.fit, families, known))

    def _list_left(self, fit: EvidenceFit, families: Mapping[str, str], known: Sequence[str]) -> tuple[Candidate, ...]:
        """List what there is evidence for besides the families `known`, whose effects the fit has; most first."""
        seen = [one.name for one in self.weighed if one.kind == "effect"]
        others = [name for name in seen if families.get(name) not in (None, *known, *self.missing)][:_N_BESIDES]
        kept = {name for name, family in families.items() if family not in self.missing}
        drifts = [one if one.effect in kept else replace(one, effect="") for one in weigh_drifts(fit)]
        # Where what is changed by an effect itself changes from grasp to grasp, lesser drifts only look like that.
        own = max((one.nats for one in drifts if families.get(one.effect) in known), default=0.0)
        lesser = [one for one in drifts if one.nats <= own]
        effects = [one for one in weigh_effects(fit, others) if not has_memory(one.name) or one.nats > own]
        patterns = [*weigh_patterns(fit), *weigh_quantities(fit)]
        left = [*effects, *patterns, *(one for one in drifts if one not in lesser)]
        return tuple(sorted(left, key=lambda one: -one.nats))

    def find(self, effect: str) -> Trial:
        """Find the trial of an effect that was tried."""
        return next(one for one in self.tried if one.effect == effect)

    def without(self, family: str) -> "Trials":
        """Return what would have been tried had the catalogue no such family."""
        tried, refused = (tuple(one for one in own if one.family != family) for own in (self.tried, self.refused))
        return replace(self, tried=tried, refused=refused, missing=(*self.missing, family))

    def describe(self) -> np.ndarray:
        """Describe what tells a right name from a wrong one, `N_DESCRIBED` numbers, all but the last logarithms.

        The evidence of the best effect, as far as more of it says more; the mean share of it that is left for a
        pattern, a quantity, and another effect; the evidence of the best effect of another family, or of one that is
        refused, as such a share; by how much what is left for a pattern would be an alarm of its own; the share of a
        second effect beside the best; and how many standard deviations the law of the best had to go. With a second,
        what is left is what both leave.
        """
        best = self.tried[0]
        others = [trial.nats for trial in self.tried if trial.family != best.family]
        second = max([*others, *(trial.nats for trial in self.refused)], default=0.0)
        last, beside = best.second or best, 0.0 if best.second is None else best.second.nats
        nats = max(best.nats, 1.0)
        left = np.array([last.left_patterns_nats, last.left_quantities_nats, last.left_effects_nats])
        return np.array(
            [
                min(np.log(nats / _USUAL_NATS), 1.0),
                np.log(np.clip(left / nats, _LEAST_SHARE, _MOST_SHARE)).mean(),
                np.log(np.clip(second / nats, _LEAST_SHARE, _MOST_SHARE)),
                np.log(max(last.left_over_least, 1.0)),
                np.log(np.clip(beside / nats, _LEAST_SHARE, _MOST_SHARE)),
                np.sqrt(best.fit.law_departure),
            ]
        )


def _choose(weighed: Sequence[Candidate], families: Mapping[str, str]) -> list[Candidate]:
    """Choose the best effects of the best families; weighed: the most evidence first."""
    chosen: dict[str, list[Candidate]] = {}
    for one in weighed:
        family = families.get(one.name)
        if one.kind != "effect" or family is None or (family not in chosen and len(chosen) == N_FAMILIES):
            continue
        own = chosen.setdefault(family, [])
        if len(own) < N_OF_FAMILY:
            own.append(one)
    return [one for own in chosen.values() for one in own]

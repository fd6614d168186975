"""Effects on trial: each in the simulator, everything fitted again, and what it leaves for something else.

Far from nothing, what an effect changes is not in proportion to its amplitude, and theta goes where the effect lets it.
So those for which there is most evidence at the fit without them are fitted in earnest; their evidence is that of the
whole fit. A right name leaves nothing that another effect, or a pattern without a name, would explain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fast.models.gap.evidence.candidates import Candidate, weigh_drifts, weigh_effects, weigh_patterns
from fast.models.gap.evidence.likelihood import EvidenceFit, add_effect
from fast.models.records import EffectValue

N_FAMILIES, N_OF_FAMILY = 4, 3  # that are tried: the most evident families, and effects of each


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect in the simulator. nats: its evidence over nothing. left: what there is most evidence for besides.

    Of `left`, only what is no effect of its family; empty until it is looked for.
    """

    effect: str
    family: str
    nats: float
    fit: EvidenceFit
    left: tuple[Candidate, ...] = ()

    @property
    def value(self) -> EffectValue:
        """The effect as fitted."""
        return self.fit.effects[-1]

    def measure_left(self, kinds: Sequence[str]) -> float:
        """Evidence that is left for candidates of these kinds, in nats."""
        return max((one.nats for one in self.left if one.kind in kinds), default=0.0)


def try_effects(fit: EvidenceFit, weighed: Sequence[Candidate], families: Mapping[str, str]) -> list[Trial]:
    """The effects with most evidence on trial, the best first. families: of every effect that may be named."""
    base = fit.nats
    found = []
    for one in _choose(weighed, families):
        with_it = add_effect(fit, one.value) if one.value is not None else fit
        found.append(Trial(one.name, families[one.name], with_it.nats - base, with_it))
    return sorted(found, key=lambda trial: -trial.nats)


def look_after(trial: Trial, families: Mapping[str, str]) -> Trial:
    """The trial with what is left for patterns, drifts, and effects of other families."""
    others = [name for name, family in families.items() if family != trial.family]
    left = [*weigh_effects(trial.fit, others), *weigh_patterns(trial.fit), *weigh_drifts(trial.fit)]
    return replace(trial, left=tuple(sorted(left, key=lambda one: -one.nats)))


def _choose(weighed: Sequence[Candidate], families: Mapping[str, str]) -> list[Candidate]:
    """Of the best families the best effects; weighed: the most evidence first."""
    chosen: dict[str, list[Candidate]] = {}
    for one in weighed:
        family = families.get(one.name)
        if one.kind != "effect" or family is None or (family not in chosen and len(chosen) == N_FAMILIES):
            continue
        own = chosen.setdefault(family, [])
        if len(own) < N_OF_FAMILY:
            own.append(one)
    return [one for own in chosen.values() for one in own]

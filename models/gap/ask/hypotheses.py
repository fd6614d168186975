"""What is still possible after a round: members of a set, other effects, *nothing* and *unknown*."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.gap.findings import NONE, UNKNOWN
from fast.models.gap.fit.fit import Fit, axes_of
from fast.models.gap.fit.law_freedom import free_law
from fast.models.gap.naming.name import NamingResult, share_evidence
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

SURE = 0.9  # a name of this probability is not asked about
POSSIBLE = 0.03  # a hypothesis below is not what an experiment is made for
LEAST = 0.05  # of *unknown*, and of evident effects: whatever one explains, something else may do so too
_EVIDENT = 1.0 / 3.0  # of the best's evidence: no bench has the catalogue's law, and a true effect may have as little
_MOST_EFFECTS = 5
_REACH = 3.0  # times its size, what a pattern may change by at another setting


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Something that may be true. name: an effect, `none` or `unknown`. fit: with the effect, if it is one.

    size: of *unknown*, what its pattern is of the force if another setting changes it in any way; 0 if none does. Both
    are possible, and *unknown* is in the list twice.
    """

    name: str
    probability: float
    fit: Fit
    size: float = 0.0

    @property
    def own(self) -> tuple[EffectValue, ...]:
        """The effect that the hypothesis is about, with its values."""
        return tuple(value for value in self.fit.effects if value.effect == self.name)

    def estimate_parameters(self) -> dict[str, tuple[float, float]]:
        """Estimate the value and standard deviation of each parameter of the effect, with its law free."""
        if not self.own:
            return {}
        freed, axes = free_law(self.fit, self.name), axes_of(self.name)
        sd = np.sqrt(np.diag(freed.deflated_covariance))[-len(axes) :]
        found = {}
        for axis, along in zip(axes, sd, strict=True):
            value = self.own[0].parameters[axis.name]
            ends = [axis.value(axis.inner(value) + side * float(along)) for side in (-1.0, 1.0)]
            found[axis.name] = (value, 0.5 * abs(ends[1] - ends[0]))
        return found

    def draw(self, n: int, rng: np.random.Generator) -> list[tuple[np.ndarray, tuple[EffectValue, ...], np.ndarray]]:
        """Draw n times theta (3), effects and moduli of tools from the normal posterior around the fit."""
        fit = free_law(self.fit, self.name) if self.own else self.fit
        covariance = fit.deflated_covariance
        root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
        return [self._move(root @ step) for step in rng.standard_normal((n, len(covariance)))]

    def _move(self, step: np.ndarray) -> tuple[np.ndarray, tuple[EffectValue, ...], np.ndarray]:
        fit, surfaces = self.fit, self.fit.features.surrogate.surfaces
        theta = np.array([fit.theta[0] * np.exp(step[0]), *(fit.theta[1:] + step[1:3])])
        theta[1:] = np.clip(theta[1:], surfaces.lower, surfaces.upper)
        tool_factor = np.exp(fit.tool_log + step[3 : 3 + len(fit.tool_log)])
        axes = [axis for value in fit.effects for axis in axes_of(value.effect)]
        inner = dict(zip([(axis.effect, axis.name) for axis in axes], step[len(step) - len(axes) :], strict=True))
        effects = []
        for value in fit.effects:
            moved = {}
            for axis in axes_of(value.effect):
                at = axis.inner(value.parameters[axis.name]) + float(inner[value.effect, axis.name])
                moved[axis.name] = axis.value(float(np.clip(at, *axis.limits)))
            effects.append(value.model_copy(update={"parameters": {**value.parameters, **moved}}))
        return theta, tuple(effects), tool_factor


def list_hypotheses(naming: NamingResult) -> tuple[Hypothesis, ...]:
    """List what is possible after a round, by probability; empty where nothing is to be asked.

    Nothing is asked where an effect is sure, where no effect comes near an alarm, or where answers showed nothing.
    """
    named = naming.named
    is_silent = named.kind == NONE and (naming.believed is not None or not naming.trials.tried)
    if is_silent or (named.kind == "effect" and named.probability >= SURE):
        return ()
    chance = _weigh_names(naming) if naming.believed is None else naming.believed
    weight = {name: p for name, p in chance.items() if name in CATALOGUE and (p >= POSSIBLE or name in named.effects)}
    chosen = sorted(weight, key=lambda name: -weight[name])[:_MOST_EFFECTS]
    base = naming.fit
    found = [Hypothesis(name, weight[name], naming.decider.fit_with(name)) for name in chosen]
    if chance.get(NONE, 0.0) >= POSSIBLE:
        found.append(Hypothesis(NONE, chance[NONE], base))
    unknown = max(chance.get(UNKNOWN, 0.0), LEAST)
    found += [Hypothesis(UNKNOWN, 0.5 * unknown, base, size) for size in (0.0, _REACH * naming.pattern_size)]
    return _normalise(found)


def _weigh_names(naming: NamingResult) -> dict[str, float]:
    """Weigh how probable each effect on trial, *nothing* and *unknown* are before any answer; they sum to about 1.

    Effects with a third of the evidence of the best are possible, however their shares fell.
    """
    gap, tried = naming.alarm.gap, naming.trials.tried
    evident = _EVIDENT * tried[0].nats if tried else 0.0
    by_family = naming.decider.judge_families()
    found = {NONE: 1.0 - gap, UNKNOWN: gap * (1.0 - sum(by_family.values()))}
    for family, chance in by_family.items():
        own = [trial for trial in tried if trial.family == family and trial.nats > 0.0]
        shares = share_evidence([trial.nats for trial in own], naming.decider.rehearsal.behind)
        for trial, share in zip(own, shares, strict=True):
            found[trial.effect] = max(gap * chance * share, LEAST if trial.nats >= evident else 0.0)
    return found


def _normalise(found: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    total = sum(one.probability for one in found)
    return tuple(replace(one, probability=one.probability / total) for one in found)

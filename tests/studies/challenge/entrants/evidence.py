"""FAST's evidence: one likelihood of all that is measured, with the lines of a rehearsal; a distortion test.

A distortion test (Anau Montel, Alvey and Weniger, arXiv 2412.15100) weighs many ways in which a simulator may be wrong,
each by a likelihood ratio, and judges them together: here the largest of them, and what is left as a whole.
"""

from dataclasses import dataclass

import numpy as np

from fast.flows.challenge.manifest import NOT_LISTED
from fast.flows.challenge.world_folder import GivenWorld
from fast.models.gap.evidence.candidates import Candidate, weigh_candidates
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.rehearsal import Rehearsal, rehearse
from tests.studies.challenge.entrants.common import Fitted, Opinion

N_REHEARSED = 120
_SUREST = 0.95


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence with the lines of one rehearsal, of the panel of a first world."""

    rehearsal: Rehearsal

    @staticmethod
    def rehearse(world: GivenWorld, n: int = N_REHEARSED) -> "Evidence":
        """Lines from so many made-up worlds."""
        usable = world.data.usable
        return Evidence(rehearse(Problem.of(usable), usable.names, n, seed=0))

    def answer(self, fitted: Fitted) -> Opinion:
        """What the evidence says of a world."""
        fit = fit_evidence(fitted.problem)
        candidates = weigh_candidates(fit, fitted.world.data.usable.names)
        best, lines = candidates[0], self.rehearsal
        missing = lines.is_alarm(best.nats, fit.omnibus)
        probability = lines.estimate_hidden(is_alarm=missing)
        if not missing:
            return Opinion(False, probability, fitted.foretell_with())
        effect = best.effect if best.effect and best.nats > lines.nats_line else NOT_LISTED
        forces_n = fitted.foretell_with(() if best.value is None else (best.value,))
        return Opinion(True, probability, forces_n, effect, _estimate_share(candidates, effect))


def _estimate_share(candidates: list[Candidate], effect: str) -> float:
    """Share of the evidence of all candidates that the named effect has."""
    nats = np.array([one.nats for one in candidates])
    weights = np.exp(nats - nats.max())
    own = sum(w for w, one in zip(weights, candidates, strict=True) if (one.effect or NOT_LISTED) == effect)
    return float(min(own / weights.sum(), _SUREST))

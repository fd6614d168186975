"""FAST's evidence: one likelihood of all that is measured, with the lines of a rehearsal; a distortion test.

A distortion test (Anau Montel, Alvey and Weniger, arXiv 2412.15100) weighs many ways in which a simulator may be wrong,
each by a likelihood ratio, and judges them together: here the largest of them, and what is left as a whole.
"""

from dataclasses import dataclass

from fast.flows.challenge.manifest import NOT_LISTED
from fast.flows.challenge.world_folder import GivenWorld
from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.candidates import weigh_candidates
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.rehearsal import EVEN, Panel, Rehearsal, rehearse
from fast.models.gap.evidence.trials import Trials
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.challenge.entrants.common import Fitted, Opinion

N_REHEARSED = 120


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence with the lines of one rehearsal, of the panel of a first world."""

    rehearsal: Rehearsal

    @staticmethod
    def rehearse(world: GivenWorld, n: int = N_REHEARSED) -> "Evidence":
        """Lines from so many made-up worlds."""
        usable = world.data.usable
        return Evidence(rehearse(Panel(Problem.of(usable), _find_families(usable)), n))

    def answer(self, fitted: Fitted) -> Opinion:
        """What the evidence says of a world."""
        usable, lines = fitted.world.data.usable, self.rehearsal
        families = _find_families(usable)
        fit = fit_evidence(fitted.problem)
        trials = Trials.of(fit, weigh_candidates(fit, usable.names), families)
        probability = lines.judge_gap(trials.signs)
        if not lines.is_alarm(trials.signs):
            return Opinion(False, probability, fitted.foretell_with())
        trials = trials.look_after_best(families)
        best, name = trials.tried[0], lines.name.judge(trials.describe())
        forces_n = fitted.foretell_with((best.value,))
        return Opinion(True, probability, forces_n, best.effect if name >= EVEN else NOT_LISTED)


def _find_families(surrogate: Surrogate) -> dict[str, str]:
    return {name: CATALOGUE[name].family for name in surrogate.names}

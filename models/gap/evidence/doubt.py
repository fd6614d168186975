"""Whether "nothing is missing" may be said: a statement with what could still hide, or an alarm without a name.

"None" is said only if no candidate passes its line and what is left as a whole is no larger than honest simulators
differ by; both lines are those of the rehearsal of the panel at hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.bank.surrogate import Surrogate
from fast.models.gap.evidence.candidates import Candidate, weigh_candidates
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.reading import compute_rms
from fast.models.gap.evidence.rehearsal import Rehearsal, rehearse
from fast.models.gap.findings import Decision
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE


@dataclass(frozen=True, eq=False)
class Doubt:
    """What the likelihood says of a panel where no effect was named. best: what there is most evidence for."""

    fit: EvidenceFit
    best: Candidate
    rehearsal: Rehearsal

    @staticmethod
    def of(
        surrogate: Surrogate,
        in_model: Sequence[EffectValue],
        names: Sequence[str],
        n_worlds: int,
        seed: int = 0,
    ) -> "Doubt":
        """The doubt of a simulator with effects `in_model`, by the grasps of a surrogate, all of them usable."""
        problem = Problem.of(surrogate, in_model)
        fit = fit_evidence(problem)
        return Doubt(fit, weigh_candidates(fit, names)[0], rehearse(problem, names, n_worlds, seed))

    @property
    def is_alarm(self) -> bool:
        """Whether something is missing."""
        return self.rehearsal.is_alarm(self.best.nats, self.fit.omnibus)

    @property
    def over_line(self) -> float:
        """How many times over its line the evidence, or what is left, is."""
        lines = self.rehearsal
        return max(self.best.nats / lines.nats_line, self.fit.omnibus / lines.omnibus_line)

    def decide(self) -> Decision:
        """None with what could still hide, or unknown with its size and where it is."""
        return self._decide_unknown() if self.is_alarm else self._decide_none()

    def _decide_none(self) -> Decision:
        size, force_n = self.rehearsal.find_seen_size(), compute_rms(self.fit.force_n)
        hides = "What could still hide is not known: of too few made-up worlds too little was seen."
        if size is not None:
            hides = (
                f"A cause that changes the force by {100.0 * size:.2g} % ({size * force_n:.2g} N) or more was seen in "
                f"nine of ten of {len(self.rehearsal.worlds)} made-up worlds of these tools and objects."
            )
        return Decision(
            kind="none",
            probability=1.0 - self.rehearsal.estimate_hidden(is_alarm=False),
            sentence=f"Nothing is left that is larger than what honest simulators differ by. {hides}",
        )

    def _decide_unknown(self) -> Decision:
        best, fit = self.best, self.fit
        change_n = fit.rest_n if best.change_n is None or best.nats <= self.rehearsal.nats_line else best.change_n
        size_n = compute_rms(change_n)
        share = 100.0 * size_n / compute_rms(fit.force_n)
        return Decision(
            kind="unknown",
            probability=self.rehearsal.estimate_hidden(is_alarm=True),
            sentence=(
                f"Something is missing that no effect of the catalogue explains: {self._describe()}, "
                f"{size_n:.2g} N root mean square ({share:.2g} % of the force), {self._find_most(change_n)}."
            ),
        )

    def _describe(self) -> str:
        best = self.best
        if best.nats <= self.rehearsal.nats_line:
            return (
                f"cells are {np.sqrt(self.fit.omnibus):.1f} times further off than honest simulators, without a pattern"
            )
        if best.kind == "effect":
            title = CATALOGUE[best.effect].title
            return f"nearest is “{title}”, but that does not predict designs and objects that are left out"
        if best.kind == "drift":
            quantity, clock = best.name.split(" ")
            return f"repeats of the same grasps differ, as if the {quantity} changed with the {clock}"
        return best.name

    def _find_most(self, change_n: np.ndarray) -> str:
        """Where it is largest: the object and the tool with the largest share of its squares."""
        problem, squares = self.fit.problem, (change_n**2).sum(axis=1)
        grasps = problem.surrogate.grasps

        def most(group: np.ndarray, n: int) -> int:
            return int(np.argmax([squares[group == one].mean() if (group == one).any() else 0.0 for one in range(n)]))

        obj, tool = most(problem.obj, len(grasps.objects)), most(problem.tool, len(grasps.tools))
        return f"most on object {grasps.objects[obj]} and tool {grasps.tools[tool]}"

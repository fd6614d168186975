"""What the tools of a prior campaign bring to the surrogate of a campaign on another bench."""

from pathlib import Path

import numpy as np

from fast.models.design.space import random_unit
from fast.models.scientist.surrogate.fit import fit_surrogate, trust_prior
from fast.models.scientist.surrogate.observations import FIRST_PRIOR, REAL, ObservationSet
from fast.models.traces.quality import mean_of_tools
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.landscapes.bank import LandscapeBank
from tests.studies.landscapes.landscape import Landscape, landscape_of

BANK = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "landscapes.json"
N_PRIOR, N_UNSEEN, SEED = 40, 400, 20261123
SIZES = (5, 10, 20, 40)
UNRELATED = "shuffled"


def measure_prior(options: Options) -> Tables:
    """Error at unseen designs without a prior campaign, with it pooled as if own, and with it as a task of its own."""
    bank = LandscapeBank.read(BANK)
    landscapes = [landscape_of(bank, number) for number in range(len(bank.truths))]
    rows = []
    for kind in ("another bench", UNRELATED):
        for n_own in SIZES:
            found = []
            for place, own in enumerate(landscapes):
                options.tell(f"{kind}, {n_own} own tools, landscape {place + 1} of {len(landscapes)}")
                others = [other for other in landscapes if other is not own]
                rng = np.random.default_rng([SEED, n_own, place])
                found.append(_errors(own, others[int(rng.integers(len(others)))], n_own, kind == UNRELATED, rng))
            alone, pooled, task, correlation = np.array(found).T
            ratio = mean_of_tools(task / alone)
            rows.append(
                {
                    "prior": kind,
                    "own_tools": n_own,
                    "error_alone": float(np.median(alone)),
                    "error_pooled": float(np.median(pooled)),
                    "error_task": float(np.median(task)),
                    "task_over_alone": ratio.mean,
                    "ci95": f"[{ratio.lower:.2f}, {ratio.upper:.2f}]",
                    "correlation": float(np.median(correlation)),
                }
            )
    return {"prior": rows}


def _errors(
    own: Landscape, other: Landscape, n_own: int, is_shuffled: bool, rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """Root mean square relative errors at unseen designs: alone, pooled, as a task; and the correlation found."""
    x, x_prior, unseen = (random_unit(n, rng) for n in (n_own, N_PRIOR, N_UNSEEN))
    y, y_prior = (np.maximum(world.measure(at, rng), 0.1) for world, at in ((own, x), (other, x_prior)))
    if is_shuffled:
        y_prior = rng.permutation(y_prior)
    points, forces_n = np.concatenate([x, x_prior]), np.concatenate([y, y_prior])
    s = np.repeat([REAL, FIRST_PRIOR], [n_own, N_PRIOR])
    data = ObservationSet(points, s, np.log(forces_n), np.zeros(len(s)))
    pooled = ObservationSet(points, np.full(len(s), REAL), np.log(forces_n), np.zeros(len(s)))
    whole = fit_surrogate(data)
    fits = fit_surrogate(data.of_this_campaign()), fit_surrogate(pooled), trust_prior(whole)
    truth = np.log(own.real(unseen))
    errors = [float(np.sqrt(np.mean((fit.mean(unseen, REAL) - truth) ** 2))) for fit in fits]
    return errors[0], errors[1], errors[2], whole.parameters.priors[0].correlation

"""The lines above which gap discovery speaks, and where they come from: worlds in which nothing is hidden.

Truth of such worlds is another simulator (finer mesh, other contact law) with scatter and noise, so that numerical
error alone does not call an alarm.
"""

from collections.abc import Sequence

import numpy as np

from models.gap.naming.candidates import compute_probabilities
from models.records import Record

FALSE_ALARMS = 0.05
_TEMPERATURES = np.geomspace(1.0, 300.0, 25)


class Statistics(Record):
    """What a world's alarms are decided on; larger is more of a gap.

    effect_r2: held-out share of squares that the best effect predicts. upper_bound_r2: the same for the explainable
    upper bound. misfit, contrast_misfit: mean squared residual of cells' means and of the contrasts of repeats.
    """

    effect_r2: float
    upper_bound_r2: float
    misfit: float
    contrast_misfit: float


class Thresholds(Record):
    """When gap discovery speaks.

    effect_r2, upper_bound_r2, misfit, contrast_misfit: lines of `Statistics`; usual_misfit, usual_contrast_misfit:
    their means in null worlds. share: of the misfit beyond that, at least so much must be the named effect's.
    temperature: of evidence in nats. probability: from here on one effect is named. least_nats: between predictions of
    two effects that are told apart.

    Default lines are those of 40 null worlds of the study `gap` (14 designs, 8 objects, 3 repeats; a finer mesh
    with another contact law), at least three standard deviations above their mean; the temperature is that of 20 worlds
    with an effect. With these lines none of 60 sealed null worlds raised an alarm (docs/reference/measured-figures.md).
    """

    effect_r2: float = 0.01
    upper_bound_r2: float = 0.005
    misfit: float = 2.604
    contrast_misfit: float = 1.869
    usual_misfit: float = 2.263
    usual_contrast_misfit: float = 1.604
    share: float = 0.5
    temperature: float = 5.28
    probability: float = 0.9
    least_nats: float = 3.0


def fit_thresholds(nulls: Sequence[Statistics], base: Thresholds = Thresholds()) -> Thresholds:  # noqa: B008 - frozen
    """Lines that at most `FALSE_ALARMS` of the null worlds cross anywhere, each at the same quantile.

    With fewer than 20 worlds they are the largest values seen, which claims less than it seems to.
    """
    names = tuple(Statistics.model_fields)
    table = np.array([[getattr(row, name) for name in names] for row in nulls])
    lines = table.max(axis=0)
    for quantile in np.linspace(1.0 - FALSE_ALARMS, 1.0, 51):
        lines = np.quantile(table, quantile, axis=0)
        if (table > lines).any(axis=1).mean() <= FALSE_ALARMS:
            break
    usual = {f"usual_{name}": float(table[:, names.index(name)].mean()) for name in ("misfit", "contrast_misfit")}
    return base.model_copy(update={**dict(zip(names, lines.tolist(), strict=True)), **usual})


def fit_temperature(
    evidence: Sequence[Sequence[np.ndarray]], priors: Sequence[Sequence[float]], truths: Sequence[int]
) -> float:
    """The temperature at which the truths of development worlds are least surprising.

    evidence: of each world, gains in nats of its candidates (designs x objects each); truths: which of them was true.
    """
    surprise = [
        -sum(
            np.log(max(float(compute_probabilities(gains, prior, temperature)[truth]), 1e-6))
            for gains, prior, truth in zip(evidence, priors, truths, strict=True)
        )
        for temperature in _TEMPERATURES
    ]
    return float(_TEMPERATURES[int(np.argmin(surprise))])

"""How many designs and objects a claim takes, and how large an effect must be: with every answer, most of all none."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from fast.models.gap.bank.surrogate import N_BINS
from fast.models.gap.fit.fit import Fit, axes_of
from fast.models.gap.naming.rank_effects import DEFLATION, LEAST_NATS, EffectRanking
from fast.models.gap.naming.thresholds import Thresholds
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_name, unit_of

TOOL_SD, CELL_SD = 0.04, 0.02  # of a print and of a placement, relative; what other labs see
LEVEL = 0.005  # of one factor, so that all factors of all phases together hold 5 %
POWER = 0.8
LEAST_TOOLS = 8  # fewer give too few permutations for that level
_MOST = 200
_FURTHEST = 3.0  # times a secant: an effect is not in proportion any more


def compute_smallest_share(n_tools: int, n_objects: int) -> float:
    """The smallest gap, relative, that so many tools show on half of the designs with probability `POWER`.

    Two groups of tools are compared, which scatter by `TOOL_SD`, and by `CELL_SD` on each object: Student's two-sided
    test at `LEVEL`. Made-up worlds agree: 15 % is seen by 8 tools in 16 of 20, 5 % by 35 in
    14 of 20 (docs/reference/measured-figures.md).
    """
    variance = TOOL_SD**2 + CELL_SD**2 / max(n_objects, 1)
    of_freedom = max(n_tools - 2, 1)
    wanted = float(student.ppf(1.0 - LEVEL / 2.0, of_freedom) + student.ppf(POWER, of_freedom))
    return float(wanted * np.sqrt(4.0 * variance / max(n_tools, 1)))


def count_tools_needed(share: float, n_objects: int) -> int:
    """Tools to see a gap of `share` of the force on half of the designs, at least `LEAST_TOOLS`, at most 200."""
    tools = range(LEAST_TOOLS, _MOST)
    return next((n for n in tools if compute_smallest_share(n, n_objects) <= abs(share)), _MOST)


def write_power_sentence(n_tools: int, n_objects: int) -> str:
    """What so many designs and objects to learn from could have shown, and how many a gap of 5 % takes."""
    seen, wanted = compute_smallest_share(n_tools, n_objects), 0.05
    more = f"; one of 5 % takes {count_tools_needed(wanted, n_objects)} designs" if seen > wanted else ""
    return (
        f"{n_tools} designs on {n_objects} objects to learn from show a gap on half of the designs with "
        f"{100 * POWER:.0f} % power if it is {100 * seen:.0f} % of the force or more{more}."
    )


@dataclass(frozen=True)
class VisibleSize:
    """The smallest size of an effect that these data would have shown; None: none that is plausible."""

    effect: str
    value: EffectValue | None

    @property
    def words(self) -> str:
        """The size as people write it: its first parameter that is not neutral."""
        if self.value is None:
            return "not at any plausible size"
        spec = CATALOGUE[self.effect]
        chosen = [p for p in spec.parameters if self.value.parameters.get(p.name, p.neutral) != p.neutral]
        name = (chosen or spec.parameters)[0].name
        return f"{spell_name(name)} {self.value.parameters[name]:.2g} {unit_of(name) or ''}".strip()


def find_visible_sizes(
    fit: Fit,
    ranking: EffectRanking,
    line_r2: float = Thresholds.model_fields["least_r2"].default,
    least_size: float = Thresholds.model_fields["effect_size"].default,
) -> tuple[VisibleSize, ...]:
    """The smallest size of every ranked effect whose expected evidence passes the lines, in the order of the ranking.

    fit: with all that was named; its residual is what an effect must show against. An effect that is scaled to a
    changes a times what theta, tools and variants cannot make up for. It passes if that is at least `line_r2` of all
    squares, `least_size` of the forces, and `LEAST_NATS` of evidence.
    """
    noise = float((fit.residual**2).sum())
    wanted = max(line_r2 / (1.0 - line_r2) * noise, 2.0 * LEAST_NATS / DEFLATION)
    squares = (ranking.own**2).sum(axis=(1, 2))
    scales = np.sqrt(wanted / np.maximum(squares, 1e-12))
    changes_n = fit.features.unwhiten(ranking.own / fit.weight)[..., :N_BINS]
    of_force = np.sqrt((changes_n**2).mean(axis=(1, 2)) / (fit.predict_features()[:, :N_BINS] ** 2).mean())
    scales = np.maximum(scales, least_size / np.maximum(of_force, 1e-9))
    found = []
    for effect in ranking.names:
        places = [place for place, name in enumerate(ranking.effects) if name == effect]
        # The secant whose own size is nearest to what is wanted has to be stretched least.
        place = min(places, key=lambda one: abs(float(np.log(scales[one]))))
        found.append(VisibleSize(effect, _scale(ranking.values[place], float(scales[place]))))
    return tuple(found)


def _scale(value: EffectValue, share: float) -> EffectValue | None:
    """An effect with its amplitudes times a share, on the axes on which effects are fitted; None beyond its bounds."""
    if share > _FURTHEST:
        return None
    parameters = dict(value.parameters)
    for axis in axes_of(value.effect):
        if axis.name in parameters and axis.kind != "log":
            inner = share * axis.inner(parameters[axis.name])
            parameters[axis.name] = axis.value(inner)
            if not np.isclose(axis.inner(parameters[axis.name]), inner, atol=1e-6):
                return None
    return value.model_copy(update={"parameters": parameters})

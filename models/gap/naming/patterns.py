"""Patterns without a name: what the rest of a fit may have in common that no effect of the catalogue says.

A pattern is a force over the lift, or a factor on the force over the lift, that is the same in every grasp or grows
with something that is known of the grasp: the repeat, the order, the width of the object, the force. It has a few
smooth coefficients with a normal prior whose size is not known, so its evidence can be compared with that of an effect,
and it can be said in words.

Or every object has a factor of its own, or every tool: what is wrong with single objects (their size, edges, surface)
predicts the grasps of other designs on them, and nothing of other objects. It may be wrong all along the lift, so the
coefficients of an object may be alike. Prints differ in their modulus anyway, so a factor of a tool is one that changes
over the lift.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from fast.models.gap.bank.surrogate import N_BINS, features_of_steps
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.law_freedom import solve_step
from fast.models.gap.grasps import Grasps
from fast.models.gap.where.strata import object_shape
from fast.models.traces.step_features import N_STEPS, STEP_MM

KNOTS_MM = (0.0, 1.5, 5.0, 12.0, 25.0, 45.0)  # of the lift, where a pattern has a coefficient; straight between
SIZES = (0.003, 0.01, 0.03, 0.1)  # standard deviations of coefficients that are tried, of the force
ALIKE = (0.0, 0.9)  # correlations of an object's coefficients along the lift that are tried
_LEAST_SD = 1e-9
_FACTOR = "a factor on the force"

Kind = Literal["common", "by object", "by tool"]


@dataclass(frozen=True, eq=False)
class Pattern:
    """A pattern at a fit. columns: k x m x f, whitened and weighted. nats: its log evidence over none at all.

    `what` and `how`: its words, "a force" or "a factor on the force", and what it depends on. size: of `SIZES`, the
    likeliest. kind: whether it is common to all grasps, or every object or tool has its own.
    """

    what: str
    how: str
    columns: np.ndarray
    nats: float
    size: float
    kind: Kind = "common"

    @property
    def words(self) -> str:
        """The pattern in words."""
        return f"{self.what} over the lift, {self.how}"

    def add_to(self, fit: Fit) -> Fit:
        """The fit with the columns of the pattern."""
        return fit.add_columns(self.columns, self.size)

    def measure_share(self, fit: Fit) -> float:
        """What the pattern at its best changes in the forces of a fit: root mean square, as a share of theirs."""
        change, force = self._find_change(fit)
        return float(np.sqrt((change**2).mean() / max(float((force**2).mean()), 1e-12)))

    def describe(self, fit: Fit) -> str:
        """The pattern in words; of one by object or tool, also where it changes the mean force most."""
        if self.kind == "common":
            return self.words
        grasps = fit.features.surrogate.grasps
        group = grasps.obj if self.kind == "by object" else grasps.tool
        change, force = self._find_change(fit)
        shares = {one: change[group == one].mean() / force[group == one].mean() for one in np.unique(group)}
        most = max(shares, key=lambda one: abs(shares[one]))
        name = f"object {grasps.objects[most]}" if self.kind == "by object" else grasps.tools[most]
        return f"{self.words}, most on {name} ({100.0 * shares[most]:+.0f} %)"

    def _find_change(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """What the pattern at its best changes in the bins of the force, and these, m x bins each."""
        place = len(fit.columns) - fit.n_effect_columns
        coefficients = solve_step(self.add_to(fit))[place : place + len(self.columns)]
        change = fit.features.unwhiten(np.tensordot(coefficients, self.columns, 1) / fit.weight)[:, :N_BINS]
        return change, fit.predict_features()[:, :N_BINS]


def rank_patterns(fit: Fit) -> list[Pattern]:
    """All patterns of a fit, the one with the greatest evidence first."""
    steps_n = fit.features.surrogate.predict_steps(fit.theta, fit.effects, fit.tool_factor)
    grasps = fit.features.surrogate.grasps
    found = [
        weigh(fit, what, how, fit.features.whiten(change * by[None, :, None]) * fit.weight)
        for what, change in list_changes(steps_n)
        for how, by in list_variates(grasps, steps_n)
    ]
    return sorted(found, key=lambda pattern: -pattern.nats)


def rank_single_patterns(fit: Fit) -> list[Pattern]:
    """Factors that every object, or every tool, has for itself, the one with the greater evidence first."""
    steps_n = fit.features.surrogate.predict_steps(fit.theta, fit.effects, fit.tool_factor)
    change = dict(list_changes(steps_n))[_FACTOR]
    by_object = [_weigh_groups(fit, _correlate(change, alike), "by object") for alike in ALIKE]
    found = [max(by_object, key=lambda pattern: pattern.nats), _weigh_groups(fit, change, "by tool")]
    return sorted(found, key=lambda pattern: -pattern.nats)


def compute_log_evidence(fits: Sequence[Fit]) -> np.ndarray:
    """Log evidence of the columns of fits that differ by their precision alone, but for a constant; one for each."""
    flat = fits[0].columns.reshape(len(fits[0].columns), -1)
    gram, slopes = flat @ flat.T, flat @ fits[0].residual.ravel() - fits[0].pull
    found = []
    for fit in fits:
        root = np.linalg.cholesky(gram + np.diag(fit.precision))
        along = solve_triangular(root, slopes, lower=True)
        found.append(0.5 * along @ along - np.log(np.diag(root)).sum() + 0.5 * np.log(fit.precision).sum())
    return np.array(found)


def list_variates(grasps: Grasps, steps_n: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """What a pattern may grow with (n each, mean 0, standard deviation 1), and the constant; less what never varies."""
    widths = np.array([object_shape(number).width_mm for number in grasps.objects])
    known = {
        "from the first repeat to later ones": [min(context.repeat, 1) for context in grasps.contexts],
        "from grasp to grasp of a tool": [context.tool_grasps for context in grasps.contexts],
        "over the batch": [context.batch_grasps for context in grasps.contexts],
        "with the width of the object": widths[grasps.obj],
        "with the force of the grasp": steps_n.max(axis=1),
    }
    found = [("in every grasp", np.ones(len(grasps.tool)))]
    for how, values in known.items():
        centred = np.asarray(values, dtype=float) - np.mean(values)
        if centred.std() > _LEAST_SD:
            found.append((f"growing {how}", centred / centred.std()))
    return found


def list_changes(steps_n: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Changes of features (k x m x f) by a force as large as the median peak, or twice the force, about each knot."""
    peak_n = float(np.median(steps_n.max(axis=1)))
    changes = (("a force", np.full_like(steps_n, peak_n)), (_FACTOR, steps_n))
    small, before = 1e-3, features_of_steps(steps_n)
    return [
        (what, np.array([(features_of_steps(steps_n + small * hat * change_n) - before) / small for hat in _hats()]))
        for what, change_n in changes
    ]


def _hats() -> np.ndarray:
    """Straight-sided functions over the steps of the lift, one at each knot, k x 120; constant beyond the last."""
    lift_mm = STEP_MM * (np.arange(N_STEPS) + 0.5)
    return np.array([np.interp(lift_mm, KNOTS_MM, row) for row in np.eye(len(KNOTS_MM))])


def _correlate(change: np.ndarray, alike: float) -> np.ndarray:
    """Changes about knots (k x m x f), mixed so that coefficients of equal weight have this correlation."""
    root = np.linalg.cholesky(alike + (1.0 - alike) * np.eye(len(change)))
    return np.asarray(np.tensordot(root.T, change, 1))


def _weigh_groups(fit: Fit, change: np.ndarray, kind: Kind) -> Pattern:
    """The pattern of changes about knots (k x m x f) that every object, or every tool, has for itself."""
    how = "another on each object" if kind == "by object" else "another for each tool"
    group = fit.features.obj if kind == "by object" else fit.features.tool
    rows = [fit.features.whiten(change * (group == one)[None, :, None]) for one in np.unique(group)]
    return weigh(fit, _FACTOR, how, np.concatenate(rows) * fit.weight, kind)


def weigh(fit: Fit, what: str, how: str, columns: np.ndarray, kind: Kind = "common") -> Pattern:
    """The pattern with its evidence, averaged over sizes."""
    nats = compute_log_evidence([fit.add_columns(columns, size) for size in SIZES]) - compute_log_evidence([fit])
    mean = float(np.logaddexp.reduce(nats) - np.log(len(SIZES)))
    return Pattern(what, how, columns, mean, SIZES[int(np.argmax(nats))], kind)

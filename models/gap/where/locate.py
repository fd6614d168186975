"""WHERE: everything that is reported about the place of the gap, from one set of residuals.

Findings are what the tests rejected and what is large enough to matter, as sentences with sizes and intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.gap.findings import WhereFinding
from fast.models.gap.where.permutation_tests import (
    BY_OBJECT,
    EVERYWHERE,
    ORDER,
    REPEAT,
    Hypothesis,
    TestTree,
    run_tests,
)
from fast.models.gap.where.residuals import AT, PHASES, WORDS, Residuals, jackknife
from fast.models.gap.where.strata import FAMILY, OBJECT_FEATURES
from fast.models.gap.where.tree import Leaf, grow_honest_tree
from fast.models.objects.catalogue import get_object
from fast.models.units import spell_name, spell_number

# Of the peak, beyond what numerical variants change: meshes and contact laws that the bank does not know make
# gaps of 2 % here and there in null worlds (docs/explanation/gap-discovery-limits.md).
LEAST_SHARE = 0.025
LEAST_DRIFT = 0.01  # meshes do not drift, so that less can be believed
MOST = 8
_MOST_OBJECTS = 3
_FACTOR_WORDS = {
    BY_OBJECT: "the object",
    REPEAT: "the repeat",
    ORDER: "the order of a tool's grasps",
    FAMILY: "the shape of the object",
    "object width": "the width of the object",
    "object height": "the height of the object",
}


@dataclass(frozen=True, eq=False)
class Where:
    """Where simulation and measurement disagree after theta was calibrated again."""

    findings: tuple[WhereFinding, ...]
    tests: TestTree


@dataclass(frozen=True)
class _Size:
    """A mean over some grasps: in N with a 90 % interval, and the same over the predicted peak."""

    effect_n: float
    ci90_n: tuple[float, float]
    share: float
    ci90: tuple[float, float]
    floor: float

    @property
    def is_large(self) -> bool:
        return abs(self.share) >= self.floor and self.ci90[0] * self.ci90[1] > 0


def locate(residuals: Residuals, seed: int = 0) -> Where:
    """Run the tests and make the findings of the grasps to learn from."""
    tests = run_tests(residuals, seed)
    return Where(find_where(residuals, tests, seed), tests)


def describe_silence(tests: TestTree) -> str:
    """Describe what is no larger than chance makes it, in a sentence: gaps of phases, what no phase goes with."""
    quiet = [WORDS[phase] for phase in tests.phases if not tests.rejected[phase]]
    asked = dict.fromkeys(h.factor for h in tests.factors)
    seen = {h.factor for phase in PHASES for h in tests.rejected[phase]}
    factors = [_FACTOR_WORDS.get(name, spell_name(name)) for name in asked if name not in seen and name != EVERYWHERE]
    parts = [f"a gap in {', '.join(quiet)}"] if quiet else []
    parts += [f"a change with {', '.join(factors)}"] if factors else []
    known = f"{'; '.join(parts)}. It may be there all the same."
    return f"No larger than chance makes it with these tools and objects: {known}" if parts else ""


def find_where(residuals: Residuals, tests: TestTree, seed: int = 0) -> tuple[WhereFinding, ...]:
    """Make the findings of every phase that was rejected, the largest first."""
    found: list[WhereFinding] = []
    for phase in PHASES:
        rejected = tests.rejected[phase]
        if rejected:
            found += _of_phase(residuals, phase, rejected, seed)
    found.sort(key=lambda f: -abs(f.share or 0.0))
    return _with_notes(tuple(found[:MOST]), residuals, tests)


def _of_phase(residuals: Residuals, phase: str, rejected: tuple[Hypothesis, ...], seed: int) -> list[WhereFinding]:
    by_factor = {h.factor: h for h in rejected}
    leaves = grow_honest_tree(
        residuals, phase, {*residuals.tool_features, *OBJECT_FEATURES[:2], FAMILY} & set(by_factor), seed
    )
    found: list[WhereFinding | None] = []
    if len(leaves) > 1 or EVERYWHERE in by_factor:
        found += [_of_leaf(residuals, phase, leaf, by_factor) for leaf in leaves]
    if BY_OBJECT in by_factor and not any(found):  # too small to matter over all of them, perhaps not on some
        found += _of_objects(residuals, phase, by_factor[BY_OBJECT])
    for factor in (REPEAT, ORDER):
        if factor in by_factor:
            found.append(_of_history(residuals, phase, by_factor[factor]))
    return [f for f in found if f is not None]


def _of_leaf(residuals: Residuals, phase: str, leaf: Leaf, rejected: dict[str, Hypothesis]) -> WhereFinding | None:
    size = _size(residuals, phase, leaf.grasps, leaf.honest if leaf.splits else None)
    asked = {s.feature if s.feature in rejected else FAMILY for s in leaf.splits} or {EVERYWHERE}
    tested = [rejected[name] for name in asked if name in rejected]
    return _finding(size, phase, leaf.words, tested)


def _of_objects(residuals: Residuals, phase: str, tested: Hypothesis) -> list[WhereFinding | None]:
    """Return the objects with the largest gaps, where no word for them was found."""
    sizes = [(o, _size(residuals, phase, residuals.obj == o)) for o in np.unique(residuals.obj)]
    sizes.sort(key=lambda pair: -abs(pair[1].share))
    return [
        _finding(size, phase, f"for the {get_object(residuals.objects[o]).name}", [tested])
        for o, size in sizes[:_MOST_OBJECTS]
    ]


def _finding(size: _Size, phase: str, stratum: str, tested: list[Hypothesis]) -> WhereFinding | None:
    if not size.is_large:
        return None
    verb = "under-predicts" if size.share > 0 else "over-predicts"
    words = _describe_size(size.effect_n, size.share, size.ci90)
    return _make_finding(f"The simulator {verb} {WORDS[phase]} by {words} {stratum}.", phase, stratum, size, tested)


def _make_finding(sentence: str, phase: str, stratum: str, size: _Size, tested: Sequence[Hypothesis]) -> WhereFinding:
    return WhereFinding(
        sentence=sentence,
        phase=phase,
        stratum=stratum,
        effect_size_n=size.effect_n,
        ci90=size.ci90_n,
        share=size.share,
        p_value=min((h.p_value for h in tested), default=None),
        q_value=max((h.q_value for h in tested), default=None),
    )


def _size(residuals: Residuals, phase: str, grasps: np.ndarray, honest: float | None = None) -> _Size:
    """Average a phase over some grasps; `honest` takes the place of its relative mean and moves all with it."""
    place = PHASES.index(phase)
    values = np.column_stack([residuals.phases_n[:, place], residuals.relative[:, place]])
    chosen = grasps & np.isfinite(values[:, 0])
    numerical = np.nanmean(residuals.numerical_relative[:, chosen, place], axis=1)
    rows = values[chosen]
    tool, obj = residuals.tool[chosen], residuals.obj[chosen]
    value, low, high = jackknife(lambda mask: rows[mask].mean(axis=0) if mask.any() else np.full(2, np.nan), tool, obj)
    if honest is not None and value[1] != 0:
        # What was found where it was looked for is too large; the designs that did not choose say how much.
        shift = np.array([value[0] / value[1] * (honest - value[1]), honest - value[1]])
        value, low, high = value + shift, low + shift, high + shift
    floor = LEAST_SHARE + float(np.abs(numerical).max(initial=0.0))
    return _Size(
        float(value[0]), (float(low[0]), float(high[0])), float(value[1]), (float(low[1]), float(high[1])), floor
    )


def _of_history(residuals: Residuals, phase: str, tested: Hypothesis) -> WhereFinding | None:
    """Tell how much the gap changes from the first to the last repeat, or from early to late grasps."""
    place = PHASES.index(phase)
    is_repeat = tested.factor == REPEAT
    x = residuals.repeat.astype(float) if is_repeat else residuals.order
    low_x, high_x = (x.min(), x.max()) if is_repeat else np.quantile(x, (0.1, 0.9))
    chosen = np.isfinite(residuals.relative[:, place])
    rows = np.column_stack([residuals.phases_n[:, place], residuals.relative[:, place]])[chosen]
    tool, obj, x = residuals.tool[chosen], residuals.obj[chosen], x[chosen]
    cell = tool * len(residuals.objects) + obj

    def change(mask: np.ndarray) -> np.ndarray:
        groups = (cell[mask],) if is_repeat else (tool[mask], obj[mask])
        y, x_left = rows[mask], x[mask]
        for _ in range(1 if is_repeat else 20):
            for group in groups:
                counts = np.maximum(np.bincount(group), 1)
                x_left = x_left - (np.bincount(group, x_left) / counts)[group]
                y = y - np.column_stack([np.bincount(group, column) / counts for column in y.T])[group]
        return np.asarray((high_x - low_x) * (x_left @ y) / max(float(x_left @ x_left), 1e-12))

    value, low, high = jackknife(change, tool, obj)
    size = _Size(
        float(value[0]), (float(low[0]), float(high[0])), float(value[1]), (float(low[1]), float(high[1])), LEAST_DRIFT
    )
    if not size.is_large:
        return None
    verb = "rises" if size.share > 0 else "falls"
    span = "from the first to the last repeat" if is_repeat else "from early to late grasps of a tool"
    words = _describe_size(size.effect_n, size.share, size.ci90)
    sentence = f"Measured force {AT[phase]} {verb} by {words} {span}, which the simulator does not."
    return _make_finding(sentence, phase, span, size, [tested])


def _with_notes(found: tuple[WhereFinding, ...], residuals: Residuals, tests: TestTree) -> tuple[WhereFinding, ...]:
    """Add to the first sentence where nothing was found: before which phase, and over repeats."""
    if not found:
        return found
    notes = []
    first = min(PHASES.index(f.phase) for f in found)
    if first > 0:
        notes.append(
            "nothing before that" if found[0].phase == PHASES[first] else f"nothing before {WORDS[PHASES[first]]}"
        )
    if not any(h.factor == REPEAT for phase in PHASES for h in tests.rejected[phase]) and residuals.repeat.max() > 0:
        notes.append("the same in all repeats")
    lead = found[0].sentence.removesuffix(".") + "".join(f"; {note}" for note in notes) + "."
    return (found[0].model_copy(update={"sentence": lead}), *found[1:])


def _describe_size(effect_n: float, share: float, interval: tuple[float, float]) -> str:
    """Describe a size in N and in per cent of the peak, with the interval in per cent, signs left to the sentence.

    One tool or object alone gives no interval.
    """
    low, high = sorted(np.sign(share or 1.0) * np.array(interval))
    told = f" [{100 * low:.0f}, {100 * high:.0f}]" if high > low else ", no interval"
    return f"{spell_number(abs(effect_n))} N ({abs(100 * share):.0f} % of the peak{told})"

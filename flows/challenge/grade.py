"""Grading: answers against opened keys, as tables of figures, each with its number of worlds and a 95 % interval.

What a world hides has a *visible* size: the share of the force that is left of it once the simulator's constants and
the prints' moduli are fitted, without the cell (a tool on an object) that it changes most. Beside shares of alarms
stands their bound: what the likelihood ratio, which knows law and size of what is hidden, reaches at 2 % false alarms.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import betaincinv

from fast.flows.challenge.answers import Answers, WorldAnswer, read_forces
from fast.flows.challenge.keys import SealedKey, find_keys, open_keys
from fast.flows.challenge.manifest import NOT_LISTED, Manifest, read_families
from fast.flows.challenge.public import PUBLIC
from fast.models.units import spell_share

Rows = list[dict[str, Any]]
NOTHING = 0.01  # of the force: what is visible by less is nothing to these data
NAMEABLE = 0.02  # from here on a name is expected
CLOSABLE = 0.1  # of the error: a gap of which less can be closed is not counted
SIZES = (0.01, 0.02, 0.04, 0.1)
SILENT = (0.04, 0.1)
_BINS = (0.0, 0.25, 0.5, 0.75, 1.0)
_N_RESAMPLED = 2000


@dataclass(frozen=True, eq=False)
class Graded:
    """A world's answer with its key. family: of what is hidden, empty where the list lacks it or nothing is hidden.

    said: family of the named effect, empty without a name. after_n: error of the foretold forces, N; None without any.
    """

    answer: WorldAnswer
    sealed: SealedKey
    family: str
    said: str
    after_n: float | None = None

    @property
    def group(self) -> str:
        """What kind of world it is."""
        return self.sealed.key.group

    @property
    def visible(self) -> float:
        """Visible size of what is hidden, of the force."""
        return max((hidden.spread_strength for hidden in self.sealed.key.effects), default=0.0)

    @property
    def closable_n(self) -> float:
        """How much of the error could be closed at all, N."""
        return self.sealed.before_n - self.sealed.twin_n

    @property
    def closed(self) -> float | None:
        """Share that was closed of what could be; None where nothing can, or nothing was foretold."""
        if self.after_n is None or self.visible < NAMEABLE or self.closable_n < CLOSABLE * self.sealed.before_n:
            return None
        return (self.sealed.before_n - self.after_n) / self.closable_n


def grade_answers(path: Path, challenge: Path, keys: Path | None = None) -> tuple[Answers, list[Graded]]:
    """Grade answers of a file with the keys of the worlds; nothing is opened before the answers are found whole.

    Raises:
        UsageError: the answers are of another challenge or not whole, or the keys do not fit.
    """
    answers = Answers.read(path)
    answers.check(challenge, str(path))
    foretold = read_forces(path.parent / answers.forces, challenge) if answers.forces else {}
    is_public = Manifest.read(challenge) == Manifest.read(PUBLIC)  # a copy of these has no keys beside it
    sealed, withheld = open_keys(keys or find_keys(PUBLIC if is_public else challenge), challenge)
    families, by_world = read_families(challenge), {one.world: one for one in answers.answers}
    graded = []
    for key in sealed:
        answer, effects = by_world[key.world], key.key.names
        family = families.get(effects[0], "") if effects and key.key.group != "unlisted" else ""
        after_n = _measure_error(foretold[key.world], withheld[key.world]) if key.world in foretold else None
        said = answer.effect if answer.effect == NOT_LISTED else families.get(answer.effect, "")
        graded.append(Graded(answer, key, family, said, after_n))
    return answers, graded


def make_tables(graded: Sequence[Graded]) -> dict[str, Rows]:
    """Make tables: figures; stated and true probabilities; every world with what it hid and what was said."""
    return {"figures": _list_figures(graded), "probabilities": _list_bins(graded), "worlds": _list_worlds(graded)}


def describe_doubts(graded: Sequence[Graded]) -> list[str]:
    """Say which answers have `missing` and `probability` on different sides of even; they count as they stand."""
    torn = [one.answer for one in graded if (one.answer.probability - 0.5) * (one.answer.missing - 0.5) < 0.0]
    if not torn:
        return []
    told = ", ".join(f"{one.world} (missing: {str(one.missing).lower()}, {one.probability:g})" for one in torn)
    return [
        f"`missing` and `probability` contradict each other in {told}: alarms count by the one, the Brier score by the "
        "other; correct them unless your line of an alarm is not at 0.5."
    ]


def clopper_pearson(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a share of which k of n were seen."""
    low = float(betaincinv(k, n - k + 1, 0.025)) if k else 0.0
    high = float(betaincinv(k + 1, n - k, 0.975)) if k < n else 1.0
    return low, high


def _measure_error(foretold: Mapping[str, np.ndarray], measured: Mapping[str, np.ndarray]) -> float:
    rest_n = np.array([foretold[name] - force_n for name, force_n in measured.items()])
    return float(np.sqrt(np.mean(rest_n**2)))


def _list_figures(graded: Sequence[Graded]) -> Rows:
    hidden = [one for one in graded if one.group != "null"]
    named = [one for one in hidden if one.visible >= NAMEABLE and one.answer.missing]
    listed, unlisted = [one for one in named if one.family], [one for one in named if not one.family]
    rows = [
        _count(
            "false alarms where nothing is hidden",
            [one for one in graded if one.group == "null"],
            lambda one: one.answer.missing,
        )
    ]
    for words, is_listed in (("a listed cause", True), ("a cause that is not listed", False)):
        own = [one for one in hidden if bool(one.family) is is_listed]
        for size in SIZES:
            seen = [one for one in own if one.visible >= size]
            row = _count(f"alarm, {words} of {spell_share(size)} or more", seen, lambda one: one.answer.missing)
            rows.append(row | {"bound": _see_at_best(seen)})
    for size in SILENT:
        large = [one for one in hidden if one.visible >= size]
        row, power = _count(f"“nothing” said at {spell_share(size)} or more", large, _is_silent), _see_at_best(large)
        rows.append(row | {"bound": None if power is None else round(1.0 - power, 3)})
    rows.append(_count("family right, given an alarm", listed, lambda one: one.said == one.family))
    rows.append(
        _count("wrong family for a cause that is not listed", unlisted, lambda one: one.said not in ("", NOT_LISTED))
    )
    misses = [(one.answer.probability - _is_missing(one)) ** 2 for one in graded]
    closed = [one.closed for one in graded if one.closed is not None]
    cost = [one.answer.cpu_s for one in graded if one.answer.cpu_s is not None]
    rows.append(_summarise("Brier score of the stated probability", misses, np.mean))
    rows.append(_summarise("gap closed of what can be closed, median", closed, np.median))
    rows.append(_summarise("gap closed, worst quarter", closed, lambda values: np.quantile(values, 0.25)))
    rows.append(_summarise("CPU seconds a world", cost, np.mean))
    return rows


def _see_at_best(worlds: Sequence[Graded]) -> float | None:
    """Return the share of these worlds in which the likelihood ratio sees something; None of none."""
    return round(float(np.mean([one.sealed.bound for one in worlds])), 3) if worlds else None


def _is_silent(one: Graded) -> bool:
    return not one.answer.missing


def _is_missing(one: Graded) -> bool:
    """Return whether something is missing that these data could show."""
    return one.visible >= NOTHING


def _count(figure: str, worlds: Sequence[Graded], counts: Callable[[Graded], bool]) -> dict[str, Any]:
    k, n = sum(counts(one) for one in worlds), len(worlds)
    low, high = clopper_pearson(k, n) if n else (None, None)
    return _row(figure, n, k / n if n else None, low, high) | {"seen": k}


def _summarise(figure: str, values: Sequence[float], of: Callable[[Any], Any]) -> dict[str, Any]:
    """Compute a statistic of worlds with a bootstrap interval over them."""
    if not values:
        return _row(figure, 0, None, None, None)
    rng, known = np.random.default_rng(0), np.array(values)
    drawn = [float(of(known[rng.integers(len(known), size=len(known))])) for _ in range(_N_RESAMPLED)]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return _row(figure, len(values), float(of(known)), float(low), float(high))


def _row(figure: str, n: int, value: float | None, low: float | None, high: float | None) -> dict[str, Any]:
    values = {"value": value, "low95": low, "high95": high}
    return {"figure": figure, "worlds": n} | {k: None if v is None else round(v, 3) for k, v in values.items()}


def _list_bins(graded: Sequence[Graded]) -> Rows:
    """List how often something is missing where a probability was stated."""
    rows: Rows = []
    for low, high in zip(_BINS, _BINS[1:], strict=False):
        own = [one for one in graded if low <= one.answer.probability < high + (high == 1.0)]
        if own:
            stated = float(np.mean([one.answer.probability for one in own]))
            row = _count(f"stated {low:g} to {high:g}", own, _is_missing)
            rows.append({"figure": row.pop("figure"), "stated": round(stated, 3)} | row)
    return rows


def _list_worlds(graded: Sequence[Graded]) -> Rows:
    return [
        {
            "world": one.answer.world,
            "hidden": " ".join(one.sealed.key.names) or "nothing",
            "visible_percent": round(100.0 * one.visible, 1),
            "said": "missing" if one.answer.missing else "nothing",
            "probability": one.answer.probability,
            "effect": one.answer.effect,
            "closed": None if one.closed is None else round(one.closed, 2),
        }
        for one in graded
    ]

"""What many races say: a table of the strategies, and each against the reference on the same seeds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import ttest_rel, wilcoxon

from flows.scientist.landscape_run import Course

Rows = list[dict[str, Any]]
GOAL = 0.97  # of the optimum


def summary_rows(courses: Sequence[Course]) -> Rows:
    """One row a strategy: what its last tools and its best tool reach, and how soon; N, mean and sd over the races."""
    return [_summary(name, _of(courses, name)) for name in _names(courses)]


def paired_rows(courses: Sequence[Course], reference: str) -> Rows:
    """One row for each other strategy: its difference to the reference in the same races, positive where it is better.

    `p` is of a paired t test of the mean regret, `p_wilcoxon` of the signed ranks; both two-sided. `match_share`:
    rounds the reference needs to equal what the other has at its end, as a share of all rounds, median.
    """
    races = _by_race(courses, reference)
    rows = []
    for name in _names(courses):
        pairs = [(races[key], other) for key, other in _by_race(courses, name).items() if key in races]
        if name != reference and pairs:
            rows.append(_paired(name, pairs))
    return rows


def _summary(name: str, courses: list[Course]) -> dict[str, Any]:
    last, best = [c.batch_mean_n[-1] for c in courses], [c.best_n[-1] for c in courses]
    regret = [c.optimum_n - c.best_n[-1] for c in courses]
    reached = [c.rounds_to(GOAL) for c in courses]
    return {
        "strategy": name,
        "n_races": len(courses),
        "last_batch_n": float(np.mean(last)),
        "last_batch_sd_n": float(np.std(last, ddof=1)) if len(last) > 1 else None,
        "best_n": float(np.mean(best)),
        "final_regret_n": float(np.mean(regret)),
        "worst_regret_n": float(np.max(regret)),
        "mean_regret_n": float(np.mean([c.mean_regret_n for c in courses])) if len(courses[0].best_n) > 1 else None,
        "reached_97_percent": int(np.isfinite(reached).sum()),
        "rounds_to_97_percent": float(np.median(reached)) if np.isfinite(np.median(reached)) else None,
        "n_measured": courses[0].n_measured,
        "n_simulated": courses[0].n_simulated,
        "cpu_s": float(np.mean([c.cpu_s for c in courses])),
    }


def _paired(name: str, pairs: list[tuple[Course, Course]]) -> dict[str, Any]:
    last = np.array([other.batch_mean_n[-1] - reference.batch_mean_n[-1] for reference, other in pairs])
    best = np.array([other.best_n[-1] - reference.best_n[-1] for reference, other in pairs])
    matched = [_rounds_to_match(reference, other) for reference, other in pairs]
    row = {
        "strategy": name,
        "n_pairs": len(pairs),
        "last_batch_wins": int((last > 0).sum()),
        "best_wins": int((best > 0).sum()),
        "last_batch_gain_n": float(last.mean()),
        "best_gain_n": float(best.mean()),
        "match_share": float(np.median(matched)) if np.isfinite(np.median(matched)) else None,
        "mean_regret_gain_n": None,
        "gain_ci95_n": None,
        "p": None,
        "p_wilcoxon": None,
    }
    if all(len(course.best_n) == len(pairs[0][0].best_n) for pair in pairs for course in pair):
        gain = np.array([reference.mean_regret_n - other.mean_regret_n for reference, other in pairs])
        row["mean_regret_gain_n"] = float(gain.mean())
        if len(gain) > 1 and np.ptp(gain) > 0:
            test = ttest_rel([r.mean_regret_n for r, _ in pairs], [o.mean_regret_n for _, o in pairs])
            low, high = test.confidence_interval(0.95)
            row["gain_ci95_n"] = f"{low:.2f} to {high:.2f}"
            row["p"], row["p_wilcoxon"] = float(test.pvalue), float(wilcoxon(gain).pvalue)
    return row


def _rounds_to_match(reference: Course, other: Course) -> float:
    """Rounds until the reference's best equals the final one of the other, as a share of all; infinity for never."""
    matched = np.flatnonzero(np.array(reference.best_n) >= other.best_n[-1])
    return float(matched[0]) / (len(reference.best_n) - 1) if len(matched) else float("inf")


def _names(courses: Sequence[Course]) -> list[str]:
    return list(dict.fromkeys(course.strategy for course in courses))


def _of(courses: Sequence[Course], name: str) -> list[Course]:
    return [course for course in courses if course.strategy == name]


def _by_race(courses: Sequence[Course], name: str) -> dict[tuple[str, int], Course]:
    return {(course.landscape, course.seed): course for course in _of(courses, name)}

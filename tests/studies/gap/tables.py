"""Figures of gap discovery from answers to worlds of known truth, each with its number of worlds and an interval."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta

from flows.benchmarks.base import Rows, Tables
from tests.studies.gap.answers import Answer, Closing
from tests.studies.gap.worlds import WorldKey

VISIBLE = 0.02  # from this visible strength on, an effect is expected to be found
_SURE = 0.9

Judged = tuple[WorldKey, Answer, bool]


def clopper_pearson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a share of which k of n were seen."""
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


def gap_tables(worlds: Sequence[Judged]) -> Tables:
    """Tables of figures, of every effect, and of the gap closed."""
    return {"figures": _figures(worlds), "by effect": _by_effect(worlds), "gap closed": _closed(worlds)}


def _figures(worlds: Sequence[Judged]) -> Rows:
    own = [(key, said) for key, said, left_out in worlds if not left_out]
    singles = [(key, said) for key, said in own if key.group == "single"]
    visible = [(key, said) for key, said in singles if key.effects[0].visible_strength >= VISIBLE]
    alarmed = [(key, said) for key, said in visible if said.is_alarm]
    spoken = [(key, said) for key, said in alarmed if said.rounds[0].kind in ("effect", "set")]
    removed = [
        (key, said)
        for key, said, left_out in worlds
        if left_out and key.effects[0].visible_strength >= VISIBLE and said.is_alarm
    ]
    unlisted = [(k, s) for k, s in own if k.group == "unlisted" and k.effects[0].visible_strength >= VISIBLE]
    open_set = [*removed, *((key, said) for key, said in unlisted if said.is_alarm)]
    aliases = [(key, said) for key, said in own if key.group == "alias"]
    pairs = [(key, said) for key, said in own if key.group == "pair" and _both_visible(key)]
    sure = [(key, said) for key, said in own if said.rounds[0].kind == "effect" and said.rounds[0].probability >= _SURE]
    rows = [
        _row("false alarms, null worlds", own, lambda k, s: s.is_alarm, "<= 5 %", "null"),
        _row("false alarms, nastier nuisance", own, lambda k, s: s.is_alarm, "", "nasty null"),
        _row("alarm, visible >= 2 %", visible, lambda k, s: s.is_alarm, ">= 95 %"),
        _row("right name or its set first, given an alarm", alarmed, _is_top, ">= 90 %"),
        _row("right name, given a single name", [p for p in spoken if p[1].rounds[0].kind == "effect"], _is_top, ""),
        _row("truth in the name or set, given one", spoken, _is_held, ">= 95 %"),
        _row("unknown though in the catalogue", alarmed, _is_unknown, ""),
        _row("unknown, truth not in the catalogue", open_set, _is_unknown, ">= 80 %"),
        _row("forced wrong name, same worlds", open_set, lambda k, s: s.rounds[0].kind == "effect", "<= 10 %"),
        _row("aliases of theta not named", aliases, lambda k, s: s.rounds[0].kind in ("none", "unknown"), "100 %"),
        _row("two effects, both named or in sets", pairs, _has_both, ">= 60-80 %"),
        _row("two effects, at least one", pairs, _has_one, ""),
        _row("stated probability >= 0.9 is right", sure, _is_top, ">= 90 %"),
    ]
    sizes = [len(said.rounds[0].effects) for _, said in spoken]
    seconds = [said.cpu_s for _, said in own]
    rows.append({"figure": "mean size of name or set", "worlds": len(sizes), "value": _mean(sizes), "target": "<= 2"})
    rows.append({"figure": "CPU seconds a world", "worlds": len(seconds), "value": _mean(seconds), "target": "<= 4200"})
    return rows


def _row(
    figure: str,
    worlds: Sequence[tuple[WorldKey, Answer]],
    counts: Callable[[WorldKey, Answer], bool],
    target: str,
    group: str | None = None,
) -> dict[str, object]:
    chosen = [(key, said) for key, said in worlds if group is None or key.group == group]
    k, n = sum(counts(key, said) for key, said in chosen), len(chosen)
    row: dict[str, object] = {"figure": figure, "worlds": n, "target": target}
    if n:
        low, high = clopper_pearson(k, n)
        row |= {"seen": k, "value": k / n, "low95": round(low, 3), "high95": round(high, 3)}
    return row


def _is_top(key: WorldKey, said: Answer) -> bool:
    """The first of a name or set is a hidden effect; of a set, by probability."""
    first = said.rounds[0]
    if first.kind not in ("effect", "set") or not first.effects:
        return False
    best = max(first.effects, key=lambda name: first.candidates.get(name, 0.0))
    return best in key.names


def _is_held(key: WorldKey, said: Answer) -> bool:
    return bool(set(said.rounds[0].effects) & set(key.names))


def _is_unknown(key: WorldKey, said: Answer) -> bool:
    return said.rounds[0].kind == "unknown"


def _heard(said: Answer) -> set[str]:
    return {name for one in said.rounds for name in one.effects}


def _has_both(key: WorldKey, said: Answer) -> bool:
    return set(key.names) <= _heard(said)


def _has_one(key: WorldKey, said: Answer) -> bool:
    return bool(set(key.names) & _heard(said))


def _both_visible(key: WorldKey) -> bool:
    return all(hidden.visible_strength >= VISIBLE for hidden in key.effects)


def _by_effect(worlds: Sequence[Judged]) -> Rows:
    """Every hidden effect: how visible it was, and what was said."""
    rows: Rows = []
    for key, said, left_out in worlds:
        if key.group in ("single", "unlisted", "alias") and not left_out:
            hidden = key.effects[0]
            first = said.rounds[0]
            rows.append(
                {
                    "effect": hidden.effect,
                    "raw_percent": round(100.0 * hidden.raw_strength, 1),
                    "visible_percent": round(100.0 * hidden.visible_strength, 1),
                    "said": first.kind,
                    "effects": "+".join(first.effects),
                    "probability": round(first.probability, 2),
                }
            )
    return sorted(rows, key=lambda row: (row["effect"], row["raw_percent"]))


def _closed(worlds: Sequence[Judged]) -> Rows:
    """Medians over worlds with a right name, on designs and objects that were held out.

    closed_to_null: of what is above the error that null worlds leave (`null_n`), which has the scatter of prints in it.
    """
    rows: Rows = []
    null_n = _median([said.closing.after_n for key, said, _ in worlds if key.group == "null" and said.closing])
    for label, is_right in (("right name", True), ("other answers", False)):
        found = [
            said.closing
            for key, said, left_out in worlds
            if not left_out and key.group == "single" and said.closing is not None
            if (key.names[0] in said.named) is is_right and key.effects[0].visible_strength >= VISIBLE
        ]
        if not found:
            continue
        shares = [(c.before_n - c.after_n) / max(c.before_n - c.floor_n, 1e-9) for c in found]
        ratios = [
            (c.before_n - c.after_n) / (c.before_n - c.oracle_n)
            for c in found
            if c.oracle_n is not None and c.before_n - c.oracle_n > 0.02 * c.before_n
        ]
        rows.append(
            {
                "worlds": label,
                "n": len(found),
                "before_n": _median([c.before_n for c in found]),
                "after_n": _median([c.after_n for c in found]),
                "floor_n": _median([c.floor_n for c in found]),
                "closed_to_floor": _median(shares),
                "null_n": null_n,
                "closed_to_null": _share_closed(found, null_n),
                "of_oracle": _median(ratios),
            }
        )
    return rows


def _share_closed(found: Sequence[Closing], floor_n: float | None) -> float | None:
    """The share of the median error above a floor that the median world closed; None if it was below."""
    before_n, after_n = (float(np.median([getattr(c, name) for c in found])) for name in ("before_n", "after_n"))
    if floor_n is None or before_n <= floor_n:
        return None
    return round((before_n - after_n) / (before_n - floor_n), 3)


def _mean(values: Sequence[float]) -> float | None:
    return round(float(np.mean(values)), 2) if values else None


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None

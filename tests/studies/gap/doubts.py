"""How often the likelihood doubts that nothing is missing, by what a world hides; worlds from a secret, judged once.

Lines are those of one rehearsal per number of designs and objects: of the first world that hides nothing.
"""

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fast.models.gap.evidence.candidates import weigh_candidates
from fast.models.gap.evidence.likelihood import Problem, fit_evidence
from fast.models.gap.evidence.rehearsal import Rehearsal, rehearse
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.gap.development import open_panels
from tests.studies.gap.small import read_small
from tests.studies.gap.truth import results_folder
from tests.studies.gap.worlds import Group, Worlds
from tests.studies.traces.anomalies import wilson

PANEL = Path(__file__).parents[2] / "data" / "gap-panel.npz"  # 9 designs, 7 objects, 23 sets of true grasps; opened
PUBLIC_SEED = 7
N_WORLDS_OF: dict[Group, int] = {"null": 50, "single": 60, "unlisted": 40}
N_REHEARSED = 120
VISIBLE = (0.01, 0.02, 0.04, 0.1)


@dataclass(frozen=True)
class Doubted:
    """A world and what the likelihood says of it. visible: without the cell that the effect changes most."""

    group: Group
    hidden: str
    visible: float
    nats: float
    omnibus: float
    is_alarm: bool


def measure_doubts(options: Options) -> Tables:
    """Alarms of the likelihood: on the panel for development from a public seed, or on a study's own from a secret."""
    if options.results is None:
        worlds = Worlds(*read_small(PANEL), PUBLIC_SEED, has_other_laws=True)
    else:
        worlds = Worlds(*open_panels(results_folder(options)), secrets.token_hex(16), has_other_laws=True)
    return {"doubts": count_doubts(list_doubts(worlds, N_WORLDS_OF, options.tell))}


def list_doubts(worlds: Worlds, counts: dict[Group, int], tell: Callable[[str], None]) -> list[Doubted]:
    """Draw, weigh and judge so many worlds of each group."""
    rehearsal = _rehearse(worlds)
    tell(f"lines: {rehearsal.nats_line:.1f} nats, {rehearsal.omnibus_line:.2f} left as a whole")
    found = []
    for group, n in counts.items():
        for number in range(n):
            key = worlds.draw(group, number)
            usable = worlds.problem(key).usable
            fit = fit_evidence(Problem.of(usable))
            nats = weigh_candidates(fit, usable.names)[0].nats
            alarm = rehearsal.is_alarm(nats, fit.omnibus)
            visible = max((hidden.spread_strength for hidden in key.effects), default=0.0)
            found.append(Doubted(group, " ".join(key.names), visible, nats, fit.omnibus, alarm))
        tell(f"{group}: {n} worlds")
    return found


def count_doubts(doubted: Sequence[Doubted]) -> Rows:
    """Alarms by group and by what is visible at least, with 95 % intervals."""
    rows = []
    for group in dict.fromkeys(one.group for one in doubted):
        for visible in (0.0,) if group == "null" else VISIBLE:
            own = [one for one in doubted if one.group == group and one.visible >= visible]
            n_alarms = sum(one.is_alarm for one in own)
            low, high = wilson(n_alarms, len(own)) if own else (np.nan, np.nan)
            row = {"group": group, "visible": visible, "alarms": n_alarms, "of": len(own), "low": low, "high": high}
            rows.append(row)
    return rows


def _rehearse(worlds: Worlds) -> Rehearsal:
    usable = worlds.problem(worlds.draw("null", 0)).usable
    return rehearse(Problem.of(usable), usable.names, N_REHEARSED, seed=0)

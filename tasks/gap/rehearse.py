"""The rehearsal of a panel: made-up worlds of its tools, objects, repeats and noise."""

from collections.abc import Callable, Sequence

from fast.models.gap.data import GapData
from fast.models.gap.evidence.likelihood import Problem
from fast.models.gap.evidence.rehearsal import Panel, Rehearsal, rehearse
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE


def rehearse_panel(
    data: GapData,
    effects: Sequence[EffectValue],
    n: int,
    n_workers: int = 1,
    progress: Callable[[str], None] | None = None,
) -> Rehearsal:
    """The rehearsal of the panel of a search, n worlds; effects: of its simulator.

    Raises:
        FastError: a process died.
    """
    usable, known = data.usable, {value.effect for value in effects}
    families = {name: CATALOGUE[name].family for name in usable.names if name not in known}
    return rehearse(Panel(Problem.of(usable, effects, data.facts), families), n, n_workers, progress)

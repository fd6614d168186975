"""What another stroke or placement changes, simulated for each hypothesis on a few cells."""

from collections.abc import Sequence

import numpy as np

from fast.models.gap.ask.hypotheses import Hypothesis
from fast.models.gap.ask.predict import Moved, Pair
from fast.models.gap.ask.settings import Setting
from fast.models.gap.bank.sensor_effects import N_LEAD, read_lead
from fast.models.gap.grasps import Cells, Grasps, Target
from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_cells, read_simulated_steps
from fast.tasks.gap.calibrate import SearchInputs
from fast.tasks.simulation.plan import SimulationPlan

MOST_SIMULATIONS = 240  # minutes of one core
QUESTION = "what other strokes and placements would show"
_FEWEST_CELLS = 2


def choose_cells(
    cells: Sequence[tuple[int, int]], hypotheses: Sequence[Hypothesis], settings: Sequence[Setting]
) -> list[tuple[int, int]]:
    """Choose as many of the cells as may be simulated for all hypotheses and settings, spread over them."""
    n_versions = len({_key(one) for one in hypotheses})
    n = max(MOST_SIMULATIONS // (n_versions * (len(settings) + 1)), _FEWEST_CELLS)
    places = np.unique(np.linspace(0, len(cells) - 1, min(n, len(cells))).round().astype(int))
    return [cells[place] for place in places]


def simulate_moved(search: SearchInputs, hypotheses: Sequence[Hypothesis], pairs: Sequence[Pair]) -> Moved:
    """Simulate by what changed grasps of pairs differ from usual ones, for each hypothesis; without what failed."""
    pairs = [pair for pair in pairs if not pair.setting.is_timing]
    if not pairs:
        return {}
    grasps = search.data.grasps
    cells = _list_cells(grasps, pairs)
    versions = {_key(one): _make_version(search.base, one) for one in hypotheses}
    plans: list[SimulationPlan] = [plan for version in versions.values() for plan in plan_cells([version], cells)]
    search.simulate(QUESTION, plans)
    found = {}
    for one in hypotheses:
        version = versions[_key(one)]
        steps_n = read_simulated_steps(search.lake, [version], cells)[:, :, 0]
        lead_n = read_simulated_steps(search.lake, [version], cells, of_trace=read_lead, n=N_LEAD)[:, :, 0]
        with_lead_n = np.concatenate([lead_n, steps_n], axis=-1)
        stiffer = version.theta.young_modulus_mpa / one.fit.features.surrogate.centre.young_modulus_mpa
        for pair in pairs:
            usual, changed = (
                with_lead_n[pair.tool, cells.targets.index(target)] for target in _list_targets(grasps, pair)
            )
            if np.isfinite(usual).all() and np.isfinite(changed).all():
                found[one.name, pair] = (changed - usual) / stiffer
    return found


def _key(hypothesis: Hypothesis) -> str:
    """Return a key: forms of one hypothesis, and what differs in no simulated effect, are simulated once."""
    solid = [value.model_dump() for value in hypothesis.fit.effects if CATALOGUE[value.effect].bank_runs]
    return f"{[float(f'{x:.3g}') for x in hypothesis.fit.theta]} {solid}"


def _make_version(base: SimulatorVersion, hypothesis: Hypothesis) -> SimulatorVersion:
    """Make the simulator at a hypothesis' theta with its simulated effects, rounded: nothing is simulated twice."""
    modulus, friction, ratio = (float(f"{x:.3g}") for x in hypothesis.fit.theta)
    effects = tuple(
        EffectValue(effect=value.effect, parameters={name: float(f"{x:.3g}") for name, x in value.parameters.items()})
        for value in hypothesis.fit.effects
        if CATALOGUE[value.effect].bank_runs
    )
    theta = Theta(young_modulus_mpa=modulus, friction=friction, poisson_ratio=ratio)
    return base.model_copy(update={"theta": theta, "effects": effects})


def _list_targets(grasps: Grasps, pair: Pair) -> tuple[Target, Target]:
    object_id = grasps.objects[pair.obj]
    return Target(object_id, grasps.base_setup), Target(object_id, pair.setting.setup, pair.setting.placement)


def _list_cells(grasps: Grasps, pairs: Sequence[Pair]) -> Cells:
    targets = list(dict.fromkeys(target for pair in pairs for target in _list_targets(grasps, pair)))
    is_wanted = np.zeros((len(grasps.tools), len(targets)), dtype=bool)
    for pair in pairs:
        for target in _list_targets(grasps, pair):
            is_wanted[pair.tool, targets.index(target)] = True
    return Cells(grasps.designs, tuple(targets), is_wanted)

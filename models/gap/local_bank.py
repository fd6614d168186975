"""The bank around a fitted theta: where it lies, and which effects are worth simulating in it.

Far from the centre of the wide bank, what an effect changes is off by a fifth, and the surface of theta by 0.2 N. So
the wide bank only proposes: theta, and the effects that may explain the gap. They are simulated again around that
theta, in a grid small enough for its surface, and there the answer is found. An effect that is named gets a run at its
fitted parameters, too: between runs that are far apart, what it changes is only interpolated.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fast.models.gap.bank.bank import CLOSED_LESS, LOCAL_FRICTION_SHARE, LOCAL_RATIO, SIMULATED, BankPlan
from fast.models.gap.bank.effect_surfaces import find_amplitude, name_axes
from fast.models.gap.fit.fit import Fit
from fast.models.gap.naming.name import NamingResult
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE

_T = TypeVar("_T")

MOST_EFFECTS = 3  # that are proposed by a round
_REACH_SD = 2.0  # of theta's posterior that the grid holds, as long as it is no more than twice the usual grid
_BESIDE_SHARE, _BESIDE_RATIO = 0.05, 0.01  # of a theta at which no surface should end
MOST_RUNS = 2  # that are added for named effects, one after another
_NEAR_RUN = 0.1  # of its amplitude and its shape: a run as near as that to another says nothing new of their slope


def name_locally(
    proposed: NamingResult, former: BankPlan | None, name_in: Callable[[BankPlan], tuple[_T, NamingResult]]
) -> tuple[_T, NamingResult, BankPlan]:
    """Answer in the bank around the theta that the wide one proposes; also give what comes with it, and the bank.

    former: the bank of the round before, which stays if it can. A bank that theta leaves is moved, once; one whose
    answer names a simulated effect gets runs at its fitted parameters. answer: simulates a bank and answers in it.
    """
    plan = choose_bank(proposed, former)
    rest, found = name_in(plan)
    if has_left(found, plan):
        plan = move_bank(found, plan)
        rest, found = name_in(plan)
    for _ in range(MOST_RUNS):
        finer = add_runs(found, plan)
        if finer == plan:
            break
        plan = finer
        rest, found = name_in(plan)
    return rest, found, plan


def add_runs(found: NamingResult, plan: BankPlan) -> BankPlan:
    """Add to the bank a run at the fitted parameters of every effect of an answer that has none near it.

    Parameters are rounded, so that the next search finds the run in the lake.
    """
    runs = plan.runs
    for value in found.best.effects:
        if CATALOGUE[value.effect].bank_runs and value.effect in plan.effects:
            names = [name for name in name_axes(value.effect) if name]
            own = {name: float(f"{value.parameters[name]:.2g}") for name in names}
            is_new = not any(_is_near(value.effect, own, run) for run in plan.list_amplitudes(value.effect))
            if is_new and find_amplitude(value.effect, own[names[0]]) != 0.0:
                runs = (*runs, EffectValue(effect=value.effect, parameters=own))
    return replace(plan, runs=runs)


def _is_near(effect: str, first: Mapping[str, float], second: Mapping[str, float]) -> bool:
    name, shape = name_axes(effect)
    a, b = (find_amplitude(effect, one[name]) for one in (first, second))
    is_same_shape = shape is None or abs(np.log(first[shape] / second[shape])) < _NEAR_RUN
    return abs(a - b) < _NEAR_RUN * max(abs(a), abs(b)) and is_same_shape


def choose_bank(proposed: NamingResult, former: BankPlan | None = None) -> BankPlan:
    """Choose the bank to answer in after a round's proposal: the former with more effects, or one around its theta.

    The grid holds theta with the best effect and without any: else a theta that may not go where it wants would make
    every effect look needed.
    """
    if former is not None:
        return replace(former, effects=_merge(former.effects, _list_effects(proposed)))
    return BankPlan.around(proposed.best.theta, _list_reached(proposed), _list_effects(proposed))


def has_left(found: NamingResult, plan: BankPlan) -> bool:
    """Return whether theta, with what was named or without, wants to leave the grid of the bank it was fitted in."""
    return plan.is_at_edge(found.fit.theta) or plan.is_at_edge(found.best.theta)


def move_bank(found: NamingResult, plan: BankPlan) -> BankPlan:
    """Move the bank, with the same effects, to around where theta went."""
    return BankPlan.around(found.best.theta, _list_reached(found), _merge(plan.effects, _list_effects(found)))


def _list_effects(found: NamingResult) -> tuple[str, ...]:
    """List the simulated effects that are in the model, and those for which there is most evidence.

    Where repeats tell that something changes, also jaws that stop early: that is one of the things that may change.
    """
    known = {value.effect for fit in (found.fit, found.best) for value in fit.effects}
    tried = [row for row in found.candidates if row.effect in SIMULATED and (row.nats or 0.0) > 0.0]
    credible = sorted(tried, key=lambda row: -(row.nats or 0.0))[:MOST_EFFECTS]
    drifting = CLOSED_LESS if found.named.drift else ()
    return _merge(tuple(known), tuple(row.effect for row in credible), drifting)


def _merge(*effects: tuple[str, ...]) -> tuple[str, ...]:
    """Merge all of these that are simulated, in the order of the bank."""
    return tuple(name for name in SIMULATED if any(name in some for some in effects))


def _list_reached(found: NamingResult) -> np.ndarray:
    """List frictions and Poisson ratios (p x 2) that theta's posterior may reach, with what was named and without."""
    return np.concatenate([_reach(fit) for fit in (found.fit, found.best)])


def _reach(fit: Fit) -> np.ndarray:
    """Find the ends of friction and Poisson ratio of a fit, 2 x 2."""
    at = fit.theta[1:]
    beside = np.array([_BESIDE_SHARE * at[0], _BESIDE_RATIO])
    most = 2.0 * np.array([LOCAL_FRICTION_SHARE * at[0], LOCAL_RATIO])
    reach = np.clip(_REACH_SD * np.sqrt(np.diag(fit.deflated_covariance)[1:3]), beside, most)
    return np.stack([at - reach, at + reach])

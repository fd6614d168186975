"""What an oracle names: it knows every law that may be hidden, how worlds are drawn, and all scatters.

It is the bound of names and of stated probabilities, as `flows.challenge.hidden.bound` is that of alarms. The forces of
a world are normal about what its cause changes, theta and moduli fitted; so Bayes' rule says how probable each family
is, an unlisted cause, and nothing. Nobody does better on the mean, a lab less: it knows neither laws nor scatters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fast.flows.challenge.hidden.bound import Bound
from fast.flows.challenge.hidden.other_lab_laws import OTHER_LAB_LAWS
from fast.flows.challenge.hidden.panels import RESPONDING, modulus_factor, raw_strength
from fast.flows.challenge.hidden.worlds import LIMITS, OF_RESPONDING, Group, Hidden, WorldKey, Worlds
from fast.models.gap.findings import NONE, UNKNOWN
from fast.models.gap.grasps import Grasps
from fast.models.records import Record
from fast.models.simulation.effects.catalogue import CATALOGUE

N_DRAWS = 400
_BEGAN = 0.3  # of the largest amplitude, at which a law's strength is measured


class AtBest(Record):
    """What the oracle reaches in a world, the mean over draws of noise.

    names: how often what it says is right: the family, *unknown* of no catalogue, or nothing. is_wrong: how often it
    names a wrong family. brier: squared difference of what it states and what is right.
    """

    names: float
    is_wrong: float
    brier: float


@dataclass(frozen=True, eq=False)
class _Cause:
    """Something that may be hidden: what is right to say of it, how probable it is, and what it changes (n x 120)."""

    says: str
    prior: float
    hidden: Hidden
    change_n: np.ndarray


def measure_at_best(bound: Bound, key: WorldKey, grasps: Grasps, shares: Mapping[Group, float]) -> AtBest:
    """Measure what the oracle reaches in a world with at most one cause; shares: of kinds of worlds."""
    own = bound.worlds.of(key)
    true = key.effects[0] if key.effects else None
    sites = own.lab(key).order()
    places = {(site.tool, site.obj, site.context.repeat): n for n, site in enumerate(sites)}
    at = zip(grasps.tool.tolist(), grasps.obj.tolist(), grasps.contexts, strict=True)
    rows = [places[tool, obj, context.repeat] for tool, obj, context in at]
    base_n = own.panels.steps_n[key.base]
    force_n = modulus_factor(key.young_modulus_mpa) * np.array([base_n[site.tool, site.obj] for site in sites])[rows]
    causes = _list_causes(own, key, shares)
    right = NONE if true is None else _name(key.group, true.effect)
    true_n = np.zeros_like(force_n) if true is None else own.change_by(key, true).change_n[rows]
    changes_n = np.array([true_n, *(np.nan_to_num(cause.change_n[rows]) for cause in causes)])
    if true is not None:  # the oracle knows its size, too
        nearest = min(
            (n for n, cause in enumerate(causes) if _is_alike(cause.hidden, true)),
            key=lambda n: float(np.nansum((changes_n[1 + n] - true_n) ** 2)),
        )
        changes_n[1 + nearest] = true_n
    products = bound.multiply(key, grasps, changes_n, force_n)
    values, vectors = np.linalg.eigh(products)
    rng = np.random.default_rng(key.seed)
    noise = (rng.standard_normal((N_DRAWS, len(values))) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    nats = products[0, 1:] + noise[:, 1:] - 0.5 * np.diag(products)[1:] + np.log([cause.prior for cause in causes])
    said = sorted({cause.says for cause in causes})
    of_each = [np.logaddexp.reduce(nats[:, [cause.says == one for cause in causes]], axis=1) for one in said]
    all_nats = np.column_stack([*of_each, np.full(N_DRAWS, np.log(shares["null"]))])
    probability = np.exp(all_nats - np.logaddexp.reduce(all_nats, axis=1)[:, None])
    names = np.array([*said, NONE])[probability.argmax(axis=1)]
    is_right = names == right
    return AtBest(
        names=float(is_right.mean()),
        is_wrong=float((~is_right & (names != NONE) & (names != UNKNOWN)).mean()),
        brier=float(((probability.max(axis=1) - is_right) ** 2).mean()),
    )


def _name(group: Group, effect: str) -> str:
    return UNKNOWN if group == "unlisted" else CATALOGUE[effect].family


def _is_alike(first: Hidden, second: Hidden) -> bool:
    return (first.effect, first.truth_set, first.is_other) == (second.effect, second.truth_set, second.is_other)


def _list_causes(own: Worlds, key: WorldKey, shares: Mapping[Group, float]) -> list[_Cause]:
    """Everything that worlds of one cause draw from, at the sizes at which they draw it; changes are in proportion."""
    found: list[_Cause] = []
    for group in ("single", "unlisted"):
        names = own.list_effects(group)
        for name in names:
            prior = shares[group] / len(names)
            if name in own.panels.sets:
                one = own.panels.sets[name]
                hidden = Hidden(effect=one.law, truth_set=name, is_other=one.is_other)
                found.append(_Cause(_name(group, one.law), prior, hidden, own.change_by(key, hidden).change_n))
                continue
            at = key.model_copy(update={"base": RESPONDING}) if name in OF_RESPONDING else key
            largest, has_sign = LIMITS[name]
            laws = (False, True) if name in OTHER_LAB_LAWS and own.has_other_laws else (False,)
            ways = [(is_other, sign) for is_other in laws for sign in ((1.0, -1.0) if has_sign else (1.0,))]
            for is_other, sign in ways:
                hidden = Hidden(effect=name, amplitude=sign * _BEGAN * largest, is_other=is_other)
                change = own.change_by(at, hidden)
                raw = max(raw_strength(change.change_n, change.force_n), 1e-9)
                for strength in own.strengths:
                    by = min(strength / raw, 1.0 / _BEGAN)
                    share = prior / len(ways) / len(own.strengths)
                    found.append(_Cause(_name(group, name), share, hidden, by * change.change_n))
    return found

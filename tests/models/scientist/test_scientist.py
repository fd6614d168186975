"""Proposals: legal, apart, never repeated, deterministic, aware of pending points, and better than random."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.space import RIB_COUNT_COLUMN, random_unit, to_unit
from fast.models.errors import UsageError
from fast.models.scientist.propose import NO_PENDING, Room, Rule, propose
from fast.models.scientist.surrogate.fit import ObservationSet, fit_surrogate
from fast.models.scientist.surrogate.posterior import Surrogate

CENTRE = np.array([0.7, 0.3, 0.5, 0.5, 0.6, 0.5, 0.5, 6 / 9, 0.35])
WEIGHTS = np.array([4.0, 3.0, 0.1, 0.1, 2.0, 0.1, 0.1, 3.0, 3.0])


def real_force(x: np.ndarray) -> np.ndarray:
    return 10 + 16 * np.exp(-(WEIGHTS * (x - CENTRE) ** 2).sum(axis=1)) + 0.4 * np.sin(5 * x[:, 2])


def sim_force(x: np.ndarray) -> np.ndarray:
    """A shifted and scaled proxy with a slope of its own."""
    return 3 + 7 * np.exp(-(WEIGHTS * (x - CENTRE - 0.06) ** 2).sum(axis=1)) + 0.8 * x[:, 5]


def observe(x: np.ndarray, s: np.ndarray, rng: np.random.Generator) -> ObservationSet:
    y = np.where(s == 1, real_force(x) + 0.15 * rng.normal(size=len(x)), sim_force(x))
    return ObservationSet(x, s, y, np.zeros(len(x)))


def fitted(n_real: int = 12, n_sim: int = 30, seed: int = 0) -> Surrogate:
    rng = np.random.default_rng(seed)
    s = np.r_[np.ones(n_real, int), np.zeros(n_sim, int)]
    return fit_surrogate(observe(random_unit(n_real + n_sim, rng), s, rng))


@pytest.mark.parametrize("fidelity", [0, 1])
@pytest.mark.parametrize("acquisition", ["mes", "random"])
def test_batch_is_apart_new_and_ordered(fidelity: int, acquisition: str):
    surrogate = fitted()
    pending = np.column_stack([random_unit(4, np.random.default_rng(1)), [0, 0, 1, 1]])
    proposals = propose(surrogate, fidelity, 10, pending, np.random.default_rng(2), Rule(acquisition))
    x = to_unit([proposal.design for proposal in proposals])
    assert len(proposals) == 10
    assert pdist(x).min() > 0.0499
    taken = np.concatenate([surrogate.data.x[surrogate.data.s == fidelity], pending[pending[:, -1] == fidelity, :-1]])
    assert np.linalg.norm(x[:, None] - taken, axis=2).min() > 5e-5
    assert all(proposal.value >= 0 for proposal in proposals)
    assert all(1 <= proposal.design.rib_count <= 10 for proposal in proposals)


def test_same_seed_same_proposals_other_seed_others():
    surrogate = fitted()
    first = propose(surrogate, 1, 3, NO_PENDING, np.random.default_rng(3))
    assert propose(surrogate, 1, 3, NO_PENDING, np.random.default_rng(3)) == first
    assert propose(surrogate, 1, 3, NO_PENDING, np.random.default_rng(4)) != first


def test_pending_points_lower_the_value_of_their_surroundings():
    surrogate = fitted()
    free = propose(surrogate, 1, 1, NO_PENDING, np.random.default_rng(5))[0]
    pending = np.append(to_unit([free.design])[0], 1)[None, :]
    second = propose(surrogate, 1, 1, pending, np.random.default_rng(5))[0]
    assert second.design != free.design
    assert second.value < free.value


def test_a_simulated_design_may_be_measured_but_not_simulated_again():
    surrogate = fitted(n_real=3, n_sim=0)
    best = propose(surrogate, 1, 1, NO_PENDING, np.random.default_rng(6))[0]
    x = to_unit([best.design])
    data = surrogate.data
    more = ObservationSet(
        np.concatenate([data.x, x]), np.append(data.s, 0), np.append(data.y, 12.0), np.append(data.noise_variance, 0.0)
    )
    again = propose(surrogate.updated(more), 0, 1, NO_PENDING, np.random.default_rng(6))[0]
    assert again.design != best.design


@pytest.mark.parametrize("acquisition", ["mes", "ei", "random"])
def test_what_was_proposed_before_never_comes_again_and_rejects_keep_their_surroundings_free(
    acquisition: str, monkeypatch: pytest.MonkeyPatch
):
    """Only three candidates are left: one proposed before, one near a reject, one free."""
    surrogate = fitted()
    before, reject, free = random_unit(3, np.random.default_rng(8))
    near = reject.copy()
    near[0] += 0.04 if near[0] < 0.5 else -0.04
    candidates = np.array([before, near, free])
    monkeypatch.setattr("fast.models.scientist.propose.candidate_points", lambda *_: candidates)
    monkeypatch.setattr("fast.models.design.space.DesignSpace.random_unit", lambda *_: candidates)
    proposals = [
        propose(surrogate, 1, 1, NO_PENDING, np.random.default_rng(0), Rule(acquisition), Room(**kept_off))[0]
        for kept_off in ({"taken": before[None], "rejected": reject[None]}, {"taken": candidates[1:]})
    ]
    assert [np.abs(to_unit([p.design]) - candidates).max(axis=1).argmin() for p in proposals] == [2, 0]


@pytest.mark.parametrize("acquisition", ["mes", "random"])
def test_only_what_can_be_printed_is_proposed(acquisition: str):
    rules = PrintingRules(min_cavity_mm=5.0, max_mass_g=26.0)
    surrogate = fitted()
    free, kept = (
        propose(surrogate, 1, 5, NO_PENDING, np.random.default_rng(2), Rule(acquisition), Room(printing=printing))
        for printing in (None, rules)
    )
    assert any(broken_rules(proposal.design, rules) for proposal in free)
    assert not any(broken_rules(proposal.design, rules) for proposal in kept)


def test_rules_that_nothing_keeps_are_refused():
    nothing = PrintingRules(max_mass_g=0.1)
    with pytest.raises(UsageError, match="Only 0 of 1 designs"):
        propose(None, 1, 1, NO_PENDING, np.random.default_rng(2), Rule("random"), Room(printing=nothing))


def test_random_needs_no_surrogate():
    proposals = propose(None, 1, 30, NO_PENDING, np.random.default_rng(0), Rule("random"))
    assert len({proposal.design.design_id for proposal in proposals}) == 30
    assert {proposal.value for proposal in proposals} == {0.0}


@pytest.mark.parametrize("acquisition", ["mes", "random"])
def test_too_wide_a_distance_is_refused(acquisition: str):
    with pytest.raises(UsageError, match="of 5 designs fit apart from each other; ask for a smaller minimum distance"):
        propose(fitted(), 1, 5, NO_PENDING, np.random.default_rng(0), Rule(acquisition), Room(min_distance=2.9))


def test_wrong_arguments_are_named():
    surrogate, rng = fitted(n_real=3, n_sim=0), np.random.default_rng(0)
    with pytest.raises(UsageError, match="`mess` is unknown; did you mean `mes`"):
        propose(surrogate, 1, 1, NO_PENDING, rng, Rule("mess"))
    with pytest.raises(UsageError, match="`mes` needs a fitted surrogate"):
        propose(None, 1, 1, NO_PENDING, rng)
    with pytest.raises(UsageError, match="Fidelity is 2"):
        propose(surrogate, 2, 1, NO_PENDING, rng)
    with pytest.raises(UsageError, match="0 designs asked for"):
        propose(surrogate, 1, 0, NO_PENDING, rng)
    with pytest.raises(UsageError, match=r"shape \(2, 9\); give m x 10"):
        propose(surrogate, 1, 1, np.zeros((2, 9)), rng)


def closed_loop(acquisition: str, seed: int, n_rounds: int = 5) -> float:
    """Best true real force found by 8 + 3 per round measured designs, with 15 + 10 per round simulations, in N."""
    rng = np.random.default_rng(seed)
    data = observe(random_unit(23, rng), np.r_[np.ones(8, int), np.zeros(15, int)], rng)
    surrogate = fit_surrogate(data)
    for _ in range(n_rounds):
        for fidelity, n in ((0, 10), (1, 3)):
            proposals = propose(surrogate, fidelity, n, NO_PENDING, rng, Rule(acquisition))
            new = observe(to_unit([proposal.design for proposal in proposals]), np.full(n, fidelity), rng)
            columns = [(getattr(data, name), getattr(new, name)) for name in ("x", "s", "y", "noise_variance")]
            data = ObservationSet(*[np.concatenate(pair) for pair in columns])
            surrogate = fit_surrogate(data, surrogate.parameters)
    return float(real_force(data.x[data.s == 1]).max())


def test_closed_loop_beats_random():
    seeds = range(3)
    guided = np.array([closed_loop("mes", seed) for seed in seeds])
    unguided = np.array([closed_loop("random", seed) for seed in seeds])
    assert (guided > unguided).all()
    assert (guided - unguided).mean() > 2.0
    assert guided.min() > 0.9 * real_force(CENTRE[None, :])[0]


def test_rib_count_reaches_its_best_level():
    rng = np.random.default_rng(1)
    surrogate = fit_surrogate(observe(random_unit(150, rng), np.ones(150, int), rng))
    best = propose(surrogate, 1, 3, NO_PENDING, rng)
    assert any(abs(to_unit([p.design])[0, RIB_COUNT_COLUMN] - CENTRE[RIB_COUNT_COLUMN]) < 0.12 for p in best)

"""Methods of the challenge on a world whose answer is plain."""

from dataclasses import replace

import numpy as np
import pytest

from fast.flows.challenge.answers import LIFT_MM
from fast.flows.challenge.keys import find_keys, open_keys
from fast.flows.challenge.public import PUBLIC
from fast.flows.challenge.world_folder import read_world
from tests.studies.challenge.entrants import learned
from tests.studies.challenge.entrants.common import N_BINS, Fitted, average
from tests.studies.challenge.entrants.lisdd import TERMS, _control, answer_lisdd


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    """A public world that hides nothing."""
    sealed, _ = open_keys(find_keys(PUBLIC), PUBLIC)
    name = next(one.world for one in sealed if not one.key.effects)
    return Fitted.of(read_world(PUBLIC, name))


def test_theta_alone_foretells_the_asked_grasps(fitted: Fitted) -> None:
    _, withheld = open_keys(find_keys(PUBLIC), PUBLIC)
    measured = np.array([withheld[fitted.world.name][name] for name in fitted.world.asked.grasp_ids])
    rest_n = fitted.foretell() - measured
    assert np.sqrt(np.mean(rest_n**2)) < 0.2 * np.sqrt(np.mean(measured**2))
    added_n = fitted.foretell(0.1) - fitted.foretell()
    assert added_n == pytest.approx(np.broadcast_to(0.1 * fitted.asked.peak_n, added_n.shape))


def test_what_is_averaged_keeps_its_place() -> None:
    steps_n = np.arange(120.0)[None]
    assert average(steps_n).shape == (1, N_BINS)
    assert average(steps_n)[0, 0] == np.mean(steps_n[0, : len(LIFT_MM) // N_BINS])


def make_pattern_and_noise(fitted: Fitted) -> tuple[Fitted, Fitted]:
    """Half the force of each cell is left; then noise of about the same size."""
    noise = 0.2 * np.random.default_rng(0).standard_normal(fitted.rest.shape)
    return replace(fitted, rest=0.5 * fitted.cells.force), replace(fitted, rest=noise)


def test_learned_methods_score_a_pattern_above_noise(fitted: Fitted) -> None:
    pattern, noise = make_pattern_and_noise(fitted)
    assert learned.score_trees(pattern) > 0.8
    assert learned.score_trees(noise) < 0.1
    assert learned.weigh_process(pattern) > learned.weigh_process(noise) + 10.0


def test_a_sparse_polynomial_scores_a_pattern_above_noise_and_foretells_it(fitted: Fitted) -> None:
    pytest.importorskip("pysindy", reason="PySINDy is installed for the study alone: pip install .[peers]")
    pattern, noise = make_pattern_and_noise(fitted)
    assert learned.score_sparse(pattern) > 0.8
    assert learned.score_sparse(noise) < 0.1
    assert learned.foretell_sparse(pattern) == pytest.approx(0.5 * pattern.asked.force, abs=0.02)


def test_lisdd_finds_a_force_on_one_object_and_nothing_in_noise(fitted: Fitted) -> None:
    """A constant force of a tenth of a newton and more on one object, in noise of a thousandth of the peak."""
    quiet = 1e-3 * np.random.default_rng(1).standard_normal(fitted.rest.shape)
    assert not answer_lisdd(replace(fitted, rest=quiet)).missing
    on_one = (fitted.problem.obj == fitted.problem.obj[0])[:, None]
    said = answer_lisdd(replace(fitted, rest=quiet + on_one * 0.5 / fitted.cells.peak_n))
    assert (said.missing, said.effect) == (True, TERMS["1"])
    assert said.probability > 0.9


def test_false_discoveries_are_held_by_their_rate() -> None:
    """Benjamini and Hochberg: the third passes because it is below three fourths of the level."""
    assert _control(np.array([0.001, 0.2, 0.03, 0.02]), 0.05).tolist() == [True, False, True, True]
    assert not _control(np.array([0.03, 0.2, 0.4]), 0.05).any()

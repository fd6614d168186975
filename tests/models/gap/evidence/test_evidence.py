"""The likelihood on worlds of true grasps: theta is found, evidence is that of dense algebra, causes are seen."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.worlds import Worlds
from fast.models.gap.evidence.candidates import scale_value, weigh_candidates
from fast.models.gap.evidence.doubt import Doubt
from fast.models.gap.evidence.likelihood import EvidenceFit, Problem, fit_evidence
from fast.models.gap.evidence.reading import OF_BINS, Reading, compute_rms
from fast.models.gap.evidence.rehearsal import Rehearsal, Rehearsed, make_world, rehearse
from fast.models.records import EffectValue

DATA = Path(__file__).parents[3] / "data" / "gap-small.npz"


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds(*read_small(DATA), seed=5)


@pytest.fixture(scope="module")
def problem(worlds: Worlds) -> Problem:
    return Problem.of(worlds.problem(worlds.draw("null", 0)).usable)


@pytest.fixture(scope="module")
def fit(problem: Problem) -> EvidenceFit:
    return fit_evidence(problem)


def _hide(worlds: Worlds, name: str) -> Problem:
    """The problem of a world that hides an effect by 4 % of the force, or as a set of true grasps has it."""
    key = worlds.with_effect(worlds.draw("null", 0), name, 0.04, np.random.default_rng(0))
    return Problem.of(worlds.problem(key).usable)


def test_bins_average_every_step_once() -> None:
    assert (OF_BINS > 0).sum(axis=0).tolist() == [1] * OF_BINS.shape[1]
    assert np.allclose(OF_BINS.sum(axis=1), 1.0)


def test_contrasts_are_orthonormal_and_blind_to_what_repeats_share(problem: Problem) -> None:
    reading = Reading.of(problem.reading.grasps)
    assert np.allclose(reading.mix @ reading.mix.T, np.eye(len(reading.mix)))
    shared_n = np.random.default_rng(0).normal(size=(reading.n_cells, 120))[reading.cell]
    assert np.abs(reading.contrast(shared_n)).max() < 1e-12
    assert np.allclose(reading.average(shared_n), shared_n[reading.rows] @ OF_BINS.T)


def test_theta_is_found(worlds: Worlds, fit: EvidenceFit) -> None:
    key = worlds.draw("null", 0)
    friction, ratio = worlds.panels.sets[key.base].theta
    assert fit.theta[0] == pytest.approx(key.young_modulus_mpa, rel=0.06)
    assert fit.theta[1] == pytest.approx(friction, abs=0.03)
    assert fit.theta[2] == pytest.approx(ratio, abs=0.04)


def test_products_are_those_of_the_whole_covariance(fit: EvidenceFit) -> None:
    white = np.random.default_rng(1).normal(size=(3, len(fit.gap)))
    heavy = np.ones(len(fit.gap))
    heavy[: fit.force_n.size] = np.repeat(fit.weights, OF_BINS.shape[0])
    whole = np.linalg.inv(np.diag(1.0 / heavy) + fit.columns.T @ fit.columns)
    products, along = fit.multiply(white)
    assert np.allclose(products, white @ whole @ white.T)
    assert np.allclose(along, white @ whole @ fit.gap)


def test_a_scaled_limit_of_force_goes_by_its_inverse() -> None:
    value = EffectValue(effect="force_limited_closing", parameters={"max_force_n": 8.0})
    assert scale_value(value, 0.5).parameters["max_force_n"] == pytest.approx(16.0, rel=0.01)
    assert scale_value(value, 2.0).parameters["max_force_n"] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("hidden", ["static_kinetic_friction", "mullins_softening"])
def test_an_effect_has_the_most_evidence_where_it_is_hidden(worlds: Worlds, hidden: str) -> None:
    names = ("static_kinetic_friction", "object_edge_radius", "load_cell_offset", "mullins_softening")
    effects = [one for one in weigh_candidates(fit_evidence(_hide(worlds, hidden)), names) if one.kind == "effect"]
    assert effects[0].name == hidden
    assert effects[0].nats > 25.0


def test_nothing_is_said_with_what_could_still_hide(worlds: Worlds) -> None:
    usable = worlds.problem(worlds.draw("null", 0)).usable
    doubt = Doubt.of(usable, (), ("load_cell_offset", "object_edge_radius"), n_worlds=8)
    assert doubt.decide().kind == "none"
    hidden = tuple(Rehearsed("listed", 0.01 * n, 20.0 * n, 1.0) for n in range(1, 31))
    told = replace(doubt, rehearsal=replace(doubt.rehearsal, worlds=hidden)).decide()
    assert told.kind == "none"
    force_n = np.sqrt((doubt.fit.force_n**2).mean())
    assert f"by 1 % ({0.01 * force_n:.2g} N) or more was seen in nine of ten of 30 made-up worlds" in told.sentence


def test_a_cause_of_no_catalogue_is_an_alarm_with_its_size(worlds: Worlds) -> None:
    key = worlds.with_effect(worlds.draw("null", 0), "pulling_hose", 0.04, np.random.default_rng(0))
    usable = worlds.problem(key).usable
    doubt = Doubt.of(usable, (), ("object_edge_radius", "static_kinetic_friction"), n_worlds=4)
    decision = doubt.decide()
    assert decision.kind == "unknown"
    assert "a force" in decision.sentence
    assert doubt.best.change_n is not None
    share = compute_rms(doubt.best.change_n) / compute_rms(doubt.fit.force_n)
    assert share == pytest.approx(key.effects[0].raw_strength, rel=0.6)


def test_a_law_in_the_model_is_no_alarm(worlds: Worlds) -> None:
    bare = fit_evidence(_hide(worlds, "mullins_softening"))
    best = next(one for one in weigh_candidates(bare, ["mullins_softening"]) if one.value is not None)
    assert best.value is not None
    granted = fit_evidence(Problem.of(bare.problem.surrogate, (best.value,)))
    before, after = (float((one.gap[one.of_contrasts] ** 2).sum()) for one in (bare, granted))
    assert after < 0.7 * before


def test_lines_are_those_of_worlds_with_nothing_hidden() -> None:
    nothing = [Rehearsed("nothing", 0.0, 50.0 + n, 1.0 + 0.1 * n) for n in range(40)]
    hidden = [Rehearsed("listed", 0.01 * n, 15.0 * n, 1.0) for n in range(1, 21)]
    rehearsal = Rehearsal.of([*nothing, *hidden])
    assert rehearsal.nats_line == 89.0
    assert rehearsal.omnibus_line == pytest.approx(4.9)
    assert rehearsal.find_seen_size() == pytest.approx(0.05)  # of 16 from here on, 15 were seen
    assert rehearsal.estimate_hidden(is_alarm=True) > 0.95
    assert 0.1 < rehearsal.estimate_hidden(is_alarm=False) < 0.35
    unseen = replace(rehearsal, nats_line=1e3)
    assert unseen.find_seen_size() is None


def test_made_up_worlds_are_the_same_for_a_seed_and_hide_in_turn(problem: Problem) -> None:
    names = ("load_cell_offset", "object_edge_radius")
    made = [make_world(problem, names, np.random.default_rng([3, n]), n) for n in range(8)]
    again = make_world(problem, names, np.random.default_rng([3, 5]), 5)
    assert [one.group for one in made] == ["nothing", "listed", "nothing", "unlisted"] * 2
    assert np.array_equal(made[5].steps_n, again.steps_n)
    assert made[1].cause == "load_cell_offset"
    assert made[5].cause == "object_edge_radius"
    assert all(one.size == 0.0 for one in made[::2])
    assert all(0.001 < one.size < 0.3 for one in made[1::2])


def test_worlds_have_the_effects_of_the_model(worlds: Worlds) -> None:
    known = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.5})
    problem = Problem.of(worlds.problem(worlds.draw("null", 0)).usable, (known,))
    rehearsal = rehearse(problem, ["object_edge_radius"], 4, seed=0)
    assert max(one.nats for one in rehearsal.worlds if one.group == "nothing") < 25.0

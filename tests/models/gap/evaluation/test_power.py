"""How large an effect must be to be seen: the size that is given carries the evidence that is asked for."""

import pytest

from fast.models.gap.evaluation.power import (
    LEAST_TOOLS,
    compute_smallest_share,
    count_tools_needed,
    find_visible_sizes,
    write_power_sentence,
)
from fast.models.gap.fit.fit import Fit
from fast.models.gap.fit.recalibrate import recalibrate
from fast.models.gap.naming.rank_effects import DEFLATION, LEAST_NATS, rank_effects
from tests.synthetic.gap import GapTruth, made_up_gap

EFFECTS = ("load_cell_offset", "load_cell_lag", "force_limited_closing")


@pytest.fixture(scope="module")
def fit() -> Fit:
    return recalibrate(made_up_gap(8, 6, 0, GapTruth()).training, ())


def test_an_offset_of_the_given_size_passes_the_line_and_no_smaller_one(fit: Fit) -> None:
    line = 0.05
    sizes = {one.effect: one for one in find_visible_sizes(fit, rank_effects(fit, EFFECTS), line, least_size=0.0)}
    assert list(sizes) == list(EFFECTS)
    offset = sizes["load_cell_offset"]
    assert offset.value is not None
    assert offset.words == f"offset {offset.value.parameters['offset_n']:.2g} N"
    assert 0.0 < abs(offset.value.parameters["offset_n"]) < 0.5
    change = fit.features.whiten(fit.predict_features([offset.value]) - fit.predict_features())[None] * fit.weight
    flat, columns = change.reshape(1, -1), fit.columns.reshape(len(fit.columns), -1)
    own = flat - (flat @ columns.T) @ fit.covariance @ columns
    squares, noise = float((own**2).sum()), float((fit.residual**2).sum())
    assert max(squares / (squares + noise) / line, 0.5 * DEFLATION * squares / LEAST_NATS) >= 0.95
    assert min(squares / (squares + noise) / line, 0.5 * DEFLATION * squares / LEAST_NATS) == pytest.approx(1.0, 0.05)


def test_more_noise_hides_larger_effects(fit: Fit) -> None:
    ranking = rank_effects(fit, ("load_cell_offset",))
    small, large = (find_visible_sizes(fit, ranking, line)[0].value for line in (0.05, 0.2))
    assert small is not None
    assert large is not None
    assert abs(large.parameters["offset_n"]) > 1.5 * abs(small.parameters["offset_n"])
    (never,) = find_visible_sizes(fit, ranking, 0.9999)
    assert never.value is None
    assert never.words == "not at any plausible size"


def test_an_effect_smaller_than_the_differences_of_solvers_is_not_seen(fit: Fit) -> None:
    ranking = rank_effects(fit, ("load_cell_offset",))
    offsets_n = []
    for least in (0.02, 0.04):
        (one,) = find_visible_sizes(fit, ranking, 0.001, least)
        assert one.value is not None
        offsets_n.append(abs(one.value.parameters["offset_n"]))
    assert offsets_n[1] == pytest.approx(2.0 * offsets_n[0], rel=0.01)


def test_needs_agree_with_each_other() -> None:
    share = compute_smallest_share(20, 12)
    assert count_tools_needed(share, 12) == pytest.approx(20, abs=1)
    assert count_tools_needed(0.5, 12) == LEAST_TOOLS
    assert compute_smallest_share(8, 14) == pytest.approx(0.15, abs=0.01)  # as seen in made-up worlds
    assert "if it is 15 % of the force or more; one of 5 % takes 39 designs" in write_power_sentence(8, 14)
    assert "takes" not in write_power_sentence(60, 18)

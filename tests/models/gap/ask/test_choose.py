"""Which experiments are chosen, on made-up hypotheses whose best answer is known."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from fast.models.gap.ask.choose import ENOUGH_NATS, Choice, Costs, choose_experiments, list_open_pairs
from fast.models.gap.ask.forecast import LIKELY, Forecast, compute_nats, weigh


def forecast(
    means: list[list[float]], noise: float = 1.0, scatter: float = 0.0, spread: float = 0.0, wide: float = 0.0
) -> Forecast:
    """Hypotheses that predict one number of each experiment; the last one is `wide` open."""
    found = np.array(means, dtype=float)[..., None]
    h, c, _ = found.shape
    unit = np.eye(c)[:, None, :]
    columns = tuple((wide if wide and i == h - 1 else spread) * unit for i in range(h))
    return Forecast(
        names=tuple(f"H{i}" for i in range(h)),
        probability=np.full(h, 1.0 / h),
        is_sharp=np.arange(h) < h - bool(wide),
        means=found,
        columns=columns,
        scatter=np.full((c, 1, 1), scatter**2),
        noise=np.full((c, 1, 1), noise**2),
    )


def costs(n: int, minutes: list[float] | None = None, change: float = 0.0) -> Costs:
    return Costs(np.array(minutes or [1.0] * n), np.arange(n), np.arange(n), change)


def update(probability: np.ndarray, likelihood: np.ndarray) -> np.ndarray:
    after = probability * np.exp(likelihood - likelihood.max())
    return np.asarray(after / after.sum())


def choose(found: Forecast, cost: Costs, most: int = 50) -> Choice:
    return choose_experiments(found, cost, most)


def count_needed(away: float) -> int:
    """Repetitions until half the squared distance, less 0.84 standard deviations of the ratio, reaches three nats."""
    return next(n for n in range(1, 99) if 0.5 * n * away**2 - norm.ppf(LIKELY) * away * np.sqrt(n) >= 3.0)


def test_expected_nats_are_those_of_normal_distributions() -> None:
    found = forecast([[0.0], [2.0]])
    np.testing.assert_allclose(compute_nats(found, [1]).expected, [[0, 2], [2, 0]], atol=1e-12)
    np.testing.assert_allclose(compute_nats(found, [3]).expected, [[0, 6], [6, 0]], atol=1e-12)
    # Equal means, standard deviations 1 and 3: ln 3 - 1/2 + 1/18; the other way round it is more.
    wide = compute_nats(forecast([[0.0], [0.0]], wide=np.sqrt(8.0)), [1])
    np.testing.assert_allclose(wide.expected[[0, 1], [1, 0]], np.log(3) - 0.5 + 1 / 18)


@pytest.mark.parametrize(("means", "spread", "wide"), [([2.0, 0.5], 0.0, 0.0), ([1.0, 1.0], 0.4, 3.0)])
def test_likely_nats_are_reached_by_as_many_outcomes_as_said(means: list[float], spread: float, wide: float) -> None:
    """Also where a hypothesis does not know itself well, so that a few outcomes far out carry the mean."""
    found = forecast([[0.0, 0.0], means], spread=spread, wide=wide)
    (first, second), covariances = found.stack([2, 3])
    rng, shares = np.random.default_rng(0), []
    for own, here in ((first, covariances[0]), (second, covariances[1])):
        seen = rng.multivariate_normal(own, here, size=20000)
        density = [multivariate_normal(m, V).logpdf(seen) for m, V in zip((first, second), covariances, strict=True)]
        ratio = density[0] - density[1] if own is first else density[1] - density[0]
        shares.append(np.quantile(ratio, 1.0 - LIKELY))
    assert compute_nats(found, [2, 3]).likely[0, 1] == pytest.approx(max(min(shares), 0.0), abs=0.1)


def test_what_a_cell_has_wrong_does_not_average_out() -> None:
    noisy, scattered = forecast([[0.0], [1.0]]), forecast([[0.0], [1.0]], noise=0.1, scatter=1.0)
    assert compute_nats(noisy, [100]).expected[0, 1] == pytest.approx(50.0)
    assert compute_nats(scattered, [100]).expected[0, 1] < 0.51


def test_the_experiment_that_tells_most_a_minute_is_chosen() -> None:
    found = forecast([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0]])
    np.testing.assert_array_equal(choose(found, costs(3)).counts > 0, [True, False, True])
    alone = Costs(np.array([1.0, 1.0, 1.0]), np.arange(3), np.zeros(3))
    np.testing.assert_array_equal(choose(found, alone).counts, [0, 0, count_needed(3.0)])
    dear = Costs(np.array([1.0, 1.0, 90.0]), np.arange(3), np.zeros(3))
    np.testing.assert_array_equal(choose(found, dear).counts, [count_needed(1.0), 0, 0])


def test_the_number_is_the_smallest_that_promises_three_nats_between_the_worst_pair() -> None:
    found = forecast([[0.0, 0.0], [0.8, 0.8], [4.0, 4.0]])
    choice = choose(found, costs(2))
    assert choice.n == count_needed(0.8)
    assert choice.nats[0, 1] >= 3.0
    assert list_open_pairs(found, choice.nats) == []


def test_a_hypothesis_that_is_hardly_possible_costs_nothing() -> None:
    found = forecast([[0.0, 0.0], [2.0, 2.0], [1.2, 1.2]])
    unlikely = Forecast(**{**found.__dict__, "probability": np.array([0.6, 0.39, 0.01])})
    assert choose(unlikely, costs(2)).n < choose(found, costs(2)).n


def test_two_experiments_serve_two_pairs() -> None:
    found = forecast([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]])
    assert (choose(found, costs(2)).counts >= 1).all()


def test_a_tool_that_is_on_the_head_is_cheaper_than_another() -> None:
    found = forecast([[0.0] * 4, [1.0] * 4])
    cost = Costs(np.ones(4), np.array([0, 0, 1, 2]), np.arange(4), change=5.0)
    choice = choose(found, cost)
    assert set(cost.tool[choice.counts > 0]) == {0}


def test_where_nothing_tells_nothing_is_asked() -> None:
    found = forecast([[1.0, 2.0], [1.0, 2.0]])
    choice = choose(found, costs(2))
    assert choice.n == 0
    assert choice.minutes == 0.0
    assert list_open_pairs(found, choice.nats) == [(1, 0)]


def test_no_more_are_made_than_are_allowed() -> None:
    assert choose(forecast([[0.0, 0.0], [0.8, 0.8]]), costs(2), most=7).n == 7


def test_what_came_says_which() -> None:
    found = forecast([[0.0, 0.0], [3.0, 3.0]])
    likelihood = weigh(found, [np.array([[2.6], [3.3]]), np.zeros((0, 1))])
    after = update(found.probability, likelihood)
    assert after[1] > 0.95
    # Noise of two grasps: (2.95^2 - 0.05^2) / 2 x 2.
    assert likelihood[1] - likelihood[0] == pytest.approx(2.95**2 - 0.05**2)


def test_an_outlier_tells_little_and_an_open_hypothesis_takes_what_nobody_predicts() -> None:
    closed = forecast([[0.0], [1.0]])
    assert abs(np.diff(weigh(closed, [np.array([[30.0]])]))[0]) < 0.1
    with_open = forecast([[0.0], [1.0], [0.0]], wide=20.0)
    assert update(with_open.probability, weigh(with_open, [np.array([[30.0]])]))[2] > 0.95
    assert update(with_open.probability, weigh(with_open, [np.array([[0.1]])]))[0] > 0.5


def test_the_promise_holds() -> None:
    """Made-up answers to a chosen plan favour the truth by three nats, or more, as often as is promised."""
    found = forecast([[0.0] * 20, [0.9] * 20], noise=0.7, scatter=0.7, spread=0.2)
    counts = choose(found, Costs(np.ones(20), np.zeros(20), np.arange(20))).counts
    assert 8 < np.count_nonzero(counts)  # of two numbers alone, an outlier is no rare thing
    made = [place for place, n in enumerate(counts) if n]
    means, covariances = found.select(made).stack([int(counts[place]) for place in made])
    rng, got = np.random.default_rng(0), []
    for _ in range(1000):
        seen = iter(rng.multivariate_normal(means[1], covariances[1]))
        outcomes = [np.full((n, 1), next(seen)) if n else np.zeros((0, 1)) for n in counts]
        likelihood = weigh(found, outcomes)
        got.append(likelihood[1] - likelihood[0])
    assert LIKELY - 0.06 < np.mean(np.array(got) >= ENOUGH_NATS) < LIKELY + 0.06

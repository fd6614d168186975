"""The bridge to BoTorch: the numpy posterior, its gradient and conditioning, the entropy rule, and what is refused."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from botorch.acquisition import PosteriorMean, UpperConfidenceBound
from botorch.models import SingleTaskGP
from botorch.sampling import SobolQMCNormalSampler

from fast.models.design.space import random_unit
from fast.models.errors import UsageError
from fast.models.own_code import load_constraint
from fast.models.scientist.acquisition.mes import information_gain
from fast.models.scientist.bridge.entropy import MaxValueEntropy
from fast.models.scientist.bridge.model import SurrogateModel
from fast.models.scientist.bridge.own_model import make_own_surrogate
from fast.models.scientist.propose import NO_PENDING, Room, Rule, propose
from fast.models.scientist.surrogate.fit import fit_surrogate
from fast.models.scientist.surrogate.observations import ObservationSet
from fast.models.scientist.surrogate.posterior import Surrogate, observation_variance
from tests.synthetic.scientist import BiFidelityKernel


def observed(n_real: int, n_sim: int, seed: int = 0) -> ObservationSet:
    rng = np.random.default_rng(seed)
    x, s = random_unit(n_real + n_sim, rng), np.repeat([1, 0], [n_real, n_sim])
    y = 10 + 4 * np.sin(3 * x[:, 0]) + s * (2 + x[:, 5]) + 0.2 * rng.normal(size=len(x))
    return ObservationSet(x, s, y, np.where(s == 1, 0.01, 0.0))


@pytest.fixture(scope="module")
def surrogate() -> Surrogate:
    return fit_surrogate(observed(15, 25))


def points(*shape: int, seed: int = 1, s: int | None = None) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    x = random_unit(int(np.prod(shape)), rng)
    fidelity = rng.integers(0, 2, len(x)) if s is None else np.full(len(x), s)
    return torch.from_numpy(np.column_stack([x, fidelity])).reshape(*shape, 10)


def botorch_twin(surrogate: Surrogate) -> SingleTaskGP:
    """The same Gaussian process by GPyTorch: its kernel, fixed noise, centred data."""
    p, data = surrogate.parameters, surrogate.data
    y = data.y - np.where(data.s == 1, p.mean_real, p.mean_sim)
    noise = data.noise_variance + observation_variance(p, data.s)
    columns = (np.column_stack([data.x, data.s]), y[:, None], noise[:, None])
    kernel = BiFidelityKernel.from_parameters(p)
    twin = SingleTaskGP(*map(torch.from_numpy, columns), covar_module=kernel, outcome_transform=None)
    twin.mean_module.initialize(constant=0.0)
    return twin.eval()


@pytest.mark.filterwarnings("ignore:.*contained to the unit cube|.*not standardized")
def test_posterior_and_gradient_equal_those_of_botorch(surrogate: Surrogate):
    model, twin, p = SurrogateModel(surrogate), botorch_twin(surrogate), surrogate.parameters
    X = points(3, 4)
    X[1, 2] = X[0, 1]  # one point in two sets
    gradients = []
    for each, centre in ((model, 0.0), (twin, torch.where(X[..., -1] == 1, p.mean_real, p.mean_sim))):
        x = X[..., :-1].clone().requires_grad_()
        posterior = each.posterior(torch.cat([x, X[..., -1:]], dim=-1))
        mean, covariance = posterior.mean[..., 0] + centre, posterior.distribution.covariance_matrix
        (mean.sin().sum() + (covariance * torch.arange(16.0).reshape(4, 4)).sum()).backward()
        gradients.append((mean.detach(), covariance.detach(), x.grad))
    for ours, theirs in zip(*gradients, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)


def test_conditioning_equals_the_surrogate_with_these_data(surrogate: Surrogate):
    new, data = observed(3, 2, seed=5), surrogate.data
    X, Y = torch.from_numpy(np.column_stack([new.x, new.s])), torch.from_numpy(new.y[:, None])
    noise = torch.from_numpy(new.noise_variance + observation_variance(surrogate.parameters, new.s))[:, None]
    model = SurrogateModel(surrogate).condition_on_observations(X[:2], Y[:2], noise=noise[:2])
    posterior = model.condition_on_observations(X[2:], Y[2:], noise=noise[2:]).posterior(points(6))
    more = [np.concatenate([getattr(data, k), getattr(new, k)]) for k in ("x", "s", "y", "noise_variance")]
    mean, covariance = surrogate.updated(ObservationSet(*more)).posterior(
        points(6)[:, :-1].numpy(), points(6)[:, -1].numpy()
    )
    np.testing.assert_allclose(posterior.mean[:, 0], mean, rtol=1e-8)
    np.testing.assert_allclose(posterior.distribution.covariance_matrix, covariance, atol=1e-8)


def test_fantasies_scatter_around_the_mean_and_know_their_points(surrogate: Surrogate):
    model, X = SurrogateModel(surrogate), points(2, seed=3)
    fantasies = model.fantasize(X, SobolQMCNormalSampler(torch.Size([256]), seed=0))
    assert fantasies.batch_shape == (256,)
    there = fantasies.posterior(X)
    assert there.mean.shape == (256, 2, 1)
    np.testing.assert_allclose(there.mean.mean(dim=0), model.posterior(X).mean, atol=0.1)
    assert (there.variance[0] < model.posterior(X).variance).all()
    assert (model.posterior(X, observation_noise=True).variance > model.posterior(X).variance).all()


@pytest.mark.parametrize("s", [0, 1])
def test_the_entropy_rule_is_the_closed_form_of_the_scientist(surrogate: Surrogate, s: int):
    rule = MaxValueEntropy(SurrogateModel(surrogate), points(80), n_paths=16)
    X = points(12, 1, seed=4, s=s)
    x = X[:, 0, :-1].numpy()
    both = [surrogate.posterior(np.stack([row, row]), np.array([1, s])) for row in x]
    mean = np.repeat([[m[0]] for m, _ in both], 16, axis=1)
    variance, variance_s, covariance = np.array([[C[0, 0], C[1, 1], C[0, 1]] for _, C in both]).T
    noise = float(observation_variance(surrogate.parameters, np.array([s]))[0])
    expected = information_gain(rule._best.numpy(), mean, variance, variance_s, covariance, noise)
    np.testing.assert_allclose(rule(X).detach(), expected, rtol=1e-6)


def test_pending_points_take_the_information_at_their_place(surrogate: Surrogate):
    rule = MaxValueEntropy(SurrogateModel(surrogate), points(80))
    pending = points(2, seed=7, s=1)
    at_pending, elsewhere = pending[:, None], points(5, 1, seed=8, s=1)
    before = rule(at_pending), rule(elsewhere)
    rule.set_X_pending(pending)
    assert (rule(at_pending) < 0.5 * before[0]).all()
    assert rule(elsewhere).sum() > 0.5 * before[1].sum()


def test_points_are_checked(surrogate: Surrogate):
    model = SurrogateModel(surrogate)
    with pytest.raises(UsageError, match="Points have 9 columns, the surrogate takes 10"):
        model.posterior(points(3)[:, :-1])
    with pytest.raises(UsageError, match="fidelity that is neither 0 .* nor 1"):
        model.posterior(torch.full((2, 10), 0.5))


LAB = """
import torch
from botorch.acquisition import PosteriorMean
from botorch.models import SingleTaskGP
number = 3
def fails(*arguments): return 1 / 0
def gives_a_list(*arguments): return []
def two_outcomes(X, Y, V): return SingleTaskGP(X, torch.cat([Y, Y], dim=-1), outcome_transform=None)
def nothing_known(X, Y, V):
    model = SingleTaskGP(X, Y, outcome_transform=None)
    model.mean_module.constant.data.fill_(float("nan"))
    return model
class Odd(PosteriorMean):
    def forward(self, X): return X
class Unsure(PosteriorMean):
    def forward(self, X): return torch.full((len(X),), float("nan"))
def odd(model, situation): return Odd(model)
def unsure(model, situation): return Unsure(model)
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "made_up_lab.py").write_text(LAB)
    (tmp_path / "broken_lab.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.chdir(tmp_path)
    for name in ("made_up_lab", "broken_lab"):
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.mark.usefixtures("lab")
@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        ("no_such_lab:rule", "There is no module `no_such_lab`; put its file in the folder"),
        ("broken_lab:rule", "`broken_lab` cannot be imported .*a_package_that_is_not_there"),
        ("made_up_lab:fail", "has no function `fail`; did you mean `fails`"),
        ("made_up_lab:number", "`made_up_lab:number` is a int, not a function"),
        ("made_up_lab:fails", "`made_up_lab:fails` failed .ZeroDivisionError: division by zero"),
        ("made_up_lab:gives_a_list", "gave a list; it must give a BoTorch AcquisitionFunction"),
        ("made_up_lab:odd", r"gives values of shape \(256, 1, 10\) for 256 candidates"),
        ("made_up_lab:unsure", "values that are not numbers"),
    ],
)
def test_a_rule_that_cannot_be_used_is_one_sentence(surrogate: Surrogate, rule: str, sentence: str):
    with pytest.raises(UsageError, match=sentence):
        propose(surrogate, 1, 1, NO_PENDING, np.random.default_rng(0), Rule(rule))


@pytest.mark.usefixtures("lab")
@pytest.mark.filterwarnings("ignore:Data .*")
@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("made_up_lab:gives_a_list", "gave a list; it must give a fitted BoTorch model"),
        ("made_up_lab:two_outcomes", r"posterior mean of shape \(2, 2\) for 2 points, it must be \(2, 1\)"),
        ("made_up_lab:nothing_known", "predicts values that are not finite"),
    ],
)
def test_a_model_that_cannot_be_used_is_one_sentence(name: str, sentence: str):
    with pytest.raises(UsageError, match=sentence):
        make_own_surrogate(name, observed(5, 5), seed=0)


@pytest.mark.usefixtures("lab")
def test_a_constraint_answers_yes_or_no():
    constraint = load_constraint("made_up_lab:gives_a_list")
    with pytest.raises(UsageError, match=r"answered \[\] for a design; it must give True or False"):
        propose(None, 1, 1, NO_PENDING, np.random.default_rng(0), Rule("random"), Room(constraint=constraint))


def test_entropy_search_works_on_a_model_of_ones_own(surrogate: Surrogate):
    """The largest values lie where the model is unsure or promises much, not at the worst known design."""
    rule = MaxValueEntropy(SurrogateModel(surrogate), points(60))
    assert isinstance(UpperConfidenceBound(SurrogateModel(surrogate), beta=1.0)(points(3, 1)), torch.Tensor)
    worst = surrogate.data.x[np.argmin(surrogate.mean(surrogate.data.x, 1))]
    there = torch.from_numpy(np.append(worst, 1.0))[None, None]
    best = PosteriorMean(SurrogateModel(surrogate))(points(60, 1, s=1)).argmax()
    assert rule(points(60, 1, s=1)[best : best + 1]) > rule(there)

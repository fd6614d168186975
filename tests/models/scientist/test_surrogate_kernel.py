"""Eq. 3 three ways: GPyTorch kernel, production arrays and a loop over the formula; GPyTorch's kernel contract."""

import unittest

import numpy as np
import pytest
import torch
from gpytorch.priors import NormalPrior
from gpytorch.test.base_kernel_test_case import BaseKernelTestCase

from fast.models.design.space import random_unit
from fast.models.scientist.surrogate.parameters import SurrogateParameters
from fast.models.scientist.surrogate.posterior import prior_covariance, prior_variance
from tests.synthetic.scientist import BiFidelityKernel

PARAMETERS = SurrogateParameters(
    rho=1.7,
    lengthscales_h=(0.3, 0.5, 0.8, 1.1, 1.4, 2.0, 0.4, 0.7, 3.0),
    lengthscales_e=(1.3, 0.6, 0.4, 2.1, 0.9, 1.0, 5.0, 0.2, 0.8),
    sd_h=2.5,
    sd_e=1.2,
    noise_sd=0.1,
    nugget=0.02,
    mean_sim=4.0,
    mean_real=11.0,
)


class TestKernelContract(BaseKernelTestCase, unittest.TestCase):
    """GPyTorch's own suite: batches, active dimensions, indexing, pickling, dtype."""

    def create_kernel_no_ard(self, **kwargs):
        return BiFidelityKernel(**kwargs)

    def create_kernel_ard(self, num_dims, **kwargs):
        return BiFidelityKernel(num_design_dims=num_dims - 1, **kwargs)


def points(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return random_unit(n, rng), rng.integers(0, 2, n)


def looped_covariance(x1, s1, x2, s2, p: SurrogateParameters) -> np.ndarray:
    def matern(a, b, lengthscales, sd):
        r = np.sqrt(5 * sum(((ai - bi) / li) ** 2 for ai, bi, li in zip(a, b, lengthscales, strict=True)))
        return sd**2 * (1 + r + r**2 / 3) * np.exp(-r)

    K = np.zeros((len(x1), len(x2)))
    for i in range(len(x1)):
        for j in range(len(x2)):
            k_rho = (1 + s1[i] * (p.rho - 1)) * (1 + s2[j] * (p.rho - 1))
            K[i, j] = k_rho * matern(x1[i], x2[j], p.lengthscales_h, p.sd_h)
            K[i, j] += s1[i] * s2[j] * matern(x1[i], x2[j], p.lengthscales_e, p.sd_e)
    return K


def test_kernel_and_production_covariance_equal_the_loop():
    (x1, s1), (x2, s2) = points(12, 0), points(9, 1)
    expected = looped_covariance(x1, s1, x2, s2, PARAMETERS)
    kernel = BiFidelityKernel.from_parameters(PARAMETERS)
    by_gpytorch = kernel(torch.tensor(np.column_stack([x1, s1])), torch.tensor(np.column_stack([x2, s2])))
    np.testing.assert_allclose(by_gpytorch.to_dense().detach().numpy(), expected, rtol=1e-9)
    np.testing.assert_allclose(prior_covariance(PARAMETERS, x1, s1, x2, s2), expected, rtol=1e-9)


def test_diagonal_is_the_prior_variance():
    x, s = points(15, 2)
    kernel = BiFidelityKernel.from_parameters(PARAMETERS)
    diagonal = kernel(torch.tensor(np.column_stack([x, s])), diag=True).detach().numpy()
    np.testing.assert_allclose(diagonal, prior_variance(PARAMETERS, s), rtol=1e-12)
    np.testing.assert_allclose(np.diag(prior_covariance(PARAMETERS, x, s, x, s)), diagonal, rtol=1e-12)


def test_rho_prior_reads_and_sets_rho():
    kernel = BiFidelityKernel(num_design_dims=9, rho_prior=NormalPrior(1.0, 0.25))
    name, module, prior, closure, set_rho = next(iter(kernel.named_priors()))
    assert name == "rho_prior"
    assert closure(module).item() == 1.0
    set_rho(module, torch.tensor(0.4))
    assert closure(module).item() == pytest.approx(0.4)
    assert prior.log_prob(closure(module)).item() < prior.log_prob(torch.tensor(1.0)).item()

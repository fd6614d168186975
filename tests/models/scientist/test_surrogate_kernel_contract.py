"""GPyTorch's own contract tests of kernels, on the kernel of Eq. 3."""

import unittest

import torch
from gpytorch.test.base_kernel_test_case import BaseKernelTestCase

from tests.synthetic.scientist import BiFidelityKernel


class BiFidelityKernelContract(BaseKernelTestCase, unittest.TestCase):
    """Diagonal, batches, active dimensions, slicing and pickling, as GPyTorch expects them of every kernel."""

    def create_kernel_no_ard(self, **kwargs):
        """One lengthscale for all design variables, as GPyTorch's tests need it."""
        return BiFidelityKernel(**kwargs)

    def create_data_no_batch(self):
        """Designs with a fidelity in the last column."""
        return torch.cat([torch.randn(50, 9), torch.randint(0, 2, (50, 1))], dim=-1)

    def create_data_single_batch(self):
        """Two sets of three designs."""
        return torch.cat([torch.randn(2, 3, 1), torch.randint(0, 2, (2, 3, 1))], dim=-1)

    def create_data_double_batch(self):
        """Three times two sets of fifty designs."""
        return torch.cat([torch.randn(3, 2, 50, 1), torch.randint(0, 2, (3, 2, 50, 1))], dim=-1)

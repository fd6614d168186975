r"""The two-fidelity covariance of the FAST paper as a GPyTorch kernel (Eq. 3).

.. math::
    k((x, s), (x', s')) = k_\rho(s, s') k_h(x, x') + s s' k_\varepsilon(x, x'), \qquad
    k_\rho(s, s') = (1 + s (\rho - 1)) (1 + s' (\rho - 1))

with Matern-5/2 kernels, one lengthscale per design variable. This is the readable reference and the way into
GPyTorch and BoTorch; the production path (`models.scientist.surrogate.likelihood`) is tested against it.
"""

from typing import Any

import torch
from gpytorch.kernels import Kernel, MaternKernel, ScaleKernel
from gpytorch.priors import NormalPrior, Prior
from linear_operator import to_dense
from torch import Tensor

from fast.models.scientist.surrogate.parameters import SurrogateParameters


class BiFidelityKernel(Kernel):
    """Covariance of the combined objective over design and fidelity, Eq. 3 of the FAST paper.

    The last input column is the fidelity s (0 sim, 1 real), all others are design variables.

    Args:
        num_design_dims: Number of design variables d for ARD; None shares one lengthscale.
        rho_prior: Prior of the scale between the fidelities; None for flat.
        batch_shape: Independent parameters per batch entry.
        active_dims: Columns of the input to use, the last of them the fidelity.

    Attributes:
        rho: Scale between the fidelities, `batch_shape`.
        kernel_h: Scaled Matern-5/2 of the simulator, d inputs.
        kernel_e: Scaled Matern-5/2 of the discrepancy, d inputs.

    Example:
        >>> kernel = BiFidelityKernel(num_design_dims=9)
        >>> kernel(torch.rand(4, 10)).shape
        torch.Size([4, 4])
    """

    has_lengthscale = False

    def __init__(
        self,
        num_design_dims: int | None = None,
        rho_prior: Prior | None = None,
        batch_shape: torch.Size = torch.Size([]),  # noqa: B008 - immutable, and GPyTorch's own default
        active_dims: list[int] | None = None,
    ) -> None:
        super().__init__(batch_shape=batch_shape, active_dims=active_dims)
        self.kernel_h = _scaled_matern(num_design_dims, batch_shape)
        self.kernel_e = _scaled_matern(num_design_dims, batch_shape)
        self.register_parameter("rho", torch.nn.Parameter(torch.ones(batch_shape)))
        if rho_prior is not None:
            self.register_prior("rho_prior", rho_prior, _get_rho, _set_rho)

    @classmethod
    def from_parameters(
        cls, parameters: SurrogateParameters, rho_prior: NormalPrior | None = None
    ) -> "BiFidelityKernel":
        """The kernel of a fitted surrogate, float64, in N^2."""
        kernel = cls(num_design_dims=len(parameters.lengthscales_h), rho_prior=rho_prior).double()
        parts = (
            (kernel.kernel_h, parameters.lengthscales_h, parameters.sd_h),
            (kernel.kernel_e, parameters.lengthscales_e, parameters.sd_e),
        )
        for part, lengthscales, sd in parts:
            part.base_kernel.lengthscale = torch.tensor(lengthscales, dtype=torch.float64)
            part.outputscale = torch.tensor(sd**2, dtype=torch.float64)
        kernel.initialize(rho=torch.tensor(parameters.rho, dtype=torch.float64))
        return kernel

    def forward(self, x1: Tensor, x2: Tensor, diag: bool = False, **params: Any) -> Tensor:
        """Covariance between `x1` (... x n x (d+1)) and `x2` (... x m x (d+1)): ... x n x m, or ... x n if `diag`."""
        s1, s2 = x1[..., -1], x2[..., -1]
        rho = self.rho.unsqueeze(-1)
        c1, c2 = 1 + s1 * (rho - 1), 1 + s2 * (rho - 1)
        h = to_dense(self.kernel_h(x1[..., :-1], x2[..., :-1], diag=diag, **params))
        e = to_dense(self.kernel_e(x1[..., :-1], x2[..., :-1], diag=diag, **params))
        if diag:
            return c1 * c2 * h + s1 * s2 * e
        return _outer(c1, c2) * h + _outer(s1, s2) * e


def _scaled_matern(n_dims: int | None, batch_shape: torch.Size) -> ScaleKernel:
    return ScaleKernel(MaternKernel(nu=2.5, ard_num_dims=n_dims, batch_shape=batch_shape), batch_shape=batch_shape)


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return a.unsqueeze(-1) * b.unsqueeze(-2)


def _get_rho(kernel: BiFidelityKernel) -> Tensor:
    return kernel.rho


def _set_rho(kernel: BiFidelityKernel, value: Tensor) -> None:
    kernel.initialize(rho=torch.as_tensor(value).to(kernel.rho))

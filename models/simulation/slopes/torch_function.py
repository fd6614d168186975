"""The peak pull-off force as a function for torch, with its slopes."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from fast.models.errors import UsageError
from fast.models.simulation.grasp import simulate_inputs
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.validation import check_again

_SOURCE = "grasp_function"


class PeakFunction:
    """Peak pull-off forces in N (...) of values (... x d) of the parameters `names`, all else as in `inputs`."""

    def __init__(self, inputs: GraspInputs, names: Sequence[str] | str | None = None) -> None:
        """Take `names`, by default the numbers of the design, whose whole ones are rounded and have slope 0.

        Raises:
            UsageError: a name is of no parameter, of one without a slope (a whole number), or there twice.
        """
        self.inputs = inputs
        fields = type(inputs.design).model_fields
        own = [name for name, info in fields.items() if info.annotation in (int, float)]
        given = own if names is None else [names] if isinstance(names, str) else names
        self._whole = {name for name in own if names is None and fields[name].annotation is int}
        self.names: list[str] = []
        long_names = []
        for name in given:
            found = {} if name in self._whole else find_parameters(inputs, (name,))
            self.names += found or [name]
            long_names += [parameter.name for parameter in found.values()] or [name]
        for place, name in enumerate(long_names):
            if name in long_names[:place]:
                raise UsageError(f"{_SOURCE}: names has `{name}` twice; leave one out.")
        self._along = tuple(name for name in self.names if name not in self._whole)

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """Simulate one grasp for every row.

        Raises:
            UsageError: no tensor of decimal numbers, of another shape, with a value out of its range, or in a
                transform of torch.func.
            MeshingFailed, SimulationFailed: a row's finger cannot be meshed, or its grasp does not converge.
        """
        if not isinstance(values, torch.Tensor) or not values.is_floating_point():
            kind = values.dtype if isinstance(values, torch.Tensor) else type(values).__name__
            raise UsageError(f"{_SOURCE}: values are {kind}; give a torch tensor of dtype torch.float64.")
        if values.shape[-1:] != (len(self.names),):
            raise UsageError(
                f"{_SOURCE}: values have the shape {tuple(values.shape)}, the last axis must be the {len(self.names)} "
                f"parameters {', '.join(self.names)}; change it."
            )
        try:
            peaks: torch.Tensor = _Peaks.apply(values, self)
        except RuntimeError as error:
            if "functorch" not in str(error):
                raise
            raise UsageError(
                f"{_SOURCE}: torch.func (vmap, grad, jacrev) cannot look into a simulation; give all rows in one "
                "tensor, and take slopes with backward() or torch.autograd.grad."
            ) from error
        return peaks

    def simulate(self, row: Sequence[float], has_slopes: bool) -> tuple[float, list[float]]:
        """Simulate the peak at one row of values, and its slopes if they are wanted."""
        inputs, whole = self.inputs, {}
        for name, value in zip(self.names, row, strict=True):
            if not math.isfinite(value):
                raise UsageError(f"{_SOURCE}: `{name}` is {value}, it must be a finite number; change it.")
            if name in self._whole:
                whole[name] = round(value)
            else:
                inputs = find_parameters(inputs, (name,))[name].put(value)
        inputs = replace(
            inputs,
            design=check_again(inputs.design.model_copy(update=whole), _SOURCE),
            version=check_again(inputs.version, _SOURCE),
            setup=check_again(inputs.setup, _SOURCE),
        )
        result = simulate_inputs(inputs, self._along if has_slopes else ())
        if result.slopes is None:
            return result.peak_force_n, [0.0] * len(row)
        for name, why in result.slopes.lost.items():
            warnings.warn(f"the slope by `{name}` is taken as 0: {why}", stacklevel=2)
        by = result.slopes.by
        return result.peak_force_n, [by[name].peak_n if name in by else 0.0 for name in self.names]


class _Peaks(torch.autograd.Function):
    """The forward pass simulates, with slopes where a gradient is wanted; the backward pass multiplies with them."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, function: PeakFunction) -> torch.Tensor:
        rows = values.detach().reshape(-1, values.shape[-1]).tolist()
        found = [function.simulate(row, ctx.needs_input_grad[0]) for row in rows]
        peaks = values.new_tensor([peak_n for peak_n, _ in found]).reshape(values.shape[:-1])
        ctx.save_for_backward(values.new_tensor([slopes for _, slopes in found]).reshape(values.shape))
        return peaks

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        if torch.is_grad_enabled():  # second derivatives would come out as 0
            raise UsageError(f"{_SOURCE}: it has no second derivatives; leave out `create_graph`.")
        (slopes,) = ctx.saved_tensors
        return gradients[0][..., None] * slopes, None

"""The peak pull-off force as a function for torch, with its slopes."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from fast.models.simulation.grasp import simulate_inputs
from fast.models.simulation.inputs import GraspInputs
from fast.models.simulation.slopes.parameters import find_parameters
from fast.models.validation import load_record


class PeakFunction:
    """Peak pull-off forces in N (...) of values (... x d) of the parameters `names`, all else as in `inputs`."""

    def __init__(self, inputs: GraspInputs, names: Sequence[str] | None = None) -> None:
        """`names` default to the numbers of the design, whose whole ones are rounded and have slope 0."""
        self.inputs = inputs
        fields = type(inputs.design).model_fields
        own = [name for name, info in fields.items() if info.annotation in (int, float)]
        self.names = list(own if names is None else names)
        self._whole = {name for name in own if fields[name].annotation is int}
        self._along = tuple(name for name in self.names if name not in self._whole)
        find_parameters(inputs, self._along)

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """One simulated grasp for every row."""
        if values.shape[-1:] != (len(self.names),):
            raise ValueError(
                f"values are {tuple(values.shape)}, their last axis must be the {len(self.names)} parameters"
            )
        peaks: torch.Tensor = _Peaks.apply(values, self)
        return peaks

    def simulate(self, row: Sequence[float], has_slopes: bool) -> tuple[float, list[float]]:
        """The peak at one row of values, and its slopes if they are wanted."""
        inputs = self.inputs
        whole = {name: round(x) for name, x in zip(self.names, row, strict=True) if name in self._whole}
        for name, value in zip(self.names, row, strict=True):
            if name not in self._whole:
                inputs = find_parameters(inputs, (name,))[name].put(value)
        numbers = inputs.design.model_dump() | whole
        design = load_record(type(inputs.design), numbers, "grasp_function")
        result = simulate_inputs(replace(inputs, design=design), self._along if has_slopes else ())
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
        (slopes,) = ctx.saved_tensors
        return gradients[0][..., None] * slopes, None

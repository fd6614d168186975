"""What is left when theta has been calibrated again: measured minus predicted forces of the grasps to learn from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.errors import UsageError
from models.gap.problem import GapProblem
from models.gap.where.phases import PHASES, amplitudes, peaks, phase_differences
from models.records import Design, Theta

MIN_TOOLS = 5  # sign flips of five tools give 32 patterns: nothing is seen with fewer
MIN_OBJECTS = 4


@dataclass(frozen=True, eq=False)
class Residuals:
    """n measured grasps of t tools on o objects with what the recalibrated simulator predicts for each.

    tool, obj, repeat: n, numbers from 0. order: n, grasps of this tool before. measured_n, predicted_n:
    n x steps. tool_factor: t, what was fitted as the modulus of each tool over the common one. numerical_n:
    t x o x v x steps, what v other meshes change at this theta; NaN where a simulation failed.
    """

    tools: tuple[str, ...]
    designs: tuple[Design, ...]
    objects: tuple[int, ...]
    tool: np.ndarray
    obj: np.ndarray
    repeat: np.ndarray
    order: np.ndarray
    measured_n: np.ndarray
    predicted_n: np.ndarray
    tool_factor: np.ndarray
    numerical_n: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            UsageError: arrays differ in length, a value is not finite, or there are too few tools or objects.
        """
        lengths = {len(getattr(self, name)) for name in ("tool", "obj", "repeat", "order", "measured_n", "predicted_n")}
        if len(lengths) != 1 or self.measured_n.shape != self.predicted_n.shape:
            raise UsageError(f"residuals have {sorted(lengths)} rows; give the same grasps to every argument.")
        if not (np.isfinite(self.measured_n).all() and np.isfinite(self.predicted_n).all()):
            raise UsageError("a trace or its prediction holds a value that is not finite; leave that grasp out.")
        n_tools, n_objects = len(np.unique(self.tool)), len(np.unique(self.obj))
        if n_tools < MIN_TOOLS or n_objects < MIN_OBJECTS:
            raise UsageError(
                f"{n_tools} tools on {n_objects} objects are left to look for a gap in, which takes {MIN_TOOLS} tools "
                f"and {MIN_OBJECTS} objects at least; measure more."
            )

    @staticmethod
    def of(
        problem: GapProblem,
        predicted_n: np.ndarray,
        theta: Theta,
        tool_factor: np.ndarray | None = None,
        is_usable: np.ndarray | None = None,
    ) -> "Residuals":
        """Residuals of the grasps that are not held out; predicted_n: n x steps of all grasps, at `theta`.

        is_usable: which of them could be predicted, n.
        """
        grasps, bank, chosen = problem.grasps, problem.bank, ~problem.is_held_out
        if is_usable is not None:
            chosen = chosen & is_usable
        scale = theta.young_modulus_mpa / bank.centre.young_modulus_mpa
        contexts = [context for context, is_chosen in zip(grasps.contexts, chosen, strict=True) if is_chosen]
        return Residuals(
            tools=grasps.tools,
            designs=grasps.designs,
            objects=grasps.objects,
            tool=grasps.tool[chosen],
            obj=grasps.obj[chosen],
            repeat=np.array([context.repeat for context in contexts]),
            order=np.array([context.tool_grasps for context in contexts], dtype=float),
            measured_n=grasps.steps_n[chosen],
            predicted_n=predicted_n[chosen],
            tool_factor=np.ones(len(grasps.tools)) if tool_factor is None else tool_factor,
            numerical_n=scale * (bank.numerical_steps_n - bank.centre_steps_n[:, :, None]),
        )

    @cached_property
    def phases_n(self) -> np.ndarray:
        """Missing force by phase, n x 5, in N; NaN where the prediction does not have the phase."""
        return phase_differences(self.measured_n, self.predicted_n)

    @cached_property
    def amplitude_n(self) -> np.ndarray:
        """Predicted peak of each grasp, n, in N; not less than a quarter of the usual one."""
        return amplitudes(self.predicted_n)

    @cached_property
    def relative(self) -> np.ndarray:
        """Missing force by phase over the predicted peak, n x 5."""
        return np.asarray(self.phases_n / self.amplitude_n[:, None])

    @cached_property
    def peak_n(self) -> np.ndarray:
        """Measured peaks, n, in N."""
        return peaks(self.measured_n)

    @cached_property
    def numerical_relative(self) -> np.ndarray:
        """The same for what other meshes change, v x n x 5: a grasp gets what its tool and object get.

        Where no other mesh was simulated the change is taken as zero.
        """
        v = self.numerical_n.shape[2]
        changes = np.nan_to_num(self.numerical_n[self.tool, self.obj])
        return np.stack(
            [
                phase_differences(self.predicted_n + changes[:, i], self.predicted_n) / self.amplitude_n[:, None]
                for i in range(v)
            ]
            or [np.zeros((len(self.tool), len(PHASES)))]
        )

"""What is left is told in words: where in the lift, and whether it stays without an object."""

import numpy as np
import pytest

from fast.models.design.space import numbered_design
from fast.models.gap.evaluation.rest import describe_rest
from fast.models.gap.where.residuals import Residuals
from fast.models.traces.step_features import N_STEPS, STEP_MM

OBJECTS = (1, 3, 6, 14, 22, 25, 28, 30, 32)
N_TOOLS, N_REPEATS = 8, 3
LIFT_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)


class Made:
    """Eight tools on nine objects three times: grasps whose simulated force ends between 22 and 34 mm of lift."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        tool, obj, repeat = np.meshgrid(*map(np.arange, (N_TOOLS, len(OBJECTS), N_REPEATS)), indexing="ij")
        self.tool, self.obj, self.repeat = tool.ravel(), obj.ravel(), repeat.ravel()
        order = np.zeros(len(self.tool))
        for number in range(N_TOOLS):
            for r in range(N_REPEATS):
                rows = np.flatnonzero((self.tool == number) & (self.repeat == r))
                order[self.rng.permutation(rows)] = r * len(OBJECTS) + np.arange(len(OBJECTS))
        self.order = order
        self.stiffness = np.linspace(0.7, 1.3, N_TOOLS)[self.rng.permutation(N_TOOLS)]
        peak = 9.0 * self.stiffness[self.tool] * np.linspace(0.7, 1.3, len(OBJECTS))[self.rng.permutation(9)][self.obj]
        end = (22.0 + 1.5 * self.obj)[:, None]
        self.predicted_n = peak[:, None] * np.where(LIFT_MM < end, np.sin(np.pi * (LIFT_MM / end) ** 0.7), 0.0)

    def told(self, extra_n: np.ndarray, noise_n: float = 0.05) -> str:
        scatter = 1.0 + 0.01 * self.rng.standard_normal((len(self.tool), 1))
        measured = self.predicted_n * scatter + extra_n + noise_n * self.rng.standard_normal(self.predicted_n.shape)
        rest = describe_rest(self.residuals(measured))
        assert len(rest.lift_mm) == len(rest.force_n) == N_STEPS
        assert all(low <= x <= high for low, x, high in zip(rest.low_n, rest.force_n, rest.high_n, strict=True))
        assert "nan" not in rest.sentence
        assert rest.has_sign is ("no sign on which" not in rest.sentence)
        return rest.sentence

    def residuals(self, measured_n: np.ndarray) -> Residuals:
        return Residuals(
            tools=tuple(f"T{number}" for number in range(N_TOOLS)),
            designs=tuple(numbered_design(number) for number in range(N_TOOLS)),
            objects=OBJECTS,
            tool=self.tool,
            obj=self.obj,
            repeat=self.repeat,
            order=self.order,
            measured_n=measured_n,
            predicted_n=self.predicted_n,
            numerical_n=np.zeros((len(self.tool), 0, N_STEPS)),
        )


@pytest.fixture
def made() -> Made:
    return Made()


def test_a_hose_pulls_on_and_grows(made: Made) -> None:
    told = made.told(np.broadcast_to(0.02 * LIFT_MM, made.predicted_n.shape))
    assert told.startswith("A pull stays after the object has gone: 0.9"), told
    assert "and grows by 0.02 N per mm." in told


def test_an_object_that_never_comes_free_has_no_say_in_what_stays(made: Made) -> None:
    made.predicted_n[made.obj == len(OBJECTS) - 1] = 5.0
    told = made.told(np.broadcast_to(0.02 * LIFT_MM, made.predicted_n.shape))
    assert told.startswith("A pull stays after the object has gone: 0.9"), told


def test_a_constant_tail_does_not_grow(made: Made) -> None:
    told = made.told(np.full_like(made.predicted_n, -0.4))
    assert told.startswith("A push stays after the object has gone: 0.4 N at 4"), told
    assert "about the same at all lifts." in told


def test_what_is_proportional_to_force_ends_with_the_object(made: Made) -> None:
    told = made.told(0.05 * made.predicted_n)
    assert told.startswith("The difference is largest at the peak: 0.4"), told
    assert "more than simulated" in told


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_says_that_there_is_nothing(seed: int) -> None:
    told = Made(seed).told(np.zeros((1, N_STEPS)))
    assert told.startswith("What is left is 0.0"), told
    assert "no sign on which tools and objects agree" in told

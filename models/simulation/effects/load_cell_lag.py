"""S4: lag of the load cell's transmitter."""

from dataclasses import dataclass

import numpy as np

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude

_LEAST_STEP_S = 0.02


@dataclass(frozen=True)
class LoadCellLag(Effect):
    """First-order lag tau dy/dt + y = u of the transmitter's filter, `time_constant_s` tau.

    Exact for a force u that is linear in time between samples. With slope m and step h:
    y_1 = u_1 - tau m + (y_0 - u_0 + tau m) exp(-h / tau).
    """

    time_constant_s: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace as the lagging transmitter reports it, starting from the true force."""
        tau = self.time_constant_s
        if tau == 0.0 or len(trace.time_s) < 2:
            return trace
        # The reported force bends between samples.
        finer_s = np.arange(trace.time_s[0], trace.time_s[-1], max(tau / 3.0, _LEAST_STEP_S))
        time_s = np.union1d(trace.time_s, finer_s)
        true = np.interp(time_s, trace.time_s, trace.force_n)
        step = np.diff(time_s)
        slope = np.divide(np.diff(true), step, out=np.zeros_like(step), where=step > 0)
        decay = np.exp(-step / tau)
        reported = true.copy()
        for i in range(len(step)):
            lag = tau * slope[i]
            reported[i + 1] = true[i + 1] - lag + (reported[i] - true[i] + lag) * decay[i]
        return Trace(time_s, np.interp(time_s, trace.time_s, trace.lift_mm), reported)


SPEC = EffectSpec(
    effect="load_cell_lag",
    title="First-order lag of the load-cell transmitter",
    code="S4",
    layer="sensor",
    kind=LoadCellLag,
    formula="time_constant_s dF'/dt + F' = F",
    source="first-order low pass of weight transmitters",
    cost="P",
    parameters=(amplitude("time_constant_s", 0.0, 2.0, (0.1, 0.2)),),
    confusable_with=("object_post_compliance", "lift_misalignment", "static_kinetic_friction", "stress_relaxation"),
)

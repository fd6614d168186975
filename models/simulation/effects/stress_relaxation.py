"""M1: linear viscoelasticity; the closed finger relaxes while it lifts."""

from dataclasses import dataclass

import numpy as np

from models.records import Trace
from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude, shape


@dataclass(frozen=True)
class StressRelaxation(Effect):
    """One-term Prony series: E(t) = E [1 - g (1 - exp(-t / tau))], t from the end of the closing.

    `relaxed_share` g of the modulus is lost in the end, `time_constant_s` tau. Theta's modulus is the one at the end of
    the closing. The force is scaled by E(t) / E: exact for the strain put in by the closing, which most of a grasp's
    strain is; strain that the lift adds or releases later is relaxed as if it were as old (quasi-linear
    viscoelasticity with one common history).
    """

    relaxed_share: float
    time_constant_s: float

    def modify_trace(self, trace: Trace) -> Trace:
        """The trace with the force of the lift relaxed."""
        if self.relaxed_share == 0.0 or not trace.is_lift.any():
            return trace
        held_s = np.maximum(trace.time_s - trace.time_s[trace.is_lift][0], 0.0)
        factor = 1.0 + self.relaxed_share * np.expm1(-held_s / self.time_constant_s)
        return Trace(trace.time_s, trace.lift_mm, factor * trace.force_n)


SPEC = EffectSpec(
    effect="stress_relaxation",
    title="The closed finger relaxes (linear viscoelasticity)",
    code="M1",
    layer="material",
    kind=StressRelaxation,
    formula="F(t) = F [1 - relaxed_share (1 - exp(-t / time_constant_s))], t: since the end of closing",
    source="Prony series, quasi-linear viscoelasticity: Fung 1993",
    cost="P",
    parameters=(
        amplitude("relaxed_share", 0.0, 0.6, (0.15, 0.1)),
        shape("time_constant_s", 0.3, 100.0, (5.0, 10.0)),
    ),
    confusable_with=("mullins_softening", "load_cell_lag", "static_kinetic_friction"),
)

"""Post-processing effects on a trace that has been simulated without them, so that they cost no simulation."""

from collections.abc import Iterable

from fast.models.errors import UsageError
from fast.models.records import Design, Theta, Trace
from fast.models.simulation.effects.base import Effect


def replayed(trace: Trace, effects: Iterable[Effect], design: Design, theta: Theta) -> Trace:
    """The trace that `simulate_grasp` gives with effects of cost `P` added to those behind `trace`.

    `effects` as they act in this grasp (`Effect.in_grasp`), `theta` that of the trace. A change of Young's modulus is a
    factor on the force: exact if every effect behind `trace` scales with the modulus and none of them changes the trace
    itself (the sensor's effects come last).

    Raises:
        UsageError: an effect changes friction or Poisson's ratio, which no trace can be scaled for.
    """
    effects = list(effects)
    real = theta
    for effect in effects:
        real = effect.modify_theta(real, design)
    if (real.friction, real.poisson_ratio) != (theta.friction, theta.poisson_ratio):
        raise UsageError("An effect changes friction or Poisson's ratio; simulate the grasp with it instead.")
    if real.young_modulus_mpa != theta.young_modulus_mpa:
        factor = real.young_modulus_mpa / theta.young_modulus_mpa
        trace = Trace(trace.time_s, trace.lift_mm, factor * trace.force_n)
    for effect in effects:
        trace = effect.modify_trace(trace)
    return trace

"""Material effects: elastic constants, by part, history and time."""

from dataclasses import dataclass, replace

import numpy as np

from fast.models.design.fin_ray import is_in_rib, take_fin_ray
from fast.models.records import Design, GraspContext, GraspSetup, Theta
from fast.models.simulation.effects.base import USUAL_LIFT_MM_PER_S, Effect, Number, Readings, approach, with_modulus
from fast.models.simulation.effects.spec import MATERIAL, MEMORY, Drift, EffectSpec, Measurement, amplitude, shape
from fast.models.simulation.effects.states import CLOCK, LEVEL, RIBS, Quantity, State, of_context

_HOUR_S = 3600.0


@dataclass(frozen=True)
class StressRelaxation(Effect):
    """One-term Prony series: E(t) = E [1 - g (1 - exp(-t / tau))], t from the end of the closing.

    `relaxed_share` g of the modulus is lost in the end, `time_constant_s` tau. Theta's modulus is the one at the end of
    the closing; a grasp that waits before its lift has relaxed by then. The force is scaled by E(t) / E: exact for the
    strain put in by the closing, which most of a grasp's strain is; strain that the lift adds or releases later is
    relaxed as if it were as old (quasi-linear viscoelasticity with one common history).
    """

    relaxed_share: float
    time_constant_s: float
    dwell_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect after the wait of this grasp."""
        return replace(self, dwell_s=setup.dwell_s)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the force over that without relaxation, after times since the end of closing in s."""
        return 1.0 - self.relaxed_share * approach(state, self.time_constant_s)

    def modify_forces(self, force_n: np.ndarray, at: Readings) -> np.ndarray:
        """Return the forces, relaxed since the end of the closing."""
        held_s = np.maximum(at.since_s + self.dwell_s, 0.0)
        lost = self.relaxed_share * approach(held_s, self.time_constant_s)
        return np.asarray(force_n - lost * force_n)


STRESS_RELAXATION = EffectSpec(
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
    state=State("time since the end of closing, s", "held", 1.0),
    quantity=Quantity("force over that without relaxation", 1.0),
    family="force that fades while it is held",
    confusable_with=("mullins_softening", "load_cell_lag", "static_kinetic_friction"),
)


@dataclass(frozen=True)
class MullinsSoftening(Effect):
    """Mullins effect over repeats: E_n = E [1 - d (1 - exp(-n / n0))] in the repeat with n repeats before it.

    `softening` d, the share of the modulus lost in the end, `scale_repeats` n0. Counted per object, because softening
    goes with the largest strain so far, and a new object brings its own.
    """

    softening: float
    scale_repeats: float
    repeat: int = 0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect in this repeat."""
        return replace(self, repeat=context.repeat)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the modulus over that of the first grasp, after so many repeats."""
        return 1.0 - self.softening * approach(state, self.scale_repeats)

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Return the softened modulus."""
        return with_modulus(theta, self.law(float(self.repeat)))


MULLINS_SOFTENING = EffectSpec(
    effect="mullins_softening",
    title="Cyclic softening over repeats (Mullins effect)",
    code="M2",
    layer="material",
    kind=MullinsSoftening,
    formula="E_n = E [1 - softening (1 - exp(-n / scale_repeats))], n: repeats before",
    source="Mullins 1969; Ogden & Roxburgh 1999",
    cost="P",
    parameters=(amplitude("softening", 0.0, 0.3, (0.05, 0.06)), shape("scale_repeats", 1.0, 20.0, (2.0, 3.0))),
    state=State("repeats before", of_context("repeat"), 2.0),
    quantity=Quantity("modulus over that of the first grasp", 1.0),
    drift=Drift(quantity="modulus", clocks=("tool", "repeat")),
    family=MEMORY,
    experiment="rest for an hour and grasp the first object again",
    confusable_with=("friction_wear", "pressure_droop", "stress_relaxation"),
)


@dataclass(frozen=True)
class HyperelasticStiffening(Effect):
    """Strain energy W + beta W^2 / E over that of the simulator's neo-Hookean law W: stresses times 1 + 2 beta W / E.

    In tension by a small strain eps W is E eps^2 / 2, so sigma = E eps (1 + beta eps^2), with `stiffening` beta. A
    second-order term as Yeoh's, in the energy instead of the first invariant: it stays hyperelastic, keeps the force
    proportional to Young's modulus, and needs one more rank-one term per quadrature point in the tangent. For a Gent
    material beta is about 3 / J_m, so 0 to 5 is plausible; the walls of a finger strain so little that 5 raises the
    peak by 0.2 to 2 % only.
    """

    stiffening: float

    def strain_stiffening(self) -> float:
        """Return beta, a pure number."""
        return self.stiffening


HYPERELASTIC_STIFFENING = EffectSpec(
    effect="hyperelastic_stiffening",
    title="The material stiffens with strain",
    code="M3",
    layer="material",
    kind=HyperelasticStiffening,
    formula="energy W + stiffening W^2 / E, i.e. sigma = E eps (1 + stiffening eps^2)",
    source="second-order term after Yeoh 1993",
    cost="F",
    parameters=(amplitude("stiffening", 0.0, 20.0, (1.0, 2.0)),),
    state=LEVEL,
    bank_runs=({"stiffening": 2.0}, {"stiffening": 8.0}),
    family=MATERIAL,
    confusable_with=("wall_thickness_offset", "load_cell_gain", "force_limited_closing", "rib_imperfection"),
)


@dataclass(frozen=True)
class TemperatureSoftening(Effect):
    """E(T) = E [1 - c (T - T0)] with a temperature that settles, T - T0 = dT (1 - exp(-t / tau)).

    Force data hold only the product `softening` = c dT, the share of the modulus lost when warm (negative: the lab
    cools). `warm_up_s` tau, t the clock time since the batch began. c is 0.01 to 0.04 per kelvin for print materials
    near their glass transition, so 0.1 is 2.5 to 10 K.
    """

    softening: float
    warm_up_s: float
    clock_s: float = 0.0

    def in_grasp(self, design: Design, setup: GraspSetup, context: GraspContext) -> Effect:
        """Return the effect at this time of the batch."""
        return replace(self, clock_s=context.clock_s)

    def law(self, state: Number, lift_speed_mm_per_s: float = USUAL_LIFT_MM_PER_S) -> Number:
        """Return the modulus over that when the batch began, after times in h."""
        return self._soften(state * _HOUR_S)

    def _soften(self, clock_s: Number) -> Number:
        return 1.0 - self.softening * approach(clock_s, self.warm_up_s)

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Return the modulus at the present temperature."""
        return with_modulus(theta, self._soften(self.clock_s))


TEMPERATURE_SOFTENING = EffectSpec(
    effect="temperature_softening",
    title="The material softens as it warms over the batch",
    code="M5",
    layer="material",
    kind=TemperatureSoftening,
    formula="E(t) = E [1 - softening (1 - exp(-t / warm_up_s))], t: clock time since the batch began",
    source="linear softening below the glass transition: Ward & Sweeney 2012; Newton's law of heating",
    cost="P",
    parameters=(amplitude("softening", -0.3, 0.4, (0.1, 0.1)), shape("warm_up_s", 300.0, 36000.0, (3600.0, 3600.0))),
    state=CLOCK,
    quantity=Quantity("modulus over that when the batch began", 1.0),
    drift=Drift(quantity="modulus", clocks=("batch",)),
    family=MEMORY,
    experiment="log the temperature, and grasp a reference object with a reference tool every 36 grasps",
    confusable_with=("load_cell_drift", "friction_wear", "pressure_droop", "batch_ageing"),
)


@dataclass(frozen=True)
class BatchAgeing(Effect):
    """Post-cure and moisture change the modulus with age, E(t) = E [1 + b log(1 + t / t0)].

    All grasps of a batch are made within hours and ageing takes days, so only its `change` = b log(1 + t / t0) at the
    time of the test acts. It is an exact alias of the modulus of the batch's tools.
    """

    change: float

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Return the modulus of the aged tool."""
        return with_modulus(theta, 1.0 + self.change)


BATCH_AGEING = EffectSpec(
    effect="batch_ageing",
    title="Ageing or moisture of a print batch",
    code="M6",
    layer="material",
    kind=BatchAgeing,
    formula="E' = E (1 + change), change = b log(1 + t / t0) at age t",
    source="physical ageing, logarithmic in time: Struik 1978",
    cost="P",
    parameters=(amplitude("change", -0.3, 0.3, (0.0, 0.1)),),
    family=MATERIAL,
    experiment="test a tool of an old batch again, or pull a tensile bar of each batch",
    confusable_with=("temperature_softening",),
    alias_of="tool_modulus",
)


@dataclass(frozen=True)
class PrintAnisotropy(Effect):
    """The modulus of the ribs is 1 + a times that of walls and tip, with `rib_excess` a.

    Strands or layers run along the walls and across the ribs, or the other way round. Each part is isotropic:
    thin parts bend and stretch along themselves, so of a transversely isotropic material the one modulus along each
    part counts.
    """

    rib_excess: float

    def stiffness_factor(self, points: np.ndarray, design: Design) -> np.ndarray | float:
        """Return the factor (n) on the modulus of elements with middles at `points` (n, 2) of the section, mm."""
        if self.rib_excess == 0.0:
            return 1.0
        return np.where(
            is_in_rib(points, take_fin_ray(design, "the effect `print_anisotropy`")), 1.0 + self.rib_excess, 1.0
        )


PRINT_ANISOTROPY = EffectSpec(
    effect="print_anisotropy",
    title="Ribs and walls differ in modulus (print direction)",
    code="M7",
    layer="material",
    kind=PrintAnisotropy,
    formula="E of ribs = (1 + rib_excess) E of walls and tip",
    source="anisotropy of printed parts: Ahn et al. 2002",
    cost="F",
    needs_fin_ray=True,
    parameters=(amplitude("rib_excess", -0.4, 0.4, (0.1, 0.15)),),
    state=RIBS,
    bank_runs=({"rib_excess": -0.25}, {"rib_excess": 0.25}),
    family=MATERIAL,
    experiment="tensile bars printed in two orientations",
    measurement=Measurement(
        kind="tensile_bar",
        words="pull two tensile bars, printed upright and flat, and take the ratio of their moduli, "
        "upright over flat, less 1",
        label="Ratio of moduli, less 1",
        parameter="rib_excess",
        sd=0.05,
        minutes=60.0,
        values=(-0.9, 2.0),
    ),
    confusable_with=("wall_thickness_offset", "batch_ageing"),
)


SPECS = (
    STRESS_RELAXATION,
    MULLINS_SOFTENING,
    HYPERELASTIC_STIFFENING,
    TEMPERATURE_SOFTENING,
    BATCH_AGEING,
    PRINT_ANISOTROPY,
)

"""M3: a material that stiffens with strain."""

from dataclasses import dataclass

from models.simulation.effects.base import Effect
from models.simulation.effects.spec import EffectSpec, amplitude


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
        """beta, a pure number."""
        return self.stiffening


SPEC = EffectSpec(
    effect="hyperelastic_stiffening",
    title="The material stiffens with strain",
    code="M3",
    layer="material",
    kind=HyperelasticStiffening,
    formula="energy W + stiffening W^2 / E, i.e. sigma = E eps (1 + stiffening eps^2)",
    source="second-order term after Yeoh 1993",
    cost="F",
    parameters=(amplitude("stiffening", 0.0, 20.0, (1.0, 2.0)),),
    confusable_with=("wall_thickness_offset", "load_cell_gain", "force_limited_closing", "rib_imperfection"),
)

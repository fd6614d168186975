"""True grasps: another mesh, contact law and step size than the simulator's, and one hidden law at most.

Laws of cost P (time, sensors, memory) need no grasp of their own; `fast.flows.challenge.hidden.lab_laws` has them.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from fast.flows.challenge.hidden.panels import MODULUS_MPA, UNSCALED, TrueSet, draw_tool_modulus
from fast.hardware.virtual.world.hidden import DirectionalDilation, LeakyCylinder, RationalSlipFriction
from fast.hardware.virtual.world.state import USUAL_PRESSURE_PSI
from fast.models.design.space import numbered_design
from fast.models.errors import MeshingFailed, SimulationFailed, UsageError
from fast.models.ids import content_id, seed_from
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspSetup, GraspSimulation, Placement, Record, Theta, Trace
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.version import MeshSettings, SimulatorVersion
from fast.models.solver_code import source_id
from fast.models.validation import closest
from tests.studies.gap.grasp_laws import body_laws as body
from tests.studies.gap.grasp_laws import contact_laws as contact
from tests.studies.gap.grasp_laws import other_laws as other

SETUP = GraspSetup()
# Shorter walls, flatter fillets: none of the meshes that the simulator's numerical error is estimated from.
MESH = MeshSettings(edge_mm=4.4, fillet_mm=0.4)
CONTACT_N_PER_MM3 = (4.8, 3.2)  # normal, tangential
PLACEMENT_SD_MM = 0.2
DEADLINE_S = 300.0
_MODEL_SOURCES = ("design/fin_ray.py", "objects", "simulation")


class TrueGrasp(Record):
    """One grasp of a truth."""

    theta: Theta
    """Of the world."""
    design: int
    """Number."""
    object_id: int
    """What is grasped."""
    law: str = ""
    """Its name in `GRASP_LAWS`, or empty."""
    is_other: bool = False
    """Whether the law is the second one, of `OTHER_GRASP_LAWS`."""
    parameters: dict[str, float] = {}
    """Of the law."""
    raised_mm: float = 0.0
    """The object above its place."""
    setup: GraspSetup = SETUP
    """As asked for; jaws reach another force with other air."""
    placement: Placement = Placement()
    """As asked for."""

    @property
    def grasp_id(self) -> str:
        """Id derived from the content and from the code that decides the result."""
        rare = ("is_other", "setup", "placement")
        usual = {name for name in rare if getattr(self, name) == TrueGrasp.model_fields[name].default}
        code = truth_code(self.law, self.is_other)
        return content_id("U", {"grasp": self.model_dump(mode="json", exclude=usual), "code": code})

    @property
    def tool_seed(self) -> int:
        """What draws the print of this design: the same whatever is hidden."""
        return seed_from("true tool", self.design)


def list_grasps(one: TrueSet, designs: Sequence[int], objects: Sequence[int]) -> list[list[TrueGrasp]]:
    """Grasps of a set by design, since a design's grasps share a mesh."""
    theta = Theta(young_modulus_mpa=MODULUS_MPA, friction=one.theta[0], poisson_ratio=one.theta[1])
    law = one.model_dump(include={"law", "is_other", "parameters", "raised_mm"})
    return [
        [TrueGrasp(theta=theta, design=design, object_id=object_id, **law) for object_id in objects]
        for design in designs
    ]


_Build = Callable[[Mapping[str, float], TrueGrasp], Effect]


@dataclass(frozen=True)
class GraspLaw:
    """A hidden law by its effect class and how it is built for a grasp."""

    kind: type[Effect]
    build: _Build


def _plain(kind: Callable[..., Effect]) -> _Build:
    return lambda parameters, grasp: kind(**parameters)


def _by_tool(kind: Callable[..., Effect]) -> _Build:
    return lambda parameters, grasp: kind(**parameters, tool_seed=grasp.tool_seed)


def _by_design(kind: Callable[..., Effect]) -> _Build:
    return lambda parameters, grasp: kind(**parameters, design=numbered_design(grasp.design))


def _by_friction(kind: Callable[..., Effect]) -> _Build:
    return lambda parameters, grasp: kind(**parameters, friction=grasp.theta.friction)


def _by_air(build: _Build) -> _Build:
    """Jaws at the air of the grasp: a cylinder's force goes with its pressure."""

    def at_air(parameters: Mapping[str, float], grasp: TrueGrasp) -> Effect:
        psi = USUAL_PRESSURE_PSI if grasp.setup.supply_pressure_psi is None else grasp.setup.supply_pressure_psi
        return build({"max_force_n": parameters["max_force_n"] * psi / USUAL_PRESSURE_PSI}, grasp)

    return at_air


# By the name of the catalogue's effect of the same physics; what no catalogue lists comes last.
GRASP_LAWS: Mapping[str, GraspLaw] = {
    "static_kinetic_friction": GraspLaw(RationalSlipFriction, _plain(RationalSlipFriction)),
    "object_edge_radius": GraspLaw(contact.WornEdges, _plain(contact.WornEdges)),
    "force_limited_closing": GraspLaw(LeakyCylinder, _by_air(_by_tool(LeakyCylinder))),
    "wall_thickness_offset": GraspLaw(DirectionalDilation, _by_tool(DirectionalDilation)),
    "hyperelastic_stiffening": GraspLaw(body.ScatteredStiffening, _by_tool(body.ScatteredStiffening)),
    "shear_adhesion": GraspLaw(contact.SaturatingAdhesion, _by_friction(contact.SaturatingAdhesion)),
    "finger_finger_contact": GraspLaw(contact.FlashedFingers, _by_tool(contact.FlashedFingers)),
    "base_compliance": GraspLaw(body.SlackMount, _plain(body.SlackMount)),
    "pressure_dependent_friction": GraspLaw(contact.HertzFriction, _plain(contact.HertzFriction)),
    "print_anisotropy": GraspLaw(body.LayeredModulus, _plain(body.LayeredModulus)),
    "rib_imperfection": GraspLaw(body.WavyRibs, _by_tool(body.WavyRibs)),
    "wider_closing": GraspLaw(body.WiderClosing, _plain(body.WiderClosing)),
    "scaled_objects": GraspLaw(contact.ScaledObjects, _plain(contact.ScaledObjects)),
    "other_material_law": GraspLaw(body.OtherMaterialLaw, _plain(body.OtherMaterialLaw)),
    "weak_finger": GraspLaw(body.WeakFinger, _by_tool(body.WeakFinger)),
    "soft_objects": GraspLaw(contact.SoftObjects, _plain(contact.SoftObjects)),
    "object_surfaces": GraspLaw(
        contact.ObjectSurfaces,
        lambda parameters, grasp: contact.ObjectSurfaces(**parameters, object_id=grasp.object_id),
    ),
}

# A second law of each of the catalogue's effects.
OTHER_GRASP_LAWS: Mapping[str, GraspLaw] = {
    "static_kinetic_friction": GraspLaw(other.LinearSlipFriction, _plain(other.LinearSlipFriction)),
    "object_edge_radius": GraspLaw(other.TumbledEdges, _plain(other.TumbledEdges)),
    "force_limited_closing": GraspLaw(other.LeaningJaws, _by_air(_by_design(other.LeaningJaws))),
    "wall_thickness_offset": GraspLaw(other.SquashedLayers, _plain(other.SquashedLayers)),
    "hyperelastic_stiffening": GraspLaw(other.CuredStiffening, _by_design(other.CuredStiffening)),
    "shear_adhesion": GraspLaw(other.SpotAdhesion, _by_friction(other.SpotAdhesion)),
    "finger_finger_contact": GraspLaw(other.WarpedFingers, _by_design(other.WarpedFingers)),
    "base_compliance": GraspLaw(other.TiltingMount, _by_design(other.TiltingMount)),
    "pressure_dependent_friction": GraspLaw(other.FadingFriction, _plain(other.FadingFriction)),
    "print_anisotropy": GraspLaw(other.StrandedRibs, _plain(other.StrandedRibs)),
    "rib_imperfection": GraspLaw(other.SaggingRibs, _plain(other.SaggingRibs)),
}


@cache
def truth_code(law: str, is_other: bool = False) -> str:
    """Id of the code that decides a true grasp: the solver, this module, `parts`, and the class of the law."""
    here = source_id(Path(__file__).parent, ("truth.py", "parts.py"))
    models = source_id(Path(inspect.getfile(Effect)).parents[2], _MODEL_SOURCES)
    own = "" if not law else content_id("U", {"source": inspect.getsource(hidden_law(law, is_other).kind)})
    return f"{models}-{here}{own}"


def hidden_law(name: str, is_other: bool = False) -> GraspLaw:
    """The law of this name, or the second one.

    Raises:
        UsageError: there is none.
    """
    laws = OTHER_GRASP_LAWS if is_other else GRASP_LAWS
    if name not in laws:
        raise UsageError(f"no hidden law is called `{name}`; {closest(name, list(laws))}")
    return laws[name]


def tool_modulus_factor(grasp: TrueGrasp) -> float:
    """Modulus of a print over theta's, drawn for the tool.

    Only laws that break the scaling of forces with the modulus are solved with it; a world scales all other traces.
    """
    return draw_tool_modulus(grasp.design) if grasp.law in UNSCALED else 1.0


def true_placement(grasp: TrueGrasp) -> Placement:
    """Where the object sits: the same under every law, so that a law's strength is not mixed with it."""
    seed = seed_from("true placement", grasp.design, grasp.object_id, str(grasp.theta.friction))
    offset_mm = PLACEMENT_SD_MM * float(np.clip(np.random.default_rng(seed).standard_normal(), -3.0, 3.0))
    return grasp.placement.model_copy(update={"offset_z_mm": offset_mm + grasp.raised_mm})


def solve_truth(grasp: TrueGrasp) -> GraspSimulation:
    """Solve a true grasp with the finite elements.

    Raises:
        SimulationFailed: no solution, or no mesh (reason `mesh_...`).
        UsageError: the law does not exist.
    """
    effects = [hidden_law(grasp.law, grasp.is_other).build(grasp.parameters, grasp)] if grasp.law else []
    solved = _solve(grasp, effects)
    if any(isinstance(effect, body.WeakFinger) for effect in effects):
        return replace(solved, trace=_mean_trace(solved.trace, _solve(grasp, []).trace))
    return solved


def _solve(grasp: TrueGrasp, effects: Sequence[Effect]) -> GraspSimulation:
    from fast.models.simulation.contact.law import ContactLaw  # heavy: compiles on first use
    from fast.models.simulation.grasp import Numerics, simulate_grasp
    from fast.models.simulation.solver.stepping import StepLimits

    is_other = any(isinstance(effect, body.OtherMaterialLaw) for effect in effects)
    normal, tangential = CONTACT_N_PER_MM3
    for effect in effects:
        if isinstance(effect, contact.SoftObjects):
            normal, tangential = effect.in_series(normal), effect.in_series(tangential)
    modulus_mpa = grasp.theta.young_modulus_mpa * tool_modulus_factor(grasp)
    theta = grasp.theta.model_copy(update={"young_modulus_mpa": modulus_mpa})
    numerics = Numerics(
        contact=ContactLaw(normal_n_per_mm3=normal, tangential_n_per_mm3=tangential, smoothing_mm=0.04),
        limits=StepLimits(closing_mm=1.7, fine_lift_mm=0.4, lift_mm=1.6),
        material_law="st_venant_kirchhoff" if is_other else "neo_hookean",
    )
    try:
        return simulate_grasp(
            numbered_design(grasp.design),
            get_object(grasp.object_id),
            SimulatorVersion(theta=theta, mesh=MESH),
            grasp.setup,
            placement=true_placement(grasp),
            effects=effects,
            numerics=numerics,
            deadline_s=DEADLINE_S,
        )
    except MeshingFailed as failure:
        raise SimulationFailed(str(failure), f"mesh_{failure.reason}") from failure


def _mean_trace(first: Trace, second: Trace) -> Trace:
    """The mean force of two traces of one setup at the times of both; a finger that has let go pulls no more."""
    time_s = np.union1d(first.time_s, second.time_s)
    force_n = 0.5 * sum(np.interp(time_s, one.time_s, one.force_n) for one in (first, second))
    longer = max((first, second), key=lambda one: float(one.time_s[-1]))
    return Trace(time_s, np.interp(time_s, longer.time_s, longer.lift_mm), np.asarray(force_n))

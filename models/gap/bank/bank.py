"""The bank: the simulations that explain a gap, the same whatever is missing; which they are, and them as arrays.

Young's modulus is a factor on the force and costs nothing. Effects of cost P are replayed on traces. Effects with a
memory (wear, softening, pressure) act through friction, modulus or closing, which the grid and the closings span. What
is left, effects of cost C and F, is simulated at a few amplitudes around one theta: secants, never slopes at zero,
since a stalling jaw or a touching finger has none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fast.models.calibration.traces.response_surface import LEAST_AMPLITUDE
from fast.models.calibration.traces.theta_grid import GRID_MODULUS_MPA, ThetaGrid
from fast.models.design.fin_ray import FinRay
from fast.models.gap.grasps import Grasps, Target
from fast.models.records import Design, EffectValue, Record, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import IN_ROWS, ContactSettings, MeshSettings, SimulatorVersion

CENTRE = Theta(young_modulus_mpa=GRID_MODULUS_MPA, friction=0.6, poisson_ratio=0.42)

# Numerical variants, other choices of a simulator of the same physics: what they change is not to be explained by an
# effect. How far a contact gives way before it slides decides the first millimetre of the lift (decision 052); contact
# points in straight rows ripple, as those of many a simulator do (decision 086).
NUMERICAL: tuple[Mapping[str, Record | str], ...] = (
    {"mesh": MeshSettings(edge_mm=5.0)},
    {"contact": ContactSettings(tangential_n_per_mm3=2.0)},
    {"contact": ContactSettings(tangential_n_per_mm3=8.0)},
    {"fem_version": IN_ROWS},
)

# How much deeper the tips stand below the object, in mm: a bench places objects to about this height.
DEEPER_MM = (-0.25, 0.25)

# Gaps at which jaws stop that lose pressure, wider than the setup's by so much, in mm.
WIDER_MM = (1.0, 3.0)

# Other setups, in which the centre alone is simulated: the arrays of a bank that they fill, and what they add to what.
OTHER_SETUPS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "placed_steps_n": ("tip_below_mm", DEEPER_MM),
    "wider_steps_n": ("closed_gap_mm", WIDER_MM),
}

# Arrays of a bank that a local one takes over from the wide one unless it has its own.
VARIANTS = ("numerical_steps_n", "placed_steps_n", "wider_steps_n")

# Effects that need simulations of their own, and of these the ones that need jaws that stop early.
CLOSED_LESS = tuple(name for name, spec in CATALOGUE.items() if spec.needs_wider_gaps)
SIMULATED = (*(name for name, spec in CATALOGUE.items() if spec.bank_runs), *CLOSED_LESS)

# Of a bank around a fitted theta, which may lie this near to an end of its grid before the bank is moved.
LOCAL_FRICTION_SHARE, LOCAL_RATIO = 0.2, 0.04
_EDGE_SHARE = 0.02
_MODULUS_STEP, _FRICTION_STEP, _RATIO_STEP = 0.1, 0.04, 0.02  # of the lattice of such banks; of ln E
_WIDER = 1.25  # from one width of a grid to the next


@dataclass(frozen=True)
class BankPlan:
    """What a bank holds: simulations of a grid of theta, and of everything else at its centre.

    The default is the wide bank: all that is plausible, with every effect, numerical variants, and other placements.
    A local one has a cross of theta and some effects; how much variants and placements change, it takes from the wide
    bank, and so it does with jaws that stop early unless it has their effect. `effects`: names, of
    `SIMULATED`. `runs`: of these effects at parameters of their own, besides those of the catalogue.
    """

    centre: Theta = CENTRE
    grid: ThetaGrid = ThetaGrid()
    effects: tuple[str, ...] = SIMULATED
    is_local: bool = False
    runs: tuple[EffectValue, ...] = ()

    @staticmethod
    def around(theta: np.ndarray, within: np.ndarray, effects: Sequence[str]) -> "BankPlan":
        """Make a bank around theta (3), whose grid also holds other frictions and Poisson ratios (`within`, p x 2).

        The cross reaches friction by 20 % and Poisson ratio by 0.04 to either side, farther in steps of a quarter, and
        never beyond the wide bank. The centre lies on a lattice, of which half a step is a sixth to a quarter of that:
        the next search of a campaign, which knows more grasps and so another theta, mostly finds its bank in the lake.
        """
        wide = ThetaGrid()
        modulus_mpa = float(f"{np.exp(_MODULUS_STEP * np.round(np.log(theta[0]) / _MODULUS_STEP)):.3g}")
        friction = float(np.clip(_to_step(theta[1], _FRICTION_STEP), *wide.friction))
        ratio = float(np.clip(_to_step(theta[2], _RATIO_STEP), *wide.poisson_ratio))
        centre = Theta(young_modulus_mpa=modulus_mpa, friction=friction, poisson_ratio=ratio)
        grid = ThetaGrid(
            friction=_find_range(friction, LOCAL_FRICTION_SHARE * friction, within[:, 0], wide.friction),
            poisson_ratio=_find_range(ratio, LOCAL_RATIO, within[:, 1], wide.poisson_ratio),
            n_friction=3,
            n_poisson_ratio=3,
            is_cross=True,
        )
        return BankPlan(centre, grid, tuple(name for name in SIMULATED if name in effects), is_local=True)

    def leave_out_effects(self, designs: Sequence[Design]) -> "BankPlan":
        """Return this plan without the effects that need fin rays, where not all designs are."""
        if all(isinstance(design, FinRay) for design in designs):
            return self
        effects = tuple(name for name in self.effects if not CATALOGUE[name].needs_fin_ray)
        return replace(self, effects=effects)

    def list_amplitudes(self, effect: str) -> tuple[Mapping[str, float], ...]:
        """List parameters at which an effect is simulated; none for one that needs no runs of its own."""
        own = (value.parameters for value in self.runs if value.effect == effect)
        return (*CATALOGUE[effect].bank_runs, *own)

    @property
    def grid_thetas(self) -> tuple[Theta, ...]:
        """Theta of every point of the grid, with the centre's modulus."""
        points = self.grid.points
        return tuple(self.centre.model_copy(update={"friction": mu, "poisson_ratio": nu}) for mu, nu in points)

    def is_at_edge(self, theta: np.ndarray) -> bool:
        """Return whether theta (3) lies at an end of the grid, beyond which the wide bank goes on."""
        wide = ThetaGrid()
        sides = ((self.grid.friction, wide.friction), (self.grid.poisson_ratio, wide.poisson_ratio))
        for value, ((low, high), (lowest, highest)) in zip(theta[1:], sides, strict=True):
            margin = _EDGE_SHARE * (high - low)
            if (low > lowest and value < low + margin) or (high < highest and value > high - margin):
                return True
        return False


WIDE = BankPlan()


@dataclass(frozen=True, eq=False)
class EffectRuns:
    """Simulations of one effect of the bank, at a amplitudes around the centre.

    steps_n: t x k x a x 120; NaN where a simulation failed.
    """

    effect: str
    parameters: tuple[Mapping[str, float], ...]
    steps_n: np.ndarray


@dataclass(frozen=True, eq=False)
class Bank:
    """Simulations of t tools' designs on k targets, as step means (120); forces at `centre.young_modulus_mpa`.

    NaN where a simulation failed, or was not asked for: other targets than those of the base setup are simulated for
    the tools that were measured on them.
    """

    targets: tuple[Target, ...]
    """k, what the tools close on."""
    centre: Theta
    """Theta of everything but the grid."""
    grid: np.ndarray
    """g x 2, friction and Poisson ratio."""
    grid_steps_n: np.ndarray
    """t x k x g x 120, at the points of the grid."""
    grid_lead_n: np.ndarray
    """t x k x g x 12, the same before the lift, see `sensor_effects.read_lead`, at the timing of the base setup."""
    centre_steps_n: np.ndarray
    """t x k x 120, at the centre."""
    numerical_steps_n: np.ndarray
    """t x k x v x 120, the centre in the variants of `NUMERICAL`."""
    placed_steps_n: np.ndarray
    """t x k x 2 x 120, the centre with tips deeper by `DEEPER_MM`."""
    wider_steps_n: np.ndarray
    """t x k x 2 x 120, the centre with jaws that stop earlier by `WIDER_MM`."""
    effects: Mapping[str, EffectRuns]
    """Runs of the effects of cost C and F, by name."""
    failed_share: float = 0.0
    """Of all simulations that were asked for."""

    def find_columns(self, grasps: Grasps) -> np.ndarray:
        """Find the number of each grasp's target in the bank, n; -1 where the bank does not have it."""
        numbers = {target.key: number for number, target in enumerate(self.targets)}
        return np.array([numbers.get(target.key, -1) for target in grasps.target], dtype=int)

    def find_usual_columns(self, grasps: Grasps) -> np.ndarray:
        """Find the number of the target of each grasp's object by the base setup, n."""
        usual = [Target(object_id, grasps.base_setup).key for object_id in grasps.objects]
        numbers = {target.key: number for number, target in enumerate(self.targets)}
        return np.array([numbers[target] for target in usual])[grasps.obj]


def list_versions(base: SimulatorVersion, plan: BankPlan = WIDE) -> tuple[SimulatorVersion, ...]:
    """List simulator versions of a bank around `base`: the grid of theta, the centre, numerical variants, and effects.

    A centre that is a point of the grid is there twice.
    """
    centre = base.model_copy(update={"theta": plan.centre})
    thetas = [base.model_copy(update={"theta": theta}) for theta in plan.grid_thetas]
    numerical = [] if plan.is_local else [centre.model_copy(update=dict(choice)) for choice in NUMERICAL]
    effects = [add_effect(centre, name, values) for name in plan.effects for values in plan.list_amplitudes(name)]
    return (*thetas, centre, *numerical, *effects)


def add_effect(version: SimulatorVersion, effect: str, parameters: Mapping[str, float]) -> SimulatorVersion:
    """Add one more effect to the version; parameters that are not given take their neutral values."""
    value = EffectValue(effect=effect, parameters=dict(parameters))
    return version.model_copy(update={"effects": (*version.effects, value)})


def carry_changes(steps_n: np.ndarray, from_n: np.ndarray, to_n: np.ndarray) -> np.ndarray:
    """Turn variants (t x k x v x 120) of a centre `from_n` (t x k x 120) into those of another, t x k x v x 120.

    What a variant changes in a cell goes with the root mean square of its force.
    """
    from_size, to_size = (np.sqrt(np.mean(force_n**2, axis=-1)) for force_n in (from_n, to_n))
    grows = to_size / np.maximum(from_size, LEAST_AMPLITUDE * np.nanmedian(from_size))
    return np.asarray(to_n[:, :, None] + grows[..., None, None] * (steps_n - from_n[:, :, None]))


def _find_range(middle: float, usual: float, within: np.ndarray, widest: tuple[float, float]) -> tuple[float, float]:
    """Find an interval about the middle that holds `within`: the usual half width or one of few larger ones."""
    needed = float(np.abs(within - middle).max()) / usual
    half = usual * _WIDER ** max(0.0, float(np.ceil(round(np.log(max(needed, 1e-9)) / np.log(_WIDER), 6))))
    return max(round(middle - half, 4), widest[0]), min(round(middle + half, 4), widest[1])


def _to_step(value: float, step: float) -> float:
    return round(step * float(np.round(value / step)), 4)

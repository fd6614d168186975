"""What the simulator says of every measured grasp, at any theta and with any effects, from the bank alone.

Polynomials in friction and Poisson ratio carry theta, Young's modulus is a factor. An effect acts through what it
changes: friction, modulus or closing of one grasp (memory), a field of the bank, or the finished trace.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.calibration.traces.response_surface import ResponseSurfaces, n_terms
from models.errors import UsageError
from models.gap.bank.effect_fields import FieldSurface, friction_factor_of_reference
from models.gap.bank.features import features_of_steps
from models.gap.bank.sensor_effects import N_LEAD, acts_on_traces, sensed
from models.gap.problem import Bank, Field, GapProblem, Grasps
from models.records import EffectValue, Theta
from models.simulation.effects.base import Effect
from models.simulation.effects.catalogue import CATALOGUE, build_effects

LEAST_MADE = 0.9  # of the cells: an amplitude of which less was simulated is left alone


@dataclass(frozen=True, eq=False)
class Predictor:
    """Step means of n grasps; grasps of cells whose base could not be simulated are not usable (n).

    surfaces, rows_n: of the end of closing and step means (132, see `sensing`), rows_n of each grasp.
    """

    grasps: Grasps
    centre: Theta
    surfaces: ResponseSurfaces
    rows_n: np.ndarray
    fields: dict[str, FieldSurface]
    wider_mm: np.ndarray
    wider_n: np.ndarray
    is_usable: np.ndarray

    @staticmethod
    def of(problem: GapProblem) -> "Predictor":
        """The predictor of a problem's grasps."""
        bank, grasps = problem.bank, problem.grasps
        n_known = np.isfinite(bank.grid_steps_n).all(axis=-1).sum(axis=-1)
        is_known = (n_known > n_terms(bank.grid)) & np.isfinite(bank.centre_steps_n).all(axis=-1)
        with_lead_n = np.concatenate([bank.grid_lead_n, bank.grid_steps_n], axis=-1)
        every = np.ones(with_lead_n.shape[-1], dtype=bool)
        surfaces = ResponseSurfaces.fitted(bank.grid, with_lead_n, is_known, bank.centre.young_modulus_mpa, every)
        nothing = np.zeros((*bank.centre_steps_n.shape[:2], 1, bank.centre_steps_n.shape[-1]))
        wider_n = np.nan_to_num(bank.wider_steps_n - bank.centre_steps_n[:, :, None])
        return Predictor(
            grasps=grasps,
            centre=bank.centre,
            surfaces=surfaces,
            rows_n=surfaces.coefficients[grasps.tool, grasps.obj],
            fields=_surfaces_of_fields(bank),
            wider_mm=np.concatenate([[0.0], bank.wider_mm]),
            wider_n=np.concatenate([nothing, wider_n], axis=2),
            is_usable=is_known[grasps.tool, grasps.obj],
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Effects of the catalogue that these data and this bank can tell from theta in principle."""
        return tuple(name for name, spec in CATALOGUE.items() if spec.alias_of is None and self.can(name))

    def can(self, effect: str) -> bool:
        """Whether the effect can be predicted: it has a field, acts on traces, or through a memory."""
        kind = CATALOGUE[effect].kind
        hooks = ("modify_theta", "friction_factor", "modify_setup", "modify_trace")
        has_memory = kind.in_grasp is not Effect.in_grasp
        on_trace = kind.modify_trace is not Effect.modify_trace
        acts = any(getattr(kind, hook) is not getattr(Effect, hook) for hook in hooks)
        return effect in self.fields or on_trace or (has_memory and acts)

    def features(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """Features of every grasp (n x 16), see `steps`."""
        return features_of_steps(self.steps(theta, effects, tool_factor))

    def steps(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """Step means of every grasp in its context, n x 120, in N.

        theta: Young's modulus in MPa, friction, Poisson ratio. tool_factor: modulus of each tool over Young's modulus
        (t). Friction stays within the grid.

        Raises:
            UsageError: an effect needs simulations that the bank does not have.
        """
        return self.with_lead(theta, effects, tool_factor)[:, N_LEAD:]

    def with_lead(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """The end of closing and step means, n x 132; what an effect of the bank changes first, it changes before."""
        tool, obj = self.grasps.tool, self.grasps.obj
        acting = self._acting(effects)
        memory = _Memory.of(acting, self.grasps, self.centre)
        factor = 1.0 if tool_factor is None else tool_factor[tool]
        stiffer = theta[0] / self.centre.young_modulus_mpa * factor * memory.modulus
        friction = theta[1] * memory.friction
        from_bank = [value for value in effects if value.effect in self.fields]
        for value in from_bank:
            friction = friction * friction_factor_of_reference(value.effect, value.parameters, stiffer)
        low, high = self.surfaces.lower[0], self.surfaces.upper[0]
        basis = self.surfaces.rows(np.clip(friction, low, high), float(theta[2]))
        steps = (basis[:, None] @ self.rows_n)[:, 0]
        for value in from_bank:
            steps = steps + _with_own_lead(self.fields[value.effect].change_n(value.parameters, stiffer, tool, obj))
        if memory.wider_mm.any():
            steps = steps + _with_own_lead(self._wider(memory.wider_mm))
        steps = steps * stiffer[:, None]
        for of_grasps in acting:
            if acts_on_traces(of_grasps[0]):
                steps = sensed(of_grasps, steps, self.grasps.setup)
        return steps

    def _acting(self, effects: Sequence[EffectValue]) -> list[list[Effect]]:
        """Effects that no field stands for, layer by layer, each as it acts in every grasp."""
        for value in effects:
            if value.effect in CATALOGUE and not self.can(value.effect):
                raise UsageError(f"the bank has no simulations with `{value.effect}`; fill it for this effect.")
        others = build_effects([value for value in effects if value.effect not in self.fields])
        setup, designs = self.grasps.setup, self.grasps.designs
        pairs = list(zip(self.grasps.tool, self.grasps.contexts, strict=True))
        return [[effect.in_grasp(designs[tool], setup, context) for tool, context in pairs] for effect in others]

    def _wider(self, wider_mm: np.ndarray) -> np.ndarray:
        """Changes of step means where jaws stop early by so much (n), n x 120, straight between the bank's."""
        low = np.clip(np.searchsorted(self.wider_mm, wider_mm, side="right") - 1, 0, len(self.wider_mm) - 2)
        part = ((wider_mm - self.wider_mm[low]) / (self.wider_mm[low + 1] - self.wider_mm[low]))[:, None]
        tool, obj = self.grasps.tool, self.grasps.obj
        return np.asarray((1.0 - part) * self.wider_n[tool, obj, low] + part * self.wider_n[tool, obj, low + 1])


def _with_own_lead(change_n: np.ndarray) -> np.ndarray:
    """Changes of step means (n x 120) with those of the end of closing, n x 132."""
    return np.concatenate([np.repeat(change_n[:, :1], N_LEAD, axis=1), change_n], axis=1)


def _surfaces_of_fields(bank: Bank) -> dict[str, FieldSurface]:
    """Surfaces of the effects that the bank has simulated; a bank that is being filled lacks the last of them."""
    is_known = np.isfinite(bank.centre_steps_n).all(axis=-1)
    surfaces = {}
    for name, field in bank.fields.items():
        made = np.isfinite(field.steps_n).all(axis=-1)[is_known].mean(axis=0) >= LEAST_MADE
        if made.any():
            rows = tuple(row for row, there in zip(field.parameters, made, strict=True) if there)
            known = Field(name, rows, field.steps_n[:, :, made])
            surfaces[name] = FieldSurface.of(known, bank.centre_steps_n)
    return surfaces


@dataclass(frozen=True, eq=False)
class _Memory:
    """What effects without a field make of modulus and friction (factors) and of the closed gap (mm), n each."""

    modulus: np.ndarray
    friction: np.ndarray
    wider_mm: np.ndarray

    @staticmethod
    def of(acting: Sequence[Sequence[Effect]], grasps: Grasps, theta: Theta) -> "_Memory":
        """By the hooks of the effects as they act in each grasp; others are not asked."""
        n, setup = len(grasps.tool), grasps.setup
        modulus, friction, wider_mm = np.ones(n), np.ones(n), np.zeros(n)
        nowhere = np.zeros(1)
        for effects in acting:
            kind, designs = type(effects[0]), [grasps.designs[tool] for tool in grasps.tool]
            pairs = list(zip(effects, designs, strict=True))
            if kind.modify_theta is not Effect.modify_theta:
                real = [effect.modify_theta(theta, design).young_modulus_mpa for effect, design in pairs]
                modulus *= np.array(real) / theta.young_modulus_mpa
            if kind.friction_factor is not Effect.friction_factor:
                friction *= np.array([float(effect.friction_factor(nowhere, nowhere)) for effect in effects])
            if kind.modify_setup is not Effect.modify_setup:
                gaps = [effect.modify_setup(setup, design).closed_gap_mm for effect, design in pairs]
                wider_mm += np.array(gaps) - setup.closed_gap_mm
        return _Memory(modulus, friction, wider_mm)

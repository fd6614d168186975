"""The surrogate: what the simulator says of every measured grasp, at any theta and with any effects, from the bank.

Polynomials in friction and Poisson ratio carry theta, Young's modulus is a factor. An effect acts through what it
changes: friction, modulus or closing of one grasp (memory), its runs in the bank, or the finished trace. Forces over
the lift are compared as 16 features: those of calibration, and the rise of the force before them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fast.models.calibration.traces.response_surface import ResponseSurfaces, n_terms
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import WIDER_MM, Bank, EffectRuns
from fast.models.gap.bank.effect_surfaces import EffectSurface
from fast.models.gap.bank.sensor_effects import N_LEAD, apply_sensor_effect, make_lead_map
from fast.models.gap.grasps import Grasps
from fast.models.records import EffectValue, Theta
from fast.models.simulation.effects.base import Effect
from fast.models.simulation.effects.catalogue import CATALOGUE, build_effects
from fast.models.traces import step_features
from fast.models.traces.step_features import FORCE_BINS, N_STEPS, START_BINS, STEP_MM

FEATURES = (*START_BINS, *step_features.FEATURES)
N_BINS = len(START_BINS) + len(FORCE_BINS)
_LIFT_AT_PEAK = FEATURES.index("lift_at_peak_mm")
_MOST_KNOWN = 2000  # sets of effects whose actions in each grasp are kept
_NEAR = 0.04  # of the peak: how much less force counts e times less
_CENTRES_MM = STEP_MM * (np.arange(N_STEPS) + 0.5)
_WIDER_MM = np.array([0.0, *WIDER_MM])
LEAST_MADE = 0.9  # of the cells: an amplitude of which less was simulated is left alone


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Step means of n grasps."""

    bank: Bank
    """Of t tools on k targets."""
    grasps: Grasps
    """That are predicted."""
    column: np.ndarray
    """n, target of each grasp in the bank; -1 where the bank does not have it."""
    surfaces: ResponseSurfaces
    """Of the end of closing and step means (132, see `sensor_effects`) over friction and Poisson ratio, per cell."""
    rows_n: np.ndarray
    """n x terms x 132, coefficients of these for each grasp, at its own timing."""
    effect_surfaces: dict[str, EffectSurface]
    """By name, of the effects that have runs in the bank."""
    wider_n: np.ndarray
    """t x k x 3 x 120, what jaws that stop early by `_WIDER_MM` change."""
    is_usable: np.ndarray
    """n, whether the base of the grasp's cell could be simulated."""
    moved_n: np.ndarray | None = None
    """n x 132, of grasps that are foretold: what a stroke or a placement changes that the bank does not have, at its
    modulus; None without any."""

    @staticmethod
    def of(bank: Bank, grasps: Grasps) -> "Surrogate":
        """Make the surrogate of grasps, from a bank of the same tools and of what they closed on."""
        column = bank.find_columns(grasps)
        n_known = np.isfinite(bank.grid_steps_n).all(axis=-1).sum(axis=-1)
        is_known = (n_known > n_terms(bank.grid)) & np.isfinite(bank.centre_steps_n).all(axis=-1)
        with_lead_n = np.concatenate([bank.grid_lead_n, bank.grid_steps_n], axis=-1)
        every = np.ones(with_lead_n.shape[-1], dtype=bool)
        surfaces = ResponseSurfaces.fitted(bank.grid, with_lead_n, is_known, bank.centre.young_modulus_mpa, every)
        nothing = np.zeros((*bank.centre_steps_n.shape[:2], 1, bank.centre_steps_n.shape[-1]))
        wider_n = np.nan_to_num(bank.wider_steps_n - bank.centre_steps_n[:, :, None])
        return Surrogate(
            bank=bank,
            grasps=grasps,
            column=column,
            surfaces=surfaces,
            rows_n=_with_own_timing(surfaces.coefficients[grasps.tool, column], grasps),
            effect_surfaces=_fit_effect_surfaces(bank),
            wider_n=np.concatenate([nothing, wider_n], axis=2),
            is_usable=is_known[grasps.tool, column] & (column >= 0),
        )

    def select(self, rows: np.ndarray) -> "Surrogate":
        """Return the surrogate of some of the grasps; nothing is fitted again."""
        own = {name: getattr(self, name)[rows] for name in ("column", "rows_n", "is_usable")}
        return replace(self, grasps=self.grasps.select(rows), **own)

    def at(self, grasps: Grasps) -> "Surrogate":
        """Return the surrogate of other grasps of the same tools and objects; nothing is fitted again.

        One whose stroke or placement the bank does not have is foretold as by the base setup, less `moved_n`.
        """
        column = self.bank.find_columns(grasps)
        column = np.where(column < 0, self.bank.find_usual_columns(grasps), column)
        return replace(
            self,
            grasps=grasps,
            column=column,
            rows_n=_with_own_timing(self.surfaces.coefficients[grasps.tool, column], grasps),
            is_usable=self.surfaces.coefficients[grasps.tool, column].any(axis=(1, 2)),
            moved_n=None,
        )

    @property
    def centre(self) -> Theta:
        """Theta around which the bank was simulated."""
        return self.bank.centre

    @property
    def names(self) -> tuple[str, ...]:
        """Effects of the catalogue that these data and this bank can tell from theta in principle."""
        return tuple(name for name, spec in CATALOGUE.items() if spec.alias_of is None and self.can_predict(name))

    def can_predict(self, effect: str) -> bool:
        """Return whether the effect can be predicted: it has a surface, acts on traces, or through a memory."""
        kind = CATALOGUE[effect].kind
        has_memory = kind.overrides("in_grasp") and kind.overrides("modify_theta", "friction_factor", "modify_setup")
        return effect in self.effect_surfaces or kind.acts_on_traces() or has_memory

    def predict_features(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """Predict the features of every grasp (n x 16), see `predict_steps`."""
        return features_of_steps(self.predict_steps(theta, effects, tool_factor))

    def predict_steps(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """Predict the step means of every grasp in its context, n x 120, in N.

        theta: Young's modulus in MPa, friction, Poisson ratio. tool_factor: modulus of each tool over Young's modulus
        (t). Friction stays within the grid.

        Raises:
            UsageError: an effect needs simulations that the bank does not have.
        """
        return self.predict_with_lead(theta, effects, tool_factor)[:, N_LEAD:]

    def predict_with_lead(
        self, theta: np.ndarray, effects: Sequence[EffectValue] = (), tool_factor: np.ndarray | None = None
    ) -> np.ndarray:
        """Predict the end of closing and step means, n x 132; what a bank effect changes first, it changes before."""
        tool = self.grasps.tool
        acting, memory = self._find_acting(effects)
        factor = 1.0 if tool_factor is None else tool_factor[tool]
        stiffer = theta[0] / self.centre.young_modulus_mpa * factor * memory.modulus
        friction = theta[1] * memory.friction
        from_bank = [value for value in effects if value.effect in self.effect_surfaces]
        for value in from_bank:
            friction = friction * build_effects([value])[0].friction_of_runs(stiffer)
        steps = self._find_base(friction, float(theta[2]))
        for value in from_bank:
            against = stiffer / self._find_strength(value)
            change_n = self.effect_surfaces[value.effect].change_n(value.parameters, against, tool, self.column)
            steps = steps + with_own_lead(change_n)
        if memory.wider_mm.any():
            steps = steps + with_own_lead(self._wider(memory.wider_mm))
        if self.moved_n is not None:
            steps = steps + self.moved_n
        steps = steps * stiffer[:, None]
        for of_grasps in acting:
            if of_grasps[0].acts_on_traces():
                steps = self.apply_to_traces(of_grasps, steps)
        return steps

    def _find_base(self, friction: np.ndarray, poisson_ratio: float) -> np.ndarray:
        """Find the end of closing and step means at the bank's modulus and each grasp's friction (n), n x 132.

        The last one is kept: many effects are asked for at one theta.
        """
        asked = friction.tobytes(), poisson_ratio
        if self._last.get("asked") != asked:
            low, high = self.surfaces.lower[0], self.surfaces.upper[0]
            basis = self.surfaces.rows(np.clip(friction, low, high), poisson_ratio)
            self._last.update(asked=asked, steps_n=(basis[:, None] @ self.rows_n)[:, 0])
        return np.asarray(self._last["steps_n"])

    @cached_property
    def _last(self) -> dict[str, Any]:
        return {}

    def apply_to_traces(self, effects: Sequence[Effect], steps_n: np.ndarray) -> np.ndarray:
        """Apply an effect on traces to step means with their lead (n x 132), each at the timing of its grasp."""
        found = np.zeros_like(steps_n)
        for number in np.unique(self.grasps.setup):
            rows = np.flatnonzero(self.grasps.setup == number)
            own = [effects[row] for row in rows.tolist()]
            found[rows] = apply_sensor_effect(own, steps_n[rows], self.grasps.setups[number])
        return found

    def _find_strength(self, value: EffectValue) -> np.ndarray:
        """Find how large what an effect brings in is in each grasp, over the usual, n."""
        (effect,) = build_effects([value])
        return np.array([effect.strength_in(setup) for setup in self.grasps.setups])[self.grasps.setup]

    def _find_acting(self, effects: Sequence[EffectValue]) -> tuple[list[list[Effect]], "_Memory"]:
        """Find the effects that no surface stands for as they act in every grasp, and what they make of its closing.

        Both are the same at any theta, and a search asks for the same values again and again.
        """
        key = tuple((value.effect, tuple(value.parameters.items())) for value in effects)
        if key not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            acting = self._list_acting(effects)
            self._known[key] = acting, _Memory.of(acting, self.grasps, self.centre)
        return self._known[key]

    @cached_property
    def _known(self) -> "dict[tuple[object, ...], tuple[list[list[Effect]], _Memory]]":
        return {}

    def _list_acting(self, effects: Sequence[EffectValue]) -> list[list[Effect]]:
        """List effects that no surface stands for, layer by layer, each as it acts in every grasp."""
        for value in effects:
            if value.effect in CATALOGUE and not self.can_predict(value.effect):
                raise UsageError(f"the bank has no simulations with `{value.effect}`; fill it for this effect.")
        others = build_effects([value for value in effects if value.effect not in self.effect_surfaces])
        setups, designs = self.grasps.setups, self.grasps.designs
        each = list(zip(self.grasps.tool, self.grasps.setup, self.grasps.contexts, strict=True))
        return [
            [effect.in_grasp(designs[tool], setups[at], context) for tool, at, context in each] for effect in others
        ]

    def _wider(self, wider_mm: np.ndarray) -> np.ndarray:
        """Compute changes of step means where jaws stop early by so much (n), n x 120, straight between the bank's."""
        low = np.clip(np.searchsorted(_WIDER_MM, wider_mm, side="right") - 1, 0, len(_WIDER_MM) - 2)
        part = ((wider_mm - _WIDER_MM[low]) / (_WIDER_MM[low + 1] - _WIDER_MM[low]))[:, None]
        tool, column = self.grasps.tool, self.column
        return np.asarray((1.0 - part) * self.wider_n[tool, column, low] + part * self.wider_n[tool, column, low + 1])


def with_own_lead(change_n: np.ndarray) -> np.ndarray:
    """Return changes of step means (n x 120) with those of the end of closing, n x 132."""
    return np.concatenate([np.repeat(change_n[:, :1], N_LEAD, axis=1), change_n], axis=1)


def _with_own_timing(rows_n: np.ndarray, grasps: Grasps) -> np.ndarray:
    """Return surface terms (n x k x 132) of the base setup's timing with the end of closing at each grasp's own."""
    for number, setup in enumerate(grasps.setups):
        rows = np.flatnonzero(grasps.setup == number)
        if setup.timed_as(grasps.base_setup) != setup and len(rows):
            rows_n[rows, :, :N_LEAD] = rows_n[rows, :, :N_LEAD] @ make_lead_map(grasps.base_setup, setup).T
    return rows_n


def _fit_effect_surfaces(bank: Bank) -> dict[str, EffectSurface]:
    """Fit surfaces of the effects that the bank has simulated; a bank that is being filled lacks the last of them."""
    is_known = np.isfinite(bank.centre_steps_n).all(axis=-1)
    surfaces = {}
    for name, runs in bank.effects.items():
        made = np.isfinite(runs.steps_n).all(axis=-1)[is_known].mean(axis=0) >= LEAST_MADE
        if made.any():
            rows = tuple(row for row, there in zip(runs.parameters, made, strict=True) if there)
            known = EffectRuns(name, rows, runs.steps_n[:, :, made])
            surfaces[name] = EffectSurface.of(known, bank.centre_steps_n)
    return surfaces


def features_of_steps(steps_n: np.ndarray) -> np.ndarray:
    """Compute features (... x 16) of mean forces over steps (... x 120), in the order of `FEATURES`: lift bins first.

    Unlike in calibration, the lift at the peak has no edge at which a force begins to count: gradients and posteriors
    are taken along it.
    """
    start = steps_n[..., : len(START_BINS)]
    features = np.concatenate([start, step_features.features_of_steps(steps_n)], axis=-1)
    peak = steps_n.max(axis=-1, keepdims=True)
    below = (peak - steps_n) / np.maximum(np.abs(peak), 1e-9)
    weight = np.exp(-below / _NEAR)
    features[..., _LIFT_AT_PEAK] = (weight * _CENTRES_MM).sum(axis=-1) / weight.sum(axis=-1)
    return features


@dataclass(frozen=True, eq=False)
class _Memory:
    """What effects without a surface make of modulus and friction (factors) and of the closed gap (mm), n each."""

    modulus: np.ndarray
    friction: np.ndarray
    wider_mm: np.ndarray

    @staticmethod
    def of(acting: Sequence[Sequence[Effect]], grasps: Grasps, theta: Theta) -> "_Memory":
        """Make it by the hooks of the effects as they act in each grasp; others are not asked."""
        n, setups = len(grasps.tool), [grasps.setups[number] for number in grasps.setup]
        modulus, friction, wider_mm = np.ones(n), np.ones(n), np.zeros(n)
        nowhere = np.zeros(1)
        for effects in acting:
            kind, designs = type(effects[0]), [grasps.designs[tool] for tool in grasps.tool]
            pairs = list(zip(effects, designs, strict=True))
            if kind.overrides("modify_theta"):
                real = [effect.modify_theta(theta, design).young_modulus_mpa for effect, design in pairs]
                modulus *= np.array(real) / theta.young_modulus_mpa
            if kind.overrides("friction_factor"):
                friction *= np.array([float(effect.friction_factor(nowhere, nowhere)) for effect in effects])
            if kind.overrides("modify_setup"):
                wider_mm += [
                    effect.modify_setup(setup, design).closed_gap_mm - setup.closed_gap_mm
                    for setup, (effect, design) in zip(setups, pairs, strict=True)
                ]
        return _Memory(modulus, friction, wider_mm)

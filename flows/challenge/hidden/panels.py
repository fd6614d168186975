"""Panels of true grasps by name, what worlds are made of, and how strong a hidden effect is in them.

A study solves true grasps (`tests/studies/gap/grasp_laws`); worlds are made of those that a file holds.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fast.flows.challenge.hidden.lab import Lab, Site, Variants
from fast.flows.challenge.hidden.lab_laws import LAB_LAWS, LabLaw, tool_draws
from fast.models.gap.bank.bank import Bank
from fast.models.ids import seed_from
from fast.models.records import Record, Trace
from fast.models.traces.step_features import N_STEPS, is_usable, step_means

MODULUS_MPA = 9.2
RESPONDING, LOWER, WIDER, RAISED = "base-0", "lower friction", "wider closing", "raised objects"
CHANNELS = ("time_s", "lift_mm", "force_n")
TOOL_MODULUS_SD = 0.04
# Laws under which forces are not in proportion to Young's modulus.
UNSCALED = frozenset(
    {
        "force_limited_closing",
        "shear_adhesion",
        "base_compliance",
        "pressure_dependent_friction",
        "soft_objects",
    }
)
_FLOOR, _TOOL_SD = 0.01, 0.04
_BIN = 4  # steps

Cells = Mapping[tuple[int, int], Trace]  # by numbers of tool and object in the panel


class TrueSet(Record):
    """A panel of true grasps at one theta: what it is called, and its law with parameters (none: a base).

    is_other: whether the law is the second one that is known for its effect.
    """

    name: str
    theta: tuple[float, float]
    law: str = ""
    is_other: bool = False
    parameters: dict[str, float] = {}
    raised_mm: float = 0.0


def draw_tool_modulus(design: int) -> float:
    """Draw the modulus of the print of a design (number) over theta's: the same whatever is hidden."""
    return float(np.exp(TOOL_MODULUS_SD * tool_draws(seed_from("true tool", design), 0xE, 1)[0]))


@dataclass(frozen=True, eq=False)
class Panels:
    """True traces of designs on objects (numbers), by the name of their set; only sets that are all but complete."""

    designs: tuple[int, ...]
    objects: tuple[int, ...]
    sets: Mapping[str, TrueSet]
    cells: Mapping[str, Cells]

    def part(self, designs: Sequence[int], objects: Sequence[int]) -> "Panels":
        """Return these designs and objects (numbers) alone, in this order."""
        tools = {self.designs.index(number): place for place, number in enumerate(designs)}
        columns = {self.objects.index(number): place for place, number in enumerate(objects)}
        cells = {
            name: {
                (tools[tool], columns[obj]): trace
                for (tool, obj), trace in known.items()
                if tool in tools and obj in columns
            }
            for name, known in self.cells.items()
        }
        return Panels(tuple(designs), tuple(objects), self.sets, cells)

    @property
    def bases(self) -> tuple[str, ...]:
        """Names of sets without a law."""
        return tuple(name for name in self.sets if name.startswith("base-"))

    @property
    def grasp_laws(self) -> tuple[str, ...]:
        """Names of sets with a law of their own."""
        helpers = {WIDER, RAISED}
        return tuple(name for name, one in self.sets.items() if one.law and name not in helpers)

    @property
    def lab_laws(self) -> tuple[str, ...]:
        """Laws that can act on some base here: those with a memory need their panel."""
        needs = {"friction_wear": LOWER, "pressure_droop": WIDER, "warm_posts": RAISED}
        return tuple(name for name in LAB_LAWS if name not in needs or {needs[name], RESPONDING} <= self.cells.keys())

    def truth(self, name: str, factor: float) -> Callable[[int, int], Variants | None]:
        """Return the true traces of a set by numbers of tool and object, with forces times a factor."""
        responds = self.sets[name].theta == self.sets[RESPONDING].theta if RESPONDING in self.sets else False

        def of(tool: int, obj: int) -> Variants | None:
            base = self._scaled(name, tool, obj, factor)
            if base is None:
                return None
            if not responds:
                return Variants(base)
            lower, wider, raised = (self._scaled(other, tool, obj, factor) for other in (LOWER, WIDER, RAISED))
            lower_factor = self.sets[LOWER].theta[0] / self.sets[name].theta[0] if LOWER in self.sets else 0.5
            return Variants(base, lower, wider, raised, lower_factor=lower_factor)

        return of

    def tool_factors(self, name: str) -> np.ndarray:
        """Return the moduli of the tools over theta's that are already in a set's traces, t."""
        is_scaled = self.is_scaled(name)
        return np.array([1.0 if is_scaled else draw_tool_modulus(design) for design in self.designs])

    def is_scaled(self, name: str) -> bool:
        """Return whether a set's forces may be multiplied for another modulus."""
        return self.sets[name].law not in UNSCALED

    @cached_property
    def steps_n(self) -> dict[str, np.ndarray]:
        """Step means of every set at the modulus of the bases, t x o x 120; NaN where a grasp failed."""
        return {name: self._steps(cells) for name, cells in self.cells.items()}

    def change_of_law(self, name: str) -> np.ndarray:
        """Return what a set's law changes in the step means, tools' moduli taken out, t x o x 120 in N."""
        base = next(base for base in self.bases if self.sets[base].theta == self.sets[name].theta)
        return np.asarray(self.steps_n[name] / self.tool_factors(name)[:, None, None] - self.steps_n[base])

    def change_of_lab_law(self, law: LabLaw, base: str, lab: Lab, factor: float) -> np.ndarray:
        """Return what a law of the lab changes in the step means of every grasp, n x 120; n as `Lab.order`."""
        truth = self.truth(base, factor)
        rows = np.full((len(self.designs) * len(self.objects) * lab.repeats, N_STEPS), np.nan)
        for row, site in enumerate(lab.order()):
            variants = truth(site.tool, site.obj)
            if variants is not None:
                with_law = lab.true_trace(site, variants, [law])
                rows[row] = _steps_of(with_law) - _steps_of(lab.true_trace(site, variants, ()))
        return rows

    def _scaled(self, name: str, tool: int, obj: int, factor: float) -> Trace | None:
        trace = self.cells.get(name, {}).get((tool, obj))
        return None if trace is None else Trace(trace.time_s, trace.lift_mm, factor * trace.force_n)

    def _steps(self, cells: Cells) -> np.ndarray:
        steps = np.full((len(self.designs), len(self.objects), N_STEPS), np.nan)
        for place, trace in cells.items():
            steps[place] = _steps_of(trace)
        return steps


def take_cells(bank: Bank, tools: Sequence[int], columns: Sequence[int]) -> Bank:
    """Take the bank of these tools and targets (numbers in it) alone, in this order."""

    def take(of_cells: np.ndarray) -> np.ndarray:
        return np.asarray(of_cells[np.ix_(tools, columns)])

    return replace(
        bank,
        targets=tuple(bank.targets[column] for column in columns),
        grid_steps_n=take(bank.grid_steps_n),
        grid_lead_n=take(bank.grid_lead_n),
        centre_steps_n=take(bank.centre_steps_n),
        numerical_steps_n=take(bank.numerical_steps_n),
        placed_steps_n=take(bank.placed_steps_n),
        wider_steps_n=take(bank.wider_steps_n),
        effects={name: replace(runs, steps_n=take(runs.steps_n)) for name, runs in bank.effects.items()},
    )


def _steps_of(trace: Trace) -> np.ndarray:
    return step_means(trace) if is_usable(trace) else np.zeros(N_STEPS)


def raw_strength(change_n: np.ndarray, force_n: np.ndarray) -> float:
    """Return the root mean square change over the root mean square force."""
    return float(np.sqrt(np.nanmean(change_n**2) / np.nanmean(force_n**2)))


def visible_share(
    change_n: np.ndarray, force_n: np.ndarray, sites: Sequence[Site], theta: tuple[float, float], bank: Bank
) -> float:
    """Return the share of a change (n x 120) of forces (n x 120) left when theta and tools' moduli are fitted to it.

    Columns are the force itself, that of every tool (with the prior of a print's modulus), and the slopes of the bank
    in friction and Poisson's ratio around theta; weights are a hundredth of the peak and the noise of a mean.
    """
    tool, obj = (np.array([getattr(site, name) for site in sites]) for name in ("tool", "obj"))
    scale = force_n.std() / np.nanstd(bank.centre_steps_n)
    slopes = [scale * slope[tool, obj] for slope in bank_slopes(bank, theta)]
    finite = np.isfinite(change_n).all(axis=1) & np.isfinite(slopes).all(axis=(0, 2))
    binned = [_binned(values[finite]) for values in (change_n, force_n, *slopes)]
    change, force, *slopes = binned
    weight = 1.0 / np.hypot(_FLOOR * np.abs(force).max(axis=1, keepdims=True), 0.03)
    by_tool = [(_TOOL_SD * force * weight * (tool[finite] == t)[:, None]).ravel() for t in np.unique(tool)]
    free = np.column_stack([(column * weight).ravel() for column in (force, *slopes)] + by_tool)
    held = np.diag([0.0] * (1 + len(slopes)) + [1.0] * len(by_tool))
    target = (change * weight).ravel()
    fitted = free @ np.linalg.solve(free.T @ free + held + 1e-9 * np.eye(len(held)), free.T @ target)
    return float(np.linalg.norm(target - fitted) / max(float(np.linalg.norm(target)), 1e-12))


def bank_slopes(bank: Bank, theta: tuple[float, float]) -> list[np.ndarray]:
    """Return slopes (t x o x 120) of the bank's forces in friction and Poisson's ratio, by least squares near theta."""
    low, high = bank.grid.min(axis=0), bank.grid.max(axis=0)
    apart = np.asarray(bank.grid - np.array(theta)) / np.asarray(high - low)
    weight = np.exp(-4.0 * (apart**2).sum(axis=1))
    design = np.column_stack([np.ones(len(apart)), apart]) * weight[:, None]
    solve = np.linalg.pinv(design)[1:] * weight
    return [np.einsum("g,togs->tos", row, bank.grid_steps_n) for row in solve]


def _binned(values: np.ndarray) -> np.ndarray:
    return np.asarray(values.reshape(len(values), -1, _BIN).mean(axis=2))


def modulus_factor(young_modulus_mpa: float) -> float:
    """Return what forces of the bases are multiplied with for this modulus."""
    return young_modulus_mpa / MODULUS_MPA

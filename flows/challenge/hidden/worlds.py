"""Worlds of the hidden-effect study: what each hides, drawn from a seed or a secret, and the gap problem it makes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fast.flows.challenge.hidden.lab import NASTIER, Lab, Nuisance, Site
from fast.flows.challenge.hidden.lab_laws import LabLaw
from fast.flows.challenge.hidden.other_lab_laws import OTHER_LAB_LAWS, build_lab_law
from fast.flows.challenge.hidden.panels import (
    MODULUS_MPA,
    RESPONDING,
    Panels,
    modulus_factor,
    raw_strength,
    take_cells,
    visible_share,
)
from fast.models.design.space import numbered_design
from fast.models.gap.bank.bank import Bank
from fast.models.gap.data import GapData
from fast.models.gap.grasps import Grasps, of_one_setup
from fast.models.ids import content_id, seed_from
from fast.models.records import Record, Trace
from fast.models.traces.step_features import is_usable, step_means
from fast.models.traces.step_noise import SensorNoise

Group = Literal["null", "nasty null", "single", "alias", "unlisted", "pair"]
GROUPS: tuple[Group, ...] = ("null", "nasty null", "single", "alias", "unlisted", "pair")

STRENGTHS = (0.02, 0.05, 0.1)
MODULI_MPA = (6.5, 13.0)  # wider than the prior, and never its mean
# Unlike effects of the catalogue: theta takes them up exactly, or nobody listed them.
ALIASES = {"load_cell_gain": "young_modulus_mpa", "batch_ageing": "tool_modulus"}
UNLISTED = (
    "magnetic_pull",
    "warm_posts",
    "pulling_hose",
    "scaled_objects",
    "other_material_law",
    "weak_finger",
    "soft_objects",
    "object_surfaces",
)
N_DESIGNS, N_OBJECTS = 8, 6
_HELD_OUT_TOOLS, _HELD_OUT_OBJECTS = 4, 3
OF_RESPONDING = ("friction_wear", "pressure_droop", "warm_posts")  # laws that need panels of other settings
# Largest amplitude that is plausible, and whether it may be negative.
LIMITS: Mapping[str, tuple[float, bool]] = {
    "stress_relaxation": (0.3, False),
    "mullins_softening": (0.35, False),
    "temperature_softening": (0.4, True),
    "friction_wear": (0.4, False),
    "object_post_compliance": (0.3, False),
    "load_cell_offset": (1.0, True),
    "load_cell_drift": (1.0, True),
    "load_cell_lag": (1.0, False),
    "lift_misalignment": (3.0, True),
    "tool_weight": (1.5, True),
    "pressure_droop": (2.0, False),
    "lift_start_error": (1.5, False),
    "load_cell_gain": (0.1, True),
    "batch_ageing": (0.2, True),
    "magnetic_pull": (3.0, False),
    "warm_posts": (1.0, True),
    "pulling_hose": (6.0, False),
}


class Hidden(Record):
    """One hidden effect: of a set of true grasps (`truth_set`), or of the lab with an amplitude.

    is_other: by the second law that the lab knows for it. Strengths are shares of the force: raw_strength of all that
    changes, visible_strength of what is left once theta is fitted, spread_strength the same without the cell that the
    effect changes most: where a grasp snaps, a small change of anything moves the snap.
    """

    effect: str
    amplitude: float = 0.0
    truth_set: str = ""
    is_other: bool = False
    raw_strength: float = 0.0
    visible_strength: float = 0.0
    spread_strength: float = 0.0


class WorldKey(Record):
    """What a world hides: everything that makes its data, and what an answer is judged by."""

    group: Group
    """Of worlds."""
    number: int
    """Within its group."""
    seed: int
    """Of its draws."""
    base: str
    """Which set of true grasps."""
    young_modulus_mpa: float
    """Of its material."""
    effects: tuple[Hidden, ...] = ()
    """Hidden."""
    nuisance: Nuisance = Nuisance()
    """What varies besides."""
    designs: tuple[int, ...] = ()
    """Of the panel, in the world's order; empty: all of them."""
    objects: tuple[int, ...] = ()
    """Of the panel, in the world's order; empty: all of them."""

    @property
    def world_id(self) -> str:
        """Id derived from the content."""
        return content_id("U", self.model_dump(mode="json"))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the hidden effects."""
        return tuple(hidden.effect for hidden in self.effects)


@dataclass(frozen=True, eq=False)
class Change:
    """What an effect changes (n x 120, N; NaN where it is not known) in the forces of grasps (n x 120) at sites (n)."""

    sites: Sequence[Site]
    change_n: np.ndarray
    force_n: np.ndarray

    def without_strongest_cell(self) -> "Change":
        """Return the grasps of all cells but the one whose squares it changes most."""
        cells = [(site.tool, site.obj) for site in self.sites]
        squares = dict.fromkeys(cells, 0.0)
        for cell, row in zip(cells, self.change_n, strict=True):
            squares[cell] += float(np.nansum(row**2))
        strongest = max(squares, key=lambda cell: squares[cell])
        kept = [place for place, cell in enumerate(cells) if cell != strongest]
        return Change([self.sites[place] for place in kept], self.change_n[kept], self.force_n[kept])


@dataclass(frozen=True, eq=False)
class Worlds:
    """Draws worlds of a panel."""

    panels: Panels
    """True grasps."""
    bank: Bank
    """Simulated ones."""
    seed: int | str
    """Public for development, a secret for sealed worlds."""
    moduli_mpa: tuple[float, float] = MODULI_MPA
    """Ends between which Young's modulus is drawn."""
    has_other_laws: bool = False
    """Whether the lab's law for an effect is drawn from two; else it is the first."""
    n_designs: int = N_DESIGNS
    """Of a world, drawn from the panel's."""
    n_objects: int = N_OBJECTS
    """Of a world, drawn from the panel's."""
    strengths: tuple[float, ...] = STRENGTHS
    """Of laws of the lab, of the force."""

    def draw(self, group: Group, number: int) -> WorldKey:
        """Draw the key of a world, always the same for a seed."""
        rng = np.random.default_rng(seed_from("gap world", self.seed, group, number))
        base = str(rng.choice(self.panels.bases))
        nuisance = NASTIER if group == "nasty null" else Nuisance()
        key = WorldKey(
            group=group,
            number=number,
            seed=int(rng.integers(2**53)),
            base=base,
            young_modulus_mpa=round(float(rng.uniform(*self.moduli_mpa)), 3),
            nuisance=nuisance,
            designs=self._some_of(self.panels.designs, self.n_designs, "designs", group, number),
            objects=self._some_of(self.panels.objects, self.n_objects, "objects", group, number),
        )
        names = self.list_effects(group)
        if not names:
            return key
        first, place = names[number % len(names)], number + number // len(names)
        key = self.with_effect(key, first, self.strengths[place % len(self.strengths)], rng)
        if group == "pair":
            second = str(rng.choice([name for name in self.panels.lab_laws if self._may_pair(name, first)]))
            key = self.with_effect(key, second, self.strengths[1 + number % 2], rng)
        return key

    def list_effects(self, group: Group) -> tuple[str, ...]:
        """List effects that worlds of a group hide in turn, by their numbers; none where nothing is hidden."""
        effects = {"single": self._singles, "alias": tuple(ALIASES), "unlisted": self._unlisted, "pair": self._singles}
        return effects.get(group, ())

    def _some_of(self, numbers: tuple[int, ...], n: int, *place: str | int) -> tuple[int, ...]:
        """Draw the world's own of the panel's designs or objects; empty where the panel has no more than these."""
        rng = np.random.default_rng(seed_from("gap world's own", self.seed, *place))
        return () if len(numbers) <= n else tuple(int(one) for one in rng.choice(numbers, n, replace=False))

    def of(self, key: WorldKey) -> "Worlds":
        """Return worlds of a key's designs and objects alone; these ones where they have no others."""
        designs, objects = key.designs or self.panels.designs, key.objects or self.panels.objects
        if (designs, objects) == (self.panels.designs, self.panels.objects):
            return self
        return replace(self, panels=self.panels.part(designs, objects), bank=self.bank_of(designs, objects))

    def bank_of(self, designs: Sequence[int], objects: Sequence[int]) -> Bank:
        """Return the bank of these of the panel's designs and objects (numbers)."""
        tools = [self.panels.designs.index(number) for number in designs]
        return take_cells(self.bank, tools, [self.panels.objects.index(number) for number in objects])

    @property
    def _singles(self) -> tuple[str, ...]:
        """Effects of the catalogue: laws of the lab, and sets of true grasps by their names."""
        apart = {*ALIASES, *UNLISTED}
        sets = [name for name in self.panels.grasp_laws if self.panels.sets[name].law not in apart]
        return (*(name for name in self.panels.lab_laws if name not in apart), *sets)

    @property
    def _unlisted(self) -> tuple[str, ...]:
        sets = [name for name in self.panels.grasp_laws if self.panels.sets[name].law in UNLISTED]
        return (*(name for name in self.panels.lab_laws if name in UNLISTED), *sets)

    def _may_pair(self, name: str, first: str) -> bool:
        first_law = self.panels.sets[first].law if first in self.panels.sets else first
        is_everywhere = name not in ("friction_wear", "pressure_droop")
        return name not in (*ALIASES, *UNLISTED, first_law) and is_everywhere

    def with_effect(self, key: WorldKey, name: str, strength: float, rng: np.random.Generator) -> WorldKey:
        """Return the key with one more effect: a set of true grasps as it is, a law of the lab at the strength."""
        own = self.of(key)
        if own is not self:
            return own.with_effect(key, name, strength, rng)
        if name in self.panels.sets:
            return self._with_set(key, name)
        if name in OF_RESPONDING:
            key = key.model_copy(update={"base": RESPONDING})
        largest, has_sign = LIMITS[name]
        sign = -1.0 if has_sign and rng.uniform() < 0.5 else 1.0
        is_other = self.has_other_laws and name in OTHER_LAB_LAWS and rng.uniform() < 0.5
        amplitude = sign * 0.1 * largest
        for _ in range(3):
            change = self.change_by(key, Hidden(effect=name, amplitude=amplitude, is_other=is_other))
            ratio = strength / max(raw_strength(change.change_n, change.force_n), 1e-9)
            amplitude = sign * min(abs(amplitude) * ratio, largest)
        return self._appended(key, Hidden(effect=name, amplitude=float(f"{amplitude:.4g}"), is_other=is_other))

    def _with_set(self, key: WorldKey, name: str) -> WorldKey:
        one = self.panels.sets[name]
        base = next(base for base in self.panels.bases if self.panels.sets[base].theta == one.theta)
        update: dict[str, object] = {"base": base}
        if not self.panels.is_scaled(name):
            update["young_modulus_mpa"] = MODULUS_MPA
        return self._appended(
            key.model_copy(update=update), Hidden(effect=one.law, truth_set=name, is_other=one.is_other)
        )

    def _appended(self, key: WorldKey, hidden: Hidden) -> WorldKey:
        change = self.change_by(key, hidden)
        raw, visible = self._measure_strength(key, change)
        _, spread = self._measure_strength(key, change.without_strongest_cell())
        measured = {"raw_strength": raw, "visible_strength": visible, "spread_strength": spread}
        return key.model_copy(update={"effects": (*key.effects, hidden.model_copy(update=measured))})

    def change_by(self, key: WorldKey, hidden: Hidden) -> Change:
        """Return what a hidden effect changes in the grasps of a world with all cells of these panels, in N."""
        lab, factor = self.lab(key), modulus_factor(key.young_modulus_mpa)
        sites = lab.order()
        if hidden.truth_set:
            change_n = factor * _at(self.panels.change_of_law(hidden.truth_set), sites)
        else:
            change_n = self.panels.change_of_lab_law(_law_of(hidden), key.base, lab, factor)
        return Change(sites, change_n, factor * _at(self.panels.steps_n[key.base], sites))

    def _measure_strength(self, key: WorldKey, change: Change) -> tuple[float, float]:
        """Measure the raw and the visible strength."""
        raw = raw_strength(change.change_n, change.force_n)
        theta = self.panels.sets[key.base].theta
        visible = raw * visible_share(change.change_n, change.force_n, change.sites, theta, self.bank)
        return float(f"{raw:.3g}"), float(f"{visible:.3g}")

    def twin(self, key: WorldKey) -> WorldKey:
        """Return the same world with nothing hidden: the same prints, order, scatter and noise."""
        return key.model_copy(update={"effects": ()})

    def lab(self, key: WorldKey) -> Lab:
        """Return the lab that measures a world."""
        panels = self.of(key).panels
        return Lab(panels.designs, panels.objects, key.seed, nuisance=key.nuisance)

    def measure(self, key: WorldKey) -> list[tuple[Site, Trace]]:
        """Measure the world's traces, as the lab does."""
        panels = self.of(key).panels
        name = next((hidden.truth_set for hidden in key.effects if hidden.truth_set), key.base)
        laws = [_law_of(hidden) for hidden in key.effects if not hidden.truth_set]
        truth = panels.truth(name, modulus_factor(key.young_modulus_mpa))
        return self.lab(key).measure(truth, laws, is_scaled=panels.is_scaled(name))

    def problem(self, key: WorldKey) -> GapData:
        """Return the gap problem that a world makes, with designs and objects held out."""
        return self.make_problem(key, self.measure(key))

    def make_problem(self, key: WorldKey, traces: Sequence[tuple[Site, Trace]]) -> GapData:
        """Make the gap problem of measured traces; key: of the world that they are of."""
        own = self.of(key)
        panels = own.panels
        measured = [(site, trace) for site, trace in traces if is_usable(trace)]
        how = key.nuisance
        grasps = Grasps(
            tools=tuple(f"T{number:02d}" for number in range(len(panels.designs))),
            designs=tuple(numbered_design(number) for number in panels.designs),
            objects=panels.objects,
            tool=np.array([site.tool for site, _ in measured]),
            obj=np.array([site.obj for site, _ in measured]),
            contexts=tuple(site.context for site, _ in measured),
            steps_n=np.array([step_means(trace) for _, trace in measured]),
            grasp_ids=tuple(f"g{number}" for number in range(len(measured))),
            noise=SensorNoise(how.noise_sd_n, how.noise_correlation_s, how.rate_hz),
            **of_one_setup(len(measured)),
        )
        rng = np.random.default_rng(seed_from("held out", key.seed))
        n_tools, n_objects = len(panels.designs), len(panels.objects)
        return GapData(
            grasps,
            own.bank,
            held_out_tools=_some(rng, n_tools, min(_HELD_OUT_TOOLS, n_tools // 3)),
            held_out_objects=_some(rng, n_objects, min(_HELD_OUT_OBJECTS, n_objects // 3)),
        )


def _law_of(hidden: Hidden) -> LabLaw:
    return build_lab_law(hidden.effect, hidden.amplitude, hidden.is_other)


def _at(values: np.ndarray, sites: Sequence[Site]) -> np.ndarray:
    return np.asarray(values[[site.tool for site in sites], [site.obj for site in sites]])


def _some(rng: np.random.Generator, n: int, n_chosen: int) -> np.ndarray:
    mask = np.zeros(n, dtype=bool)
    mask[rng.choice(n, n_chosen, replace=False)] = True
    return mask

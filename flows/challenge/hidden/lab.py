"""A lab that measures a truth: order and clock of the grasps, scatter of tools, cells and repeats, sensor, gaps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from fast.flows.challenge.hidden.lab_laws import LabLaw, Moment
from fast.flows.challenge.manifest import TOOLS_PER_BATCH
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.ids import seed_from
from fast.models.objects.catalogue import get_object
from fast.models.records import GraspContext, GraspSetup, Record, Trace
from fast.models.traces.step_features import LIFT_MM

TRACE_END_MM = LIFT_MM + 1.0
SETUP = GraspSetup()  # with which truths are solved


class Nuisance(Record):
    """What varies without being hidden."""

    tool_sd: float = 0.04
    """Relative, of prints."""
    cell_sd: float = 0.02
    """Relative, of a tool on an object."""
    repeat_sd: float = 0.01
    """Relative, of grasps."""
    noise_sd_n: float = 0.12
    """Of a reading."""
    noise_correlation_s: float = 0.05
    """Of an AR(1) process."""
    rate_hz: float = 80.0
    """Readings."""
    heavy_tails: bool = False
    """Of the noise."""
    tare_n: float = 0.05
    """Standard deviation of the zero."""
    missing: float = 0.015
    """Share of lost traces."""
    seconds_per_grasp: float = 38.0
    """Of the bench."""
    seconds_per_tool: float = 240.0
    """Of a tool change."""


NASTIER = Nuisance(tool_sd=0.08, cell_sd=0.03, heavy_tails=True, missing=0.03)


@dataclass(frozen=True)
class Site:
    """Where a grasp belongs: numbers of tool and object in the panel, what came before it, and how it is made."""

    tool: int
    obj: int
    context: GraspContext
    setup: GraspSetup = SETUP


@dataclass(frozen=True)
class Variants:
    """True traces of one cell: as it is; and what change at lower friction, wider jaws, a raised object, if known.

    `lower` at friction times `lower_factor`, `wider` with jaws `wider_mm` early, `raised` by `raised_mm`.
    """

    base: Trace
    lower: Trace | None = None
    wider: Trace | None = None
    raised: Trace | None = None
    lower_factor: float = 0.5
    wider_by_mm: float = 2.0
    raised_by_mm: float = 1.0


@dataclass(frozen=True)
class Lab:
    """A panel of designs and objects that is measured `repeats` times in a real order."""

    designs: Sequence[int]
    objects: Sequence[int]
    seed: int
    repeats: int = 3
    nuisance: Nuisance = field(default_factory=Nuisance)

    def order(self) -> list[Site]:
        """List all grasps as a lab makes them: tool by tool, every round all objects in a new random order."""
        rng = np.random.default_rng(seed_from("order", self.seed))
        sites: list[Site] = []
        n_objects, how = len(self.objects), self.nuisance
        clock_s, batch_grasps = 0.0, 0
        for tool in range(len(self.designs)):
            if tool % TOOLS_PER_BATCH == 0:
                clock_s, batch_grasps = 0.0, 0
            clock_s += how.seconds_per_tool * rng.uniform(0.7, 1.5)
            for number in range(self.repeats * n_objects):
                repeat, place = divmod(number, n_objects)
                if place == 0:
                    objects = rng.permutation(n_objects)
                context = GraspContext(
                    repeat=repeat, tool_grasps=number, batch_grasps=batch_grasps, clock_s=round(clock_s, 1)
                )
                sites.append(Site(tool, int(objects[place]), context))
                batch_grasps += 1
                clock_s += how.seconds_per_grasp * rng.uniform(0.85, 1.3)
        return sites

    def measure(
        self,
        truth: Callable[[int, int], Variants | None],
        laws: Sequence[LabLaw],
        is_scaled: bool = True,
        asked: Sequence[Site] | None = None,
    ) -> list[tuple[Site, Trace]]:
        """Return the traces that the load cell reports, at its rate; without those that got lost.

        `asked`: grasps that are made afterwards instead of the usual ones, of the same tools as they were mounted.

        `truth`: true traces of a tool's and an object's number, None where there are none. `laws`: in the order in
        which they act. `is_scaled`: draw the tools' moduli; else the truth has them.
        """
        rng = np.random.default_rng(seed_from("measure", self.seed))
        tool_factor = np.exp(self.nuisance.tool_sd * _draws(rng, len(self.designs)) * is_scaled)
        cell_factor = np.exp(self.nuisance.cell_sd * _draws(rng, len(self.designs), len(self.objects)))
        measured = []
        if asked is not None:
            rng = np.random.default_rng(seed_from("asked", self.seed, len(asked)))
        for site in self.order() if asked is None else asked:
            factor = tool_factor[site.tool] * cell_factor[site.tool, site.obj]
            factor *= float(np.exp(self.nuisance.repeat_sd * _draws(rng, 1)[0]))
            is_lost = rng.uniform() < self.nuisance.missing
            grasp_rng = np.random.default_rng(rng.integers(2**63))
            variants = truth(site.tool, site.obj)
            if is_lost or variants is None:
                continue
            true = self.true_trace(site, variants, laws, factor)
            measured.append((site, self._sensed(true, grasp_rng)))
        return measured

    def true_trace(self, site: Site, variants: Variants, laws: Sequence[LabLaw], factor: float = 1.0) -> Trace:
        """Return the trace of a grasp under laws, before noise; `factor` on the modulus.

        Another stroke or height is answered by the variants, another speed or wait by the same grasp at other times.

        Raises:
            UsageError: the variants do not tell what another stroke or height does.
        """
        moment = self.moment(site)
        wider_mm = 0.5 * (site.setup.closed_gap_mm - SETUP.closed_gap_mm)
        raised_mm, friction = site.setup.tip_below_mm - SETUP.tip_below_mm, 0.0
        if (wider_mm and variants.wider is None) or (raised_mm and variants.raised is None):
            raise UsageError("this truth has no grasps at another stroke or height; ask for speeds and waits.")
        for law in laws:
            factor *= law.modulus_factor(moment)
            friction += law.friction_factor(moment) - 1.0
            wider_mm += law.wider_mm(moment)
            raised_mm += law.raised_mm(moment)
        trace = retime(_moved(variants, friction, wider_mm, raised_mm), site.setup)
        trace = Trace(trace.time_s, trace.lift_mm, factor * trace.force_n)
        for law in laws:
            trace = law.trace(trace, moment)
        return trace

    def moment(self, site: Site) -> Moment:
        """Return what laws may know of a grasp."""
        design = self.designs[site.tool]
        height_mm = get_object(self.objects[site.obj]).height_mm
        return Moment(numbered_design(design), seed_from("true tool", design), height_mm, site.context, site.setup)

    def _sensed(self, trace: Trace, rng: np.random.Generator) -> Trace:
        """Return the transmitter's readings: noise and tare on the force at its rate, from closing to past all objects.

        After its last true sample the gripper lifts on, free: the force stays what it was.
        """
        how = self.nuisance
        lifts = trace.is_lift
        start_s = trace.time_s[lifts][0]
        speed = (trace.lift_mm[lifts][-1] - trace.lift_mm[lifts][0]) / (trace.time_s[-1] - start_s)
        end_s = start_s + TRACE_END_MM / speed
        time_s = np.arange(trace.time_s[0], end_s, 1.0 / how.rate_hz)
        noise_n = how.noise_sd_n * _autoregressive(rng, len(time_s), how)
        tare_n = how.tare_n * rng.uniform(-1.0, 1.0)
        force_n = np.interp(time_s, trace.time_s, trace.force_n) + noise_n + tare_n
        return Trace(time_s, np.maximum(time_s - start_s, 0.0) * speed, force_n)


def retime(trace: Trace, setup: GraspSetup) -> Trace:
    """Turn a quasi-static trace at the usual speeds into that of another setup: the same forces at other times."""
    lifts = trace.is_lift
    start_s = float(trace.time_s[lifts][0])
    closed_s = start_s * SETUP.close_speed_mm_per_s / setup.close_speed_mm_per_s
    lift_s = (trace.time_s - start_s) * SETUP.lift_speed_mm_per_s / setup.lift_speed_mm_per_s
    time_s = np.where(lifts, closed_s + setup.dwell_s + lift_s, trace.time_s * closed_s / max(start_s, 1e-9))
    if setup.dwell_s == SETUP.dwell_s:
        return Trace(time_s, trace.lift_mm, trace.force_n)
    first = int(np.flatnonzero(lifts)[0])  # the force of the end of closing waits for the lift
    lift_mm, force_n = np.insert(trace.lift_mm, first, 0.0), np.insert(trace.force_n, first, trace.force_n[first])
    return Trace(np.insert(time_s, first, closed_s), lift_mm, force_n)


def _moved(variants: Variants, friction: float, wider_mm: float, raised_mm: float) -> Trace:
    """Return the base trace changed in proportion to the differences of its variants, on its own samples.

    Traces are compared from the start of their lifts: jaws that stop early have closed earlier, and wait.
    """
    base = variants.base
    force_n, base_s = base.force_n.copy(), base.time_s - base.time_s[base.is_lift][0]
    changes = (
        (variants.lower, friction / (variants.lower_factor - 1.0), friction),
        (variants.wider, wider_mm / variants.wider_by_mm, wider_mm),
        (variants.raised, raised_mm / variants.raised_by_mm, raised_mm),
    )
    for other, share, amount in changes:
        if amount != 0.0 and other is not None:
            other_s = other.time_s - other.time_s[other.is_lift][0]
            force_n += share * (np.interp(base_s, other_s, other.force_n) - base.force_n)
    return Trace(base.time_s, base.lift_mm, force_n)


def _draws(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.clip(rng.standard_normal(shape), -3.0, 3.0)


def _autoregressive(rng: np.random.Generator, n: int, how: Nuisance) -> np.ndarray:
    """Draw an AR(1) process of variance 1; with heavy tails innovations are Student's t with 3 degrees of freedom."""
    r = float(np.exp(-1.0 / (how.rate_hz * how.noise_correlation_s)))
    steps = rng.standard_t(3.0, n) / np.sqrt(3.0) if how.heavy_tails else rng.standard_normal(n)
    steps[1:] *= np.sqrt(1.0 - r * r)
    return np.asarray(lfilter([1.0], [1.0, -r], steps))

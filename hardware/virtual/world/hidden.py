"""Laws that a world can hide: the physics of the effect catalogue, each by another law than the catalogue's.

A gap-discovery method that only finds its own formula again has found nothing, so nothing here is
imported from, or shared with, the catalogue. Parameter names are the catalogue's, so that a world file reads naturally.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from shapely import affinity
from shapely.geometry import MultiPolygon, Polygon
from shapely.ops import unary_union

from fast.models.errors import ConfigError
from fast.models.objects.rigid import RigidObject
from fast.models.records import Design, EffectValue, Trace
from fast.models.simulation.effects.base import Effect
from fast.models.units import force_n_from_kg
from fast.models.validation import closest

LOAD_CELL_CAPACITY_N = force_n_from_kg(20.0)  # the paper's 20 kg load cell


class RationalSlipFriction(Effect):
    """Friction that changes with slip along a rational curve, factor = r + (1 - r) / (1 + (s / s0)^2).

    `kinetic_ratio` r = kinetic over static coefficient, `slip_scale_mm` s0 the slip at which half the change has
    happened. r = 1 changes nothing. Unlike an exponential it starts with zero slope and has a long tail.
    """

    def __init__(self, kinetic_ratio: float, slip_scale_mm: float) -> None:
        self.kinetic_ratio = kinetic_ratio
        self.slip_scale_mm = slip_scale_mm

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray:
        """Compute the factor (n) on the friction coefficient for accumulated slip (n) in mm."""
        ratio = self.kinetic_ratio
        return ratio + (1.0 - ratio) / (1.0 + (np.abs(slip_mm) / self.slip_scale_mm) ** 2)


class DirectionalDilation(Effect):
    """Print dilation that depends on the wall's direction and on the tool.

    Walls grow into the cavities by `offset_mm` times a tool factor (20 % sd) where their normal is along x, and by 60 %
    of that where it is along z (ribs: half of it on each face). Outer surfaces stay. Negative offsets thin the walls.
    """

    rib_share = 0.6
    tool_sd = 0.2

    def __init__(self, offset_mm: float, tool_seed: int) -> None:
        spread = np.random.default_rng([tool_seed, 0x0FF5E7]).standard_normal()
        self.offset_mm = offset_mm * (1.0 + self.tool_sd * float(np.clip(spread, -2.0, 2.0)))

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Return the planar profile (mm) with its cavities shrunk (or grown, for a negative offset)."""
        if self.offset_mm == 0:
            return profile
        cavities = [self._shrink(Polygon(ring)) for ring in profile.interiors]
        body = Polygon(profile.exterior).difference(unary_union(cavities))
        return max(body.geoms, key=lambda part: part.area) if isinstance(body, MultiPolygon) else body

    def _shrink(self, cavity: Polygon) -> Polygon:
        """Erode anisotropically: stretch so that both offsets are one unit, erode, stretch back."""
        size = abs(self.offset_mm)
        along_z = 0.5 * self.rib_share * size
        stretched = affinity.scale(cavity, 1.0 / size, 1.0 / along_z, origin=(0.0, 0.0))
        eroded = stretched.buffer(-1.0 if self.offset_mm > 0 else 1.0, join_style="mitre")
        return affinity.scale(eroded, size, along_z, origin=(0.0, 0.0))


class LeakyCylinder(Effect):
    """Jaws whose force fades as they stall: seal friction takes `seal_share` of `max_force_n`, more or less by tool.

    Infinite force changes nothing.
    """

    seal_share = 0.08
    tool_sd = 0.03

    def __init__(self, max_force_n: float, tool_seed: int) -> None:
        spread = np.random.default_rng([tool_seed, 0x5EA1]).standard_normal()
        loss = self.seal_share + self.tool_sd * float(np.clip(spread, -2.0, 2.0))
        self.jaw_force_n = max_force_n * (1.0 - loss)

    def closing_force_limit_n(self) -> float:
        """Return the force that is left of the cylinder's, N per jaw."""
        return self.jaw_force_n


class TiltingPost(Effect):
    """A post under the object that tilts, the more the taller the object, and stiffens.

    The state at lift l of a rigid post is reached at l + C (h / 40 mm) dF / (1 + |dF| / 40 N): `compliance_mm_per_n` C,
    h the object's height, dF the force since the start of the lift. C = 0 changes nothing.
    """

    def __init__(self, compliance_mm_per_n: float) -> None:
        self.compliance_mm_per_n = compliance_mm_per_n
        self._object_height_mm = 40.0

    def modify_object(self, obj: RigidObject) -> RigidObject:
        """Return the object as it is; its height is noted."""
        self._object_height_mm = obj.height_mm
        return obj

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the trace over the lift of the gantry."""
        return over_tilting_post(trace, self.compliance_mm_per_n * self._object_height_mm / 40.0)


def over_tilting_post(trace: Trace, compliance_mm_per_n: float) -> Trace:
    """Return a trace over the gantry's lift, not that against the object; where it goes back, the object sprang."""
    is_lift = trace.is_lift
    if compliance_mm_per_n == 0.0 or np.count_nonzero(is_lift) < 2:
        return trace
    time_s, lift_mm, force_n = trace.time_s, trace.lift_mm, trace.force_n
    first = int(np.flatnonzero(is_lift)[0])
    speed_mm_per_s = (lift_mm[-1] - lift_mm[first]) / (time_s[-1] - time_s[first])
    change_n = force_n - force_n[first]
    yielding_mm = compliance_mm_per_n * change_n / (1.0 + np.abs(change_n) / 40.0)
    gantry_mm = lift_mm + np.where(is_lift, yielding_mm, 0.0)
    before_mm = np.concatenate([[-np.inf], np.maximum.accumulate(gantry_mm)[:-1]])
    kept = ~is_lift | (gantry_mm >= np.maximum(before_mm, 0.0))
    gantry_s = np.where(is_lift, time_s[first] + gantry_mm / speed_mm_per_s, time_s)
    return Trace(gantry_s[kept], gantry_mm[kept], force_n[kept])


class SpanError(Effect):
    """Load cell whose span is wrong at low load and right at capacity: F (1 + (g - 1) (1 - |F| / capacity)).

    `gain` g = 1 changes nothing. Without end of the capacity the factor g is constant.
    """

    def __init__(self, gain: float, capacity_n: float = LOAD_CELL_CAPACITY_N) -> None:
        self.gain = gain
        self.capacity_n = capacity_n

    def modify_trace(self, trace: Trace) -> Trace:
        """Return the reported force of a true force (n), in N."""
        share = np.clip(np.abs(trace.force_n) / self.capacity_n, 0.0, 1.0)
        return Trace(trace.time_s, trace.lift_mm, trace.force_n * (1.0 + (self.gain - 1.0) * (1.0 - share)))


class MovingAverageLag(Effect):
    """Transmitter that averages over a window of 1.6 tau and answers 0.2 tau late: mean delay tau.

    `time_constant_s` tau. Before the first sample the force is taken as constant. On the bench it averages what the
    load cell really felt (`LaggingReadings`), so that speeds, waits and halts are in it.
    """

    window_share = 1.6
    latency_share = 0.2

    def __init__(self, time_constant_s: float) -> None:
        self.time_constant_s = time_constant_s

    @property
    def memory_s(self) -> float:
        """How far back the answer reaches."""
        return (self.window_share + self.latency_share) * self.time_constant_s

    def modify_trace(self, trace: Trace) -> Trace:
        """Average and delay the force (n), in N, at the same times."""
        if self.time_constant_s <= 0 or len(trace.time_s) < 2:
            return trace
        window_s = self.window_share * self.time_constant_s
        end_s = trace.time_s - self.latency_share * self.time_constant_s
        return Trace(trace.time_s, trace.lift_mm, mean_force_n(trace, end_s, window_s))


class LaggingReadings:
    """The answers of a lagging transmitter to forces as they come, one for each reading."""

    def __init__(self, lag: MovingAverageLag) -> None:
        self._lag = lag
        self._felt: deque[tuple[float, float]] = deque()

    def report(self, now_s: float, force_n: float) -> float:
        """Return the force in N that is reported now, when the cell feels `force_n`."""
        self._felt.append((now_s, force_n))
        while len(self._felt) > 2 and self._felt[1][0] < now_s - self._lag.memory_s:
            self._felt.popleft()
        times_s, forces_n = np.array(self._felt).T
        return float(self._lag.modify_trace(Trace(times_s, np.zeros_like(times_s), forces_n)).force_n[-1])


def mean_force_n(trace: Trace, end_s: np.ndarray, window_s: float) -> np.ndarray:
    """Average the force in N over windows that end at `end_s` (n); the force is constant before the trace."""
    return (_impulse(trace, end_s) - _impulse(trace, end_s - window_s)) / window_s


def _impulse(trace: Trace, at_s: np.ndarray) -> np.ndarray:
    """Integrate the piecewise linear force from the trace's start to `at_s`, in N s; constant force before."""
    time_s, force_n = trace.time_s, trace.force_n
    pieces = 0.5 * (force_n[1:] + force_n[:-1]) * np.diff(time_s)
    total = np.concatenate([[0.0], np.cumsum(pieces)])
    before = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 1)
    step_s = at_s - time_s[before]
    inside = total[before] + 0.5 * (force_n[before] + np.interp(at_s, time_s, force_n)) * step_s
    return np.where(at_s < time_s[0], force_n[0] * (at_s - time_s[0]), inside)


@dataclass(frozen=True)
class HiddenLaw:
    """How a named effect is built in a world: parameter limits (lowest, highest) and the constructor."""

    limits: dict[str, tuple[float, float]]
    build: Callable[[dict[str, float], int], Effect]


HIDDEN_LAWS: dict[str, HiddenLaw] = {
    "static_kinetic_friction": HiddenLaw(
        {"kinetic_ratio": (0.05, 5.0), "slip_scale_mm": (0.1, 100.0)},
        lambda parameters, _seed: RationalSlipFriction(**parameters),
    ),
    "wall_thickness_offset": HiddenLaw(
        {"offset_mm": (-1.0, 1.0)}, lambda parameters, seed: DirectionalDilation(parameters["offset_mm"], seed)
    ),
    "force_limited_closing": HiddenLaw(
        {"max_force_n": (1.0, 1e6)}, lambda parameters, seed: LeakyCylinder(parameters["max_force_n"], seed)
    ),
    "object_post_compliance": HiddenLaw(
        {"compliance_mm_per_n": (0.0, 0.5)}, lambda parameters, _seed: TiltingPost(**parameters)
    ),
    "load_cell_gain": HiddenLaw({"gain": (0.5, 2.0)}, lambda parameters, _seed: SpanError(**parameters)),
    "load_cell_lag": HiddenLaw(
        {"time_constant_s": (0.0, 5.0)}, lambda parameters, _seed: MovingAverageLag(**parameters)
    ),
}


def check_hidden(values: Sequence[EffectValue], source: str) -> None:
    """Check names, parameters and limits of hidden effects.

    Raises:
        ConfigError: unknown effect or parameter, a parameter missing or outside its limits.
    """
    for value in values:
        law = HIDDEN_LAWS.get(value.effect)
        if law is None:
            hint = closest(value.effect, list(HIDDEN_LAWS))
            raise ConfigError(f"{source}: unknown hidden effect `{value.effect}`; {hint}")
        for name in value.parameters:
            if name not in law.limits:
                hint = closest(name, list(law.limits))
                raise ConfigError(f"{source}: hidden effect `{value.effect}` has no parameter `{name}`; {hint}")
        for name, (lowest, highest) in law.limits.items():
            if name not in value.parameters:
                raise ConfigError(f"{source}: hidden effect `{value.effect}` needs `{name}`; add it.")
            number = value.parameters[name]
            if not lowest <= number <= highest:
                raise ConfigError(
                    f"{source}: `{name}` of hidden effect `{value.effect}` is {number:g}, it must be from {lowest:g} "
                    f"to {highest:g}; change it."
                )


TIMED = "load_cell_lag"  # acts on readings as they come, not on a solved trace


def find_lag(values: Sequence[EffectValue]) -> LaggingReadings | None:
    """Find the lag of a world's transmitter, if it hides one."""
    found = [value for value in values if value.effect == TIMED and value.parameters["time_constant_s"] > 0]
    return LaggingReadings(MovingAverageLag(**found[0].parameters)) if found else None


def build_hidden(values: Sequence[EffectValue], tool_seed: int) -> list[Effect]:
    """Build the hidden effects in order. `tool_seed` draws what differs from tool to tool.

    Raises:
        ConfigError: as `check_hidden`.
    """
    check_hidden(values, "world")
    return [HIDDEN_LAWS[value.effect].build(dict(value.parameters), tool_seed) for value in values]

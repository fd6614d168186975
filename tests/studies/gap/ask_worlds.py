"""Made-up benches of which a search asks grasps: their laws are other ones than the catalogue's of the same physics.

Nothing is simulated by finite elements. In worlds of the kind *unknown* no effect that may be named has the law at all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fast.flows.challenge.hidden.lab_laws import LAB_LAWS, LabLaw, Moment, lift_start_s
from fast.models.gap.ask.answers import Answers
from fast.models.gap.ask.predict import Pair
from fast.models.gap.data import GapData
from fast.models.gap.findings import NONE, UNKNOWN
from fast.models.ids import seed_from
from fast.models.objects.catalogue import get_object
from fast.models.records import Design, GraspContext, GraspSetup, Record, Theta, Trace
from tests.synthetic.gap import GapTruth, Hidden, made_up_answers, made_up_gap

N_TOOLS, N_OBJECTS = 6, 6
_DELAYS = ("load_cell_lag", "lift_misalignment", "lift_start_error")
# Members of sets that ordinary grasps confuse, each the truth in turn.
MEMBERS = (*_DELAYS, "stress_relaxation", "static_kinetic_friction")
_CREEP = "sliding_creep"
_LATER = "later_contact"
# Ends of what is drawn for a law: its amplitude, in the unit of the law; small ones raise no alarm as a rule.
_AMPLITUDES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "small": {
        "load_cell_lag": (0.06, 0.12),
        "lift_misalignment": (0.3, 0.6),
        "lift_start_error": (0.25, 0.5),
        "stress_relaxation": (0.03, 0.07),
        "static_kinetic_friction": (0.7, 0.85),
        "magnetic_pull": (1.0, 2.5),
        _CREEP: (0.04, 0.1),
        "object_post_compliance": (0.1, 0.2),
        _LATER: (0.0, 0.15),
    },
    "large": {
        "load_cell_lag": (0.12, 0.3),
        "lift_misalignment": (0.6, 1.5),
        "lift_start_error": (0.5, 0.9),
        "stress_relaxation": (0.07, 0.2),
        "static_kinetic_friction": (0.4, 0.7),
        "magnetic_pull": (2.5, 7.0),
        _CREEP: (0.1, 0.3),
        "object_post_compliance": (0.2, 0.6),
        _LATER: (0.15, 0.3),
    },
}
# Laws that nobody may name, with what is taken out of the catalogue for it.
_NOT_LISTED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("magnetic_pull", ()),
    ("load_cell_lag", _DELAYS),
    (_CREEP, ()),
    ("stress_relaxation", ("stress_relaxation",)),
    ("object_post_compliance", ("object_post_compliance",)),
    ("static_kinetic_friction", ("static_kinetic_friction",)),
)
Kind = Literal["member", "unknown", "nothing"]
Size = Literal["small", "large"]


class AskKey(Record):
    """What a world hides: a law and its amplitude, and theta; without: what nobody may name.

    Of the kind *nothing*, the simulator alone is another one: its fingers let go a little later, at any speed.
    """

    kind: Kind
    size: Size
    number: int
    seed: int
    law: str
    amplitude: float
    theta: Theta
    without: tuple[str, ...] = ()

    @property
    def answer(self) -> str:
        """What should be said of it."""
        return {"member": self.law, "unknown": UNKNOWN, "nothing": NONE}[self.kind]


def draw_key(secret: str, kind: Kind, size: Size, number: int) -> AskKey:
    """The key of a world, always the same for a secret; laws take turns."""
    rng = np.random.default_rng(seed_from("asking world", secret, kind, size, number))
    turns: Mapping[Kind, Sequence[tuple[str, tuple[str, ...]]]] = {
        "member": [(name, ()) for name in MEMBERS],
        "unknown": _NOT_LISTED,
        "nothing": [(_LATER, ())],
    }
    law, without = turns[kind][number % len(turns[kind])]
    theta = Theta(
        young_modulus_mpa=round(float(rng.uniform(7.0, 12.0)), 2),
        friction=round(float(rng.uniform(0.5, 0.85)), 3),
        poisson_ratio=round(float(rng.uniform(0.36, 0.45)), 3),
    )
    return AskKey(
        kind=kind,
        size=size,
        number=number,
        seed=int(rng.integers(2**31)),
        law=law,
        amplitude=round(float(rng.uniform(*_AMPLITUDES[size][law])), 4),
        theta=theta,
        without=without,
    )


@dataclass(frozen=True, eq=False)
class Bench:
    """A made-up bench. Only it knows its key: `data` are its ordinary grasps, `answer` makes those asked for."""

    key: AskKey
    data: GapData

    @staticmethod
    def of(key: AskKey) -> "Bench":
        """The bench of a key, its ordinary grasps made."""
        return Bench(key, made_up_gap(N_TOOLS, N_OBJECTS, key.seed, _hide(key), n_repeats=2))

    @property
    def catalogue(self) -> list[str]:
        """Effects that may be named."""
        return [name for name in self.data.training.names if name not in self.key.without]

    def answer(self, made: Mapping[Pair, int]) -> Answers:
        """What pairs of grasps give, so many of each."""
        return made_up_answers(self.data, self.key.seed, _hide(self.key), made)


class _SlidingCreep(LabLaw):
    """A contact that creeps as it slides: F (1 + t / 1 s)^-n, t since the lift began; a wait before it does nothing."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """The creeping force."""
        sliding_s = np.maximum(trace.time_s - lift_start_s(trace), 0.0)
        return Trace(trace.time_s, trace.lift_mm, trace.force_n * (1.0 + sliding_s) ** -self.amplitude)


class _LaterContact(LabLaw):
    """Another solver of the same physics: all of the lift comes `amplitude` mm later, whatever its speed."""

    def trace(self, trace: Trace, moment: Moment) -> Trace:
        """The later force."""
        true_mm = np.maximum(trace.lift_mm - self.amplitude, 0.0)
        return Trace(trace.time_s, trace.lift_mm, np.interp(true_mm, trace.lift_mm, trace.force_n))


_OWN_LAWS: Mapping[str, type[LabLaw]] = {_CREEP: _SlidingCreep, _LATER: _LaterContact}


def _hide(key: AskKey) -> GapTruth:
    if key.law == "static_kinetic_friction":
        law: Hidden = {"rational_friction": {"kinetic_ratio": key.amplitude, "slip_scale_mm": 2.0}}
        return GapTruth(theta=key.theta, unlisted=law)
    law_of_trace = {**LAB_LAWS, **_OWN_LAWS}[key.law](key.amplitude)

    def sense(trace: Trace, design: Design, object_id: int, context: GraspContext, setup: GraspSetup) -> Trace:
        tool_seed = seed_from("made-up tool", key.seed, design.model_dump_json())
        moment = Moment(design, tool_seed, get_object(object_id).height_mm, context, setup)
        return law_of_trace.trace(trace, moment)

    return GapTruth(theta=key.theta, sense=sense)

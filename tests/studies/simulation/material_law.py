"""How much a grasp depends on the elastic law: linear elastic in Green strain against neo-Hookean, same E and nu."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fast.models.design.space import numbered_design
from fast.models.errors import SimulationFailed
from fast.models.objects.catalogue import OBJECTS, get_object
from fast.models.records import GraspSimulation, Trace
from fast.models.simulation.body.elasticity import MaterialLaw
from fast.models.simulation.grasp import simulate_grasp
from fast.models.simulation.problem import Numerics
from tests.studies.benchmarks.accuracy import ACCURACY_OBJECTS, FIRST_DESIGN, N_DESIGNS, QUANTITIES
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.study import DEADLINE_S
from tests.studies.benchmarks.summary import Key, describe_errors

LAWS: tuple[MaterialLaw, MaterialLaw] = ("neo_hookean", "st_venant_kirchhoff")
STEP_MM = 0.25  # of the lift at which two traces are compared
TRACE = "trace_rms"  # a share of the peak, and so without a sign

Case = Key


@dataclass(frozen=True)
class LawOutcomes:
    """Grasps of one law by design and object, the reasons of those that failed, and CPU seconds of all."""

    results: Mapping[Case, GraspSimulation]
    reasons: Mapping[Case, str]
    cpu_s: Sequence[float]


def measure_material_law(options: Options) -> Tables:
    """Peak, work, closing force and trace with the paper's linear elastic law against the neo-Hookean one."""
    objects = options.objects or ACCURACY_OBJECTS
    designs = range(FIRST_DESIGN, FIRST_DESIGN + (options.designs or N_DESIGNS))
    cases = [(design, object_id) for design in designs for object_id in objects]
    usual, linear = (simulate_with(law, cases, options) for law in LAWS)
    names = (*QUANTITIES, TRACE)
    differences = {name: differences_percent(usual.results, linear.results, name) for name in names}
    return {
        "differences": [_difference_row(name, found) for name, found in differences.items()],
        "objects": [_object_row(object_id, differences) for object_id in objects],
        "laws": [_law_row(law, own) for law, own in zip(LAWS, (usual, linear), strict=True)],
    }


def simulate_with(law: MaterialLaw, cases: Sequence[Case], options: Options) -> LawOutcomes:
    """Every case with this law, production tier; a failure is counted and its reason kept."""
    results: dict[Case, GraspSimulation] = {}
    reasons: dict[Case, str] = {}
    for place, case in enumerate(cases, 1):
        try:
            results[case] = simulate_grasp(
                numbered_design(case[0]),
                get_object(case[1]),
                numerics=Numerics(material_law=law),
                deadline_s=DEADLINE_S,
            )
        except SimulationFailed as error:
            reasons[case] = error.reason
        if place % 12 == 0 or place == len(cases):
            options.tell(f"{law}: {place} of {len(cases)} grasps, {len(reasons)} failed")
    return LawOutcomes(results, reasons, [result.cpu_s for result in results.values()])


def differences_percent(
    usual: Mapping[Case, GraspSimulation], linear: Mapping[Case, GraspSimulation], name: str
) -> dict[Case, float]:
    """Signed difference of a quantity in per cent of its neo-Hookean value, for the grasps that both laws completed.

    Of `trace_rms`: the root mean square difference of the force over the lift, in per cent of the peak.
    """
    found = {}
    for case in sorted(usual.keys() & linear.keys()):
        one, other = usual[case], linear[case]
        if name == TRACE:
            difference, size = rms_difference_n(one.trace, other.trace), one.peak_force_n
        else:
            difference, size = getattr(other, name) - getattr(one, name), getattr(one, name)
        found[case] = 100.0 * difference / max(abs(size), QUANTITIES.get(name, QUANTITIES["peak_force_n"]))
    return found


def rms_difference_n(one: Trace, other: Trace) -> float:
    """Root mean square difference in N of two traces over the longer of their lifts; after its end a force is 0."""
    longest = max(float(trace.lift_mm[-1]) for trace in (one, other))
    at_mm = np.arange(0.0, longest + STEP_MM, STEP_MM)
    first, second = (_force_over_lift(trace, at_mm) for trace in (one, other))
    return float(np.sqrt(np.mean((second - first) ** 2)))


def _force_over_lift(trace: Trace, at_mm: np.ndarray) -> np.ndarray:
    lift = trace.is_lift
    return np.interp(at_mm, trace.lift_mm[lift], trace.force_n[lift], right=0.0)


def _difference_row(name: str, differences: Mapping[Case, float]) -> dict[str, object]:
    row: dict[str, object] = {"quantity": name, "grasps": len(differences)}
    if not differences:
        return row
    row |= describe_errors(differences)
    return row | {"bias_percent": None} if name == TRACE else row


def _object_row(object_id: int, differences: Mapping[str, Mapping[Case, float]]) -> dict[str, object]:
    """Median and worst difference of every quantity on an object."""
    row: dict[str, object] = {"object_id": object_id, "name": OBJECTS[object_id].name}
    for name, found in differences.items():
        own = [abs(value) for case, value in found.items() if case[1] == object_id]
        short = name.partition("_")[0]
        row[f"{short}_median_percent"] = float(np.median(own)) if own else None
        row[f"{short}_worst_percent"] = max(own, default=None)
    return row


def _law_row(law: MaterialLaw, own: LawOutcomes) -> dict[str, object]:
    """Failures, with their reasons, and cost of a law."""
    counts = Counter(own.reasons.values())
    return {
        "law": law,
        "grasps": len(own.results) + len(own.reasons),
        "failed": len(own.reasons),
        "reasons": ", ".join(f"{reason} {n}" for reason, n in sorted(counts.items())),
        "median_cpu_s": float(np.median(own.cpu_s)) if own.cpu_s else None,
        "mean_cpu_s": float(np.mean(own.cpu_s)) if own.cpu_s else None,
    }

"""How far the tiers are from the converged solution, over random designs and objects."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fast.models.objects.catalogue import OBJECTS
from fast.models.simulation.version import find_tier
from fast.models.solver_code import solver_id
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.benchmarks.outcomes import Outcome
from tests.studies.benchmarks.study import cases_of, run_study
from tests.studies.benchmarks.summary import Key, completed, describe_errors, failures_by_reason

TIERS = ("production",)
REFERENCE = "reference"
PIXELS_PER_INCH = 150
FIRST_DESIGN, N_DESIGNS = 300, 12  # no setting of the simulator was chosen with these
# One of each class, and two cubes, but no sphere, ellipsoid, disc, prism (like cylinder, cube) and spiral: without a
# mirror plane, its reference takes six times as long.
ACCURACY_OBJECTS = (6, 10, 14, 16, 19, 21, 23, 24, 26, 28, 30, 32)
# Quantity and the least value its error is related to: below, a relative error says nothing (load-cell noise: 0.06 N).
# Forces are in proportion to the modulus: errors in N are given at this one, as the worlds of virtual benches have it.
AT_MODULUS_MPA = 9.2
LARGE_ERROR_N = 0.5
QUANTITIES = {"peak_force_n": 0.1, "work_j": 1e-3, "contact_force_n": 0.1}


def measure_accuracy(options: Options) -> Tables:
    """Error of peak, work, contact force and trace against the reference; --figure draws the errors of all grasps."""
    tiers = options.tiers or TIERS
    objects = options.objects or ACCURACY_OBJECTS
    designs = range(FIRST_DESIGN, FIRST_DESIGN + (options.designs or N_DESIGNS))
    cases = cases_of(designs, (REFERENCE, *tiers), objects)
    outcomes = run_study(cases, options, n_workers=2, lasting_tiers=(REFERENCE,))
    if options.figure is not None:
        _draw(options.figure, {tier: trace_errors_n(outcomes, tier) for tier in tiers})
    return {
        "errors": [_error_row(outcomes, tier, quantity) for tier in tiers for quantity in QUANTITIES],
        "traces": [_trace_row(outcomes, tier) for tier in tiers],
        "objects": [row for tier in tiers for row in _by_object(outcomes, tier, objects)],
        "reference": _reference(outcomes),
        "failures": failures_by_reason(outcomes),
    }


def errors_percent(outcomes: Sequence[Outcome], tier: str, quantity: str) -> dict[Key, float]:
    """Signed relative error in percent of a quantity, for the grasps that the tier and the reference completed."""
    own, reference = completed(outcomes, tier), completed(outcomes, REFERENCE)
    found = {}
    for key in sorted(own.keys() & reference.keys()):
        value, truth = getattr(own[key], quantity), getattr(reference[key], quantity)
        found[key] = 100.0 * (value - truth) / max(abs(truth), QUANTITIES[quantity])
    return found


def _error_row(outcomes: Sequence[Outcome], tier: str, quantity: str) -> dict[str, object]:
    errors = errors_percent(outcomes, tier, quantity)
    row: dict[str, object] = {"tier": tier, "quantity": quantity, "grasps": len(errors)}
    return row | describe_errors(errors) if errors else row


def trace_errors_n(outcomes: Sequence[Outcome], tier: str) -> dict[Key, float]:
    """Root mean square error in N, at `AT_MODULUS_MPA`, of a tier's mean forces over every half millimetre of lift."""
    own, reference = completed(outcomes, tier), completed(outcomes, REFERENCE)
    scale = AT_MODULUS_MPA / find_tier(tier).theta.young_modulus_mpa
    return {
        key: scale * _rms(np.array(own[key].step_means_n) - np.array(reference[key].step_means_n))
        for key in sorted(own.keys() & reference.keys())
        if own[key].step_means_n and reference[key].step_means_n
    }


def _trace_row(outcomes: Sequence[Outcome], tier: str) -> dict[str, object]:
    errors, own = trace_errors_n(outcomes, tier), completed(outcomes, tier)
    row: dict[str, object] = {"tier": tier, "grasps": len(errors)}
    if not errors:
        return row
    scale = AT_MODULUS_MPA / find_tier(tier).theta.young_modulus_mpa
    values = np.array(list(errors.values()))
    worst = max(errors, key=lambda key: errors[key])
    large = [key for key, error in errors.items() if error > LARGE_ERROR_N]
    return {
        **row,
        "rms_n": _rms(values),
        "median_n": float(np.median(values)),
        "p95_n": float(np.percentile(values, 95)),
        "worst_n": errors[worst],
        "worst_design": worst[0],
        "worst_object": worst[1],
        f"above_{LARGE_ERROR_N}_n": len(large),
        "of_them_flagged": sum(bool(own[key].flag) for key in large),
        "flagged": sum(bool(own[key].flag) for key in errors),
        "force_rms_n": scale * _rms(np.concatenate([own[key].step_means_n for key in errors])),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _draw(path: Path, errors_n: Mapping[str, Mapping[Key, float]]) -> None:
    """Histogram of the trace errors of each tier over its grasps."""
    from fast.flows.report.style import INK, SIMULATED, figure_style, new_axes

    with figure_style():
        figure, axes = new_axes(5.4, 3.0)
        largest_n = max(max(errors.values(), default=0.0) for errors in errors_n.values())
        edges_n = np.arange(0.0, largest_n + 0.02, 0.02).tolist()
        for tier, errors in errors_n.items():
            axes.hist(list(errors.values()), edges_n, color=SIMULATED, alpha=1.0 / len(errors_n), label=tier)
        axes.axvline(LARGE_ERROR_N, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set_xlabel(f"root mean square error of a trace (N, at {AT_MODULUS_MPA} MPa)")
        axes.set_ylabel("grasps")
        if len(errors_n) > 1:
            axes.legend()
        figure.savefig(path, dpi=PIXELS_PER_INCH)


def _by_object(outcomes: Sequence[Outcome], tier: str, objects: Sequence[int]) -> Rows:
    """Median and worst error of every quantity on each object."""
    rows: Rows = []
    for object_id in objects:
        row: dict[str, object] = {"tier": tier, "object_id": object_id, "name": OBJECTS[object_id].name}
        for quantity in QUANTITIES:
            found = errors_percent(outcomes, tier, quantity)
            errors = [abs(error) for key, error in found.items() if key[1] == object_id]
            short = quantity.partition("_")[0]
            row[f"{short}_median_percent"] = float(np.median(errors)) if errors else None
            row[f"{short}_worst_percent"] = max(errors, default=None)
        traces = [error for key, error in trace_errors_n(outcomes, tier).items() if key[1] == object_id]
        row["trace_rms_n"] = _rms(np.array(traces)) if traces else None
        rows.append(row)
    return rows


def _reference(outcomes: Sequence[Outcome]) -> Rows:
    """What the reference is made of; solutions of an older solver are kept, and counted here."""
    own = [o for o in outcomes if o.tier == REFERENCE]
    old = sum(o.solver != solver_id() for o in own)
    cpu_s = float(np.median([o.cpu_s for o in own])) if own else None
    unknowns = float(np.median([o.n_dof for o in own if o.n_dof])) if any(o.n_dof for o in own) else None
    return [{"grasps": len(own), "of_older_code": old, "median_unknowns": unknowns, "median_cpu_s": cpu_s}]

"""How far the tiers are from the converged solution, over random designs and objects."""

from collections.abc import Sequence

import numpy as np

from flows.benchmarks.base import Options, Rows, Tables
from flows.benchmarks.outcomes import Outcome
from flows.benchmarks.study import cases_of, run_study
from flows.benchmarks.summary import Key, completed, failures_by_reason
from models.objects.catalogue import OBJECTS
from models.solver_code import solver_id

TIERS = ("production",)
REFERENCE = "reference"
FIRST_DESIGN, N_DESIGNS = 300, 12  # no setting of the simulator was chosen with these
# One of each class, and two cubes, but no sphere, ellipsoid, disc, prism (like cylinder, cube) and spiral: without a
# mirror plane, its reference takes six times as long.
ACCURACY_OBJECTS = (6, 10, 14, 16, 19, 21, 23, 24, 26, 28, 30, 32)
# Quantity and the least value its error is related to: below, a relative error says nothing (load-cell noise: 0.06 N).
QUANTITIES = {"peak_force_n": 0.1, "work_j": 1e-3, "contact_force_n": 0.1}


def measure_accuracy(options: Options) -> Tables:
    """Error of peak, work and contact force against the reference mesh: median, 90th percentile, worst, bias."""
    tiers = options.tiers or TIERS
    objects = options.objects or ACCURACY_OBJECTS
    designs = range(FIRST_DESIGN, FIRST_DESIGN + (options.designs or N_DESIGNS))
    cases = cases_of(designs, (REFERENCE, *tiers), objects)
    outcomes = run_study(cases, options, n_workers=2, lasting_tiers=(REFERENCE,))
    return {
        "errors": [_error_row(outcomes, tier, quantity) for tier in tiers for quantity in QUANTITIES],
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
    if not errors:
        return row
    signed = np.array(list(errors.values()))
    worst = max(errors, key=lambda key: abs(errors[key]))
    return {
        **row,
        "median_percent": float(np.median(np.abs(signed))),
        "p90_percent": float(np.percentile(np.abs(signed), 90)),
        "worst_percent": float(np.abs(signed).max()),
        "bias_percent": float(np.median(signed)),
        "worst_design": worst[0],
        "worst_object": worst[1],
    }


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
        rows.append(row)
    return rows


def _reference(outcomes: Sequence[Outcome]) -> Rows:
    """What the reference is made of; solutions of an older solver are kept, and counted here."""
    own = [o for o in outcomes if o.tier == REFERENCE]
    old = sum(o.solver != solver_id() for o in own)
    cpu_s = float(np.median([o.cpu_s for o in own])) if own else None
    unknowns = float(np.median([o.n_dof for o in own if o.n_dof])) if any(o.n_dof for o in own) else None
    return [{"grasps": len(own), "of_older_code": old, "median_unknowns": unknowns, "median_cpu_s": cpu_s}]

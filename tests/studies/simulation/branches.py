"""How many cells have two branches, and what the search for them costs: the grasps of the accuracy benchmark."""

from fast.models.design.space import numbered_design
from fast.models.objects.catalogue import OBJECTS, get_object
from fast.models.records import GraspSetup
from fast.models.simulation.branches import find_branches
from fast.models.simulation.grasp import SNAP, simulate_grasp
from fast.models.simulation.version import SimulatorVersion
from tests.studies.benchmarks.accuracy import ACCURACY_OBJECTS, FIRST_DESIGN, N_DESIGNS
from tests.studies.benchmarks.base import Options, Rows, Tables


def measure_branches(options: Options) -> Tables:
    """Cells with a snap, with two branches, runs and CPU of the search over random designs and objects."""
    version, setup = SimulatorVersion(), GraspSetup()
    objects = options.objects or ACCURACY_OBJECTS
    n_designs = options.designs or N_DESIGNS
    cells: Rows = []
    for place, number in enumerate(range(FIRST_DESIGN, FIRST_DESIGN + n_designs), 1):
        for object_id in objects:
            design, obj = numbered_design(number), get_object(object_id)
            nominal = simulate_grasp(design, obj, version, setup)
            found = find_branches(design, obj, version, setup, nominal)
            cells.append(
                {
                    "design": number,
                    "object_id": object_id,
                    "name": OBJECTS[object_id].name,
                    "snaps": nominal.flag == SNAP,
                    "branches": len(found.branches),
                    "cause": found.cause,
                    "branch_share": found.branches[0].share,
                    "share_error": found.share_error,
                    "works_mj": [round(1000.0 * branch.result.work_j, 1) for branch in found.branches],
                    "runs": found.n_runs,
                    "nominal_cpu_s": nominal.cpu_s,
                    "search_cpu_s": found.cpu_s,
                }
            )
        options.tell(f"{place} of {n_designs} designs")
    return {"all": [_summary(cells)], "two branches": [cell for cell in cells if cell["branches"] > 1]}


def _summary(cells: Rows) -> dict[str, object]:
    snapped = [cell for cell in cells if cell["snaps"]]
    two = [cell for cell in cells if cell["branches"] > 1]
    return {
        "cells": len(cells),
        "with_a_snap": len(snapped),
        "with_two_branches": len(two),
        "of_them_without_a_snap": sum(not cell["snaps"] for cell in two),
        "mean_runs": sum(cell["runs"] for cell in cells) / len(cells),
        "mean_runs_with_a_snap": sum(cell["runs"] for cell in snapped) / len(snapped) if snapped else None,
        "cost_of_the_search_per_nominal": sum(c["search_cpu_s"] for c in cells)
        / sum(c["nominal_cpu_s"] for c in cells),
    }

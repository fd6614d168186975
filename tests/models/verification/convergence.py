"""Convergence of a grasp in mesh, step and contact stiffness on six objects, kept in docs/verification.

    python -m tests.models.verification.convergence

solves every case that docs/verification/convergence.json lacks (a few CPU minutes in all) and prints the table.
"""

import json
import sys
from pathlib import Path

from models.design_space import BEST_PUBLISHED
from models.fem.contact import ContactLaw, PointSpacing
from models.fem.grasp import Numerics, simulate_grasp
from models.fem.stepping import StepLimits
from models.objects.catalogue import get_object
from models.records import MeshSettings, SimulatorVersion

CACHE = Path(__file__).parents[3] / "docs" / "verification" / "convergence.json"
OBJECTS = (1, 14, 24, 26, 28, 30)  # sphere, tube, cone, diabolo, hourglass, cube
PRODUCTION = MeshSettings()


def _steps(factor: float) -> Numerics:
    usual = StepLimits()
    limits = StepLimits(factor * usual.closing_mm, factor * usual.fine_lift_mm, factor * usual.lift_mm, max_steps=2400)
    return Numerics(limits=limits)


def _stiffness(factor: float) -> Numerics:
    """Stiffer contact needs finer points (see `models.fem.contact`)."""
    usual, spacing = ContactLaw(), PointSpacing()
    law = ContactLaw(factor * usual.normal_n_per_mm3, factor * usual.tangential_n_per_mm3, usual.smoothing_mm)
    finer = min(1.0, factor**-0.5)
    return Numerics(contact=law, spacing=PointSpacing(finer * spacing.along_mm, finer * spacing.across_mm))


def _mesh(**changes: float) -> MeshSettings:
    return PRODUCTION.model_copy(update=changes)


# Mesh and numerics by the name of the variant; all others are compared with the first.
VARIANTS: dict[str, tuple[MeshSettings, Numerics]] = {
    "production": (PRODUCTION, Numerics()),
    "edges of half the length": (_mesh(edge_mm=0.5 * PRODUCTION.edge_mm), Numerics()),
    "two layers": (_mesh(layers=2 * PRODUCTION.layers), Numerics()),
    "every element in four": (_mesh(refine=PRODUCTION.refine + 1), Numerics()),
    "every element in four, two layers": (
        _mesh(refine=PRODUCTION.refine + 1, layers=2 * PRODUCTION.layers),
        Numerics(),
    ),
    "steps x 2": (PRODUCTION, _steps(2.0)),
    "steps / 2": (PRODUCTION, _steps(0.5)),
    "steps / 4": (PRODUCTION, _steps(0.25)),
    "contact stiffness / 2": (PRODUCTION, _stiffness(0.5)),
    "contact stiffness x 2": (PRODUCTION, _stiffness(2.0)),
    "contact stiffness x 4": (PRODUCTION, _stiffness(4.0)),
}


def solve(variant: str, object_id: int) -> dict[str, float]:
    """Peak (N), work (J), unknowns and CPU seconds of one grasp by the best published design."""
    mesh, numerics = VARIANTS[variant]
    result = simulate_grasp(BEST_PUBLISHED, get_object(object_id), SimulatorVersion(mesh=mesh), numerics=numerics)
    return {
        "peak_n": round(result.peak_force_n, 4),
        "work_j": round(result.work_j, 6),
        "n_dof": result.n_dof,
        "cpu_s": round(result.cpu_s, 2),
    }


def cached() -> dict[str, dict[str, dict[str, float]]]:
    """Results by variant and object id, as far as they are known."""
    return json.loads(CACHE.read_text()) if CACHE.exists() else {}


def table(results: dict[str, dict[str, dict[str, float]]]) -> str:
    """Peaks of production in N, and what each variant changes in peak / work in percent, as Markdown."""
    names = [get_object(i).name for i in OBJECTS]
    rows = [["variant", "unknowns", *names], ["---"] * (len(names) + 2)]
    usual = results["production"]
    for variant, found in results.items():
        cells = []
        for i in map(str, OBJECTS):
            if variant == "production":
                cells.append(f"{found[i]['peak_n']:.2f} N, {1e3 * found[i]['work_j']:.0f} mJ")
            else:
                peak, work = (100.0 * (found[i][key] / usual[i][key] - 1.0) for key in ("peak_n", "work_j"))
                cells.append(f"{peak:+.1f} / {work:+.1f}")
        rows.append([variant, str(found[str(OBJECTS[0])]["n_dof"]), *cells])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main() -> None:
    """Fill the cache and print the table."""
    results = cached()
    for variant in VARIANTS:
        known = results.setdefault(variant, {})
        for object_id in OBJECTS:
            if str(object_id) not in known:
                known[str(object_id)] = solve(variant, object_id)
                CACHE.parent.mkdir(parents=True, exist_ok=True)
                CACHE.write_text(json.dumps(results, indent=1) + "\n")
    sys.stdout.write(table(results) + "\n")


if __name__ == "__main__":
    main()

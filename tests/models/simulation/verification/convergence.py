"""Convergence of a grasp in mesh, step and contact stiffness on six objects, kept in docs/verification.

    python -m tests.models.simulation.verification.convergence

solves every case that docs/verification/convergence.json lacks (some CPU minutes in all) and writes the table into
docs/reference/verification.md. A case belongs to the settings that it was solved with: change a default, and it is
solved again.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from fast.models.design.space import BEST_PUBLISHED
from fast.models.objects.catalogue import get_object
from fast.models.simulation.contact.law import ContactLaw, PointSpacing
from fast.models.simulation.grasp import Numerics, simulate_grasp
from fast.models.simulation.solver.stepping import StepLimits
from fast.models.simulation.version import FINEST_MESH, MeshSettings, SimulatorVersion

CACHE = Path(__file__).parents[4] / "docs" / "verification" / "convergence.json"
PAGE = CACHE.parents[1] / "reference" / "verification.md"
OBJECTS = (1, 14, 24, 26, 28, 30)  # sphere, tube, cone, diabolo, hourglass, cube
PRODUCTION = MeshSettings()


def _steps(factor: float) -> Numerics:
    usual = StepLimits()
    lengths = ("closing_mm", "fine_lift_mm", "lift_mm", "first_lift_mm", "event_mm", "missed_mm")
    changes = {name: factor * getattr(usual, name) for name in lengths}
    return Numerics(limits=replace(usual, **changes, max_steps=5000))


def _stiffness(factor: float) -> Numerics:
    """Stiffer contact needs finer points (see `models.simulation.contact.law`)."""
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
    "reference: in four, two layers": (FINEST_MESH, Numerics()),
    "steps x 2": (PRODUCTION, _steps(2.0)),
    "steps / 2": (PRODUCTION, _steps(0.5)),
    "steps / 4": (PRODUCTION, _steps(0.25)),
    "contact stiffness / 2": (PRODUCTION, _stiffness(0.5)),
    "contact stiffness x 2": (PRODUCTION, _stiffness(2.0)),
    "contact stiffness x 4": (PRODUCTION, _stiffness(4.0)),
}


class Case(TypedDict):
    """A variant's settings, and per object id its peak, work, unknowns and CPU seconds."""

    settings: str
    grasps: dict[str, dict[str, float]]


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


def settings_of(variant: str) -> str:
    """What decides a variant's numbers beyond the solver's tolerance, as text."""
    mesh, numerics = VARIANTS[variant]
    return f"{mesh!r} {numerics.contact!r} {numerics.spacing!r} {numerics.limits!r}"


def cached() -> dict[str, Case]:
    """Cases by variant, as far as they are known with the present settings."""
    known = json.loads(CACHE.read_text()) if CACHE.exists() else {}
    fresh = (v for v in VARIANTS if v in known and known[v]["settings"] == settings_of(v))
    return {variant: known[variant] for variant in fresh}


def table(cases: dict[str, Case]) -> str:
    """Peak and work of production, and what each variant changes in peak / work in percent, as Markdown."""
    names = [get_object(i).name for i in OBJECTS]
    rows = [["variant", "unknowns", *names], ["---"] * (len(names) + 2)]
    usual = cases["production"]["grasps"]
    for variant, case in cases.items():
        cells = []
        for i, grasp in case["grasps"].items():
            if variant == "production":
                cells.append(f"{grasp['peak_n']:.2f} N / {1e3 * grasp['work_j']:.0f} mJ")
            else:
                peak, work = (100.0 * (grasp[key] / usual[i][key] - 1.0) for key in ("peak_n", "work_j"))
                cells.append(f"{peak:+.1f} / {work:+.1f}")
        rows.append([variant, str(case["grasps"][str(OBJECTS[0])]["n_dof"]), *cells])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def table_in(page: str) -> str:
    """The table as the page has it."""
    found = re.search(r"^\| variant \|.*?(?=\n\n)", page, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found.group()


def main() -> None:
    """Fill the cache and write the table into the page."""
    cases = cached()
    for variant in VARIANTS:
        case = cases.setdefault(variant, {"settings": settings_of(variant), "grasps": {}})
        for object_id in OBJECTS:
            if str(object_id) not in case["grasps"]:
                case["grasps"][str(object_id)] = solve(variant, object_id)
                CACHE.write_text(json.dumps(cases, indent=1) + "\n")
    page = PAGE.read_text()
    PAGE.write_text(page.replace(table_in(page), table(cases)))


if __name__ == "__main__":
    main()

"""Hand-off folders for tests, as another lab would write them."""

import csv
from pathlib import Path

from fast.lake.provenance import Provenance
from fast.models.design.space import BEST_PUBLISHED

PROVENANCE = Provenance(code_version="x", code_dirty=False)
DESIGN = dict(BEST_PUBLISHED.model_dump())


def write_csv(path: Path, rows: list[dict]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def read_csv(path: Path) -> list[dict]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def grasp(grasp_id: str, **changes: object) -> dict:
    return {
        "grasp_id": grasp_id,
        "design_id": "mine-1",
        "object_id": 3,
        "repeat": 0,
        "fidelity": "real",
        "tool_id": "lab/B02T4",
        "started_at": "2026-03-01T10:00:00+01:00",
        "order": 12,
    } | changes


def samples(grasp_id: str, peak_n: float = 8.0) -> list[dict]:
    lift = [0.0, 0.0, 0.1, 1 / 3, 2.0]
    force = [0.0, -1.0, 3.0, peak_n, 0.1]
    return [
        {"grasp_id": grasp_id, "time_s": i / 80, "lift_mm": z, "force_n": f}
        for i, (z, f) in enumerate(zip(lift, force, strict=True))
    ]


def good_folder(directory: Path) -> Path:
    """A good hand-off of another lab: two measured grasps, two simulated ones."""
    directory.mkdir()
    write_csv(directory / "designs.csv", [{"design_id": "mine-1", **DESIGN}])
    sim = {"fidelity": "sim", "tool_id": "", "started_at": "", "order": ""}
    write_csv(
        directory / "grasps.csv",
        [
            grasp("a"),
            grasp("b", object_id=35, order="", started_at=""),
            grasp("s", **sim),
            grasp("t", object_id=4, **sim),
        ],
    )
    write_csv(directory / "traces.csv", [row for name in "abst" for row in samples(name)])
    theta = {"young_modulus_mpa": 9.5, "friction": 0.6, "poisson_ratio": 0.4}
    write_csv(
        directory / "simulations.csv",
        [
            {"grasp_id": "s", **theta, "contact_force_n": 2.5},
            {"grasp_id": "t", **dict.fromkeys(theta, ""), "contact_force_n": ""},
        ],
    )
    return directory

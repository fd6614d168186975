"""The simulator's bank as one Parquet table, a row per simulated grasp: what an entrant may compare traces with.

`kind`: `theta` (a grid of friction and Poisson's ratio), `centre` (one theta around which all else varies), `numerical`
(other meshes and contact stiffnesses), `placed` (tips deeper by so much), `wider` (jaws that stop early by so much),
`effect` (one effect of the catalogue at one size). `force_n`: means over steps of 0.5 mm of lift, 120 of them;
`before_n`: the end of the closing, of rows of kind `theta` alone. Forces are in proportion to Young's modulus.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fast.models.errors import UsageError
from fast.models.gap.bank.bank import CENTRE, DEEPER_MM, NUMERICAL, WIDER_MM, Bank, EffectRuns
from fast.models.gap.bank.sensor_effects import N_LEAD
from fast.models.gap.grasps import Cells
from fast.models.records import GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.models.traces.step_features import N_STEPS

_DIGITS = 3
_SCHEMA = pa.schema(
    [
        ("design_id", pa.string()),
        ("object_id", pa.int32()),
        ("kind", pa.string()),
        ("number", pa.int32()),
        ("young_modulus_mpa", pa.float64()),
        ("friction", pa.float64()),
        ("poisson_ratio", pa.float64()),
        ("effect", pa.string()),
        ("parameters_json", pa.string()),
        ("force_n", pa.list_(pa.float32())),
        ("before_n", pa.list_(pa.float32())),
    ]
)


def write_bank(path: Path, bank: Bank, design_ids: Sequence[str]) -> None:
    """Write a bank of these designs; a simulation that failed has no row."""
    rows = list(_list_rows(bank, design_ids))
    table = pa.Table.from_pylist(rows, schema=_SCHEMA)
    pq.write_table(table, path, compression="zstd", compression_level=19)


def read_bank(path: Path, design_ids: Sequence[str], objects: Sequence[int]) -> Bank:
    """Read the bank of these designs and objects, in this order.

    Raises:
        UsageError: the file is no table of a bank.
    """
    try:
        table = pq.read_table(path, schema=_SCHEMA)
    except (OSError, pa.ArrowInvalid) as error:
        raise UsageError(f"{path} is no table of simulations ({error}); copy the challenge's folder again.") from error
    rows = table.drop_columns(["force_n", "before_n"]).to_pylist()
    force_n = np.array(table["force_n"].combine_chunks().flatten()).reshape(-1, N_STEPS).astype(float)
    tools = {name: place for place, name in enumerate(design_ids)}
    columns = {number: place for place, number in enumerate(objects)}
    grid = sorted({(row["number"], row["friction"], row["poisson_ratio"]) for row in rows if row["kind"] == "theta"})
    runs: dict[str, dict[int, Mapping[str, float]]] = {}
    for row in rows:
        if row["kind"] == "effect":
            runs.setdefault(row["effect"], {})[row["number"]] = json.loads(row["parameters_json"])
    shape = (len(tools), len(columns))
    counts = {"theta": len(grid), "centre": 1, "numerical": len(NUMERICAL), "placed": 2, "wider": len(WIDER_MM)}
    counts |= {name: len(of_effect) for name, of_effect in runs.items()}
    found = {name: np.full((*shape, n, N_STEPS), np.nan) for name, n in counts.items()}
    lead_n = np.full((*shape, len(grid), N_LEAD), np.nan)
    leads = table["before_n"].to_pylist()
    for place, row in enumerate(rows):
        if row["design_id"] in tools and row["object_id"] in columns:
            cell = (tools[row["design_id"]], columns[row["object_id"]], row["number"])
            found[row["effect"] or row["kind"]][cell] = force_n[place]
            if row["kind"] == "theta":
                lead_n[cell] = leads[place]
    return Bank(
        targets=Cells.full([], objects, GraspSetup()).targets,
        centre=CENTRE,
        grid=np.array([point[1:] for point in grid]),
        grid_steps_n=found["theta"],
        grid_lead_n=lead_n,
        centre_steps_n=found["centre"][:, :, 0],
        numerical_steps_n=found["numerical"],
        placed_steps_n=found["placed"],
        wider_steps_n=found["wider"],
        effects={
            name: EffectRuns(name, tuple(of_effect[number] for number in sorted(of_effect)), found[name])
            for name, of_effect in runs.items()
        },
    )


def _list_rows(bank: Bank, design_ids: Sequence[str]) -> Iterator[dict[str, Any]]:
    centre = bank.centre.model_dump()
    usual = SimulatorVersion()
    numerical = [usual.model_copy(update=dict(one)).model_dump(mode="json", include=set(one)) for one in NUMERICAL]
    kinds: list[tuple[str, str, np.ndarray, list[Any]]] = [
        ("centre", "", bank.centre_steps_n[:, :, None], [{}]),
        ("numerical", "", bank.numerical_steps_n, numerical),
        ("placed", "", bank.placed_steps_n, [{"tips_deeper_mm": deeper} for deeper in DEEPER_MM]),
        ("wider", "", bank.wider_steps_n, [{"each_jaw_stops_earlier_mm": wider} for wider in WIDER_MM]),
        *(
            ("effect", name, runs.steps_n, [dict(row) for row in runs.parameters])
            for name, runs in bank.effects.items()
        ),
    ]
    thetas = [centre | {"friction": mu, "poisson_ratio": nu} for mu, nu in bank.grid.tolist()]
    for tool, design_id in enumerate(design_ids):
        for column, target in enumerate(bank.targets):
            head = {"design_id": design_id, "object_id": target.object_id}
            for number, theta in enumerate(thetas):
                force_n, before_n = (part[tool, column, number] for part in (bank.grid_steps_n, bank.grid_lead_n))
                if np.isfinite(force_n).all():
                    row = {"kind": "theta", "number": number, "effect": "", "parameters_json": "{}"}
                    yield head | row | theta | {"force_n": _round(force_n), "before_n": _round(before_n)}
            for kind, effect, steps_n, parameters in kinds:
                for number, values in enumerate(parameters):
                    force_n = steps_n[tool, column, number]
                    if np.isfinite(force_n).all():
                        row = {"kind": kind, "number": number, "effect": effect, "parameters_json": json.dumps(values)}
                        yield head | row | centre | {"force_n": _round(force_n), "before_n": []}


def _round(force_n: np.ndarray) -> np.ndarray:
    return np.round(force_n, _DIGITS).astype(np.float32)

"""A small panel of true grasps and its bank in one compressed file: hidden-effect worlds that take seconds."""

import json
from pathlib import Path

import numpy as np

from fast.flows.challenge.hidden.panels import Panels, TrueSet
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import CENTRE, NUMERICAL, Bank, EffectRuns
from fast.models.gap.grasps import Cells
from fast.models.records import GraspSetup, Trace

PANEL = Path(__file__).parents[1] / "panel.npz"  # 9 designs, 7 objects, 23 sets of true grasps; everybody may see it
STEP_N = 0.002  # forces are kept in whole multiples of it


def read_small(path: Path) -> tuple[Panels, Bank]:
    """Read the panels and the bank of the file.

    Raises:
        UsageError: its bank is that of another version of the program.
    """
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    n_variants = arrays["numerical_steps_n"].shape[2]
    if n_variants != len(NUMERICAL):
        raise UsageError(
            f"the bank in {path} has {n_variants} numerical variants of each cell, that of this version "
            f"{len(NUMERICAL)}; make the panel again with `python -m tests.studies gap-truth`."
        )
    effects = {
        name: EffectRuns(name, tuple(json.loads(str(arrays[f"amplitudes {name}"]))), _unpacked(arrays[f"field {name}"]))
        for name in (key.removeprefix("field ") for key in arrays if key.startswith("field "))
    }
    centre_steps_n = _unpacked(arrays["centre_steps_n"])
    designs, objects = (tuple(int(number) for number in arrays[key]) for key in ("designs", "objects"))
    bank = Bank(
        targets=Cells.full([], objects, GraspSetup()).targets,
        centre=CENTRE,
        grid=arrays["grid"],
        grid_steps_n=_unpacked(arrays["grid_steps_n"]),
        centre_steps_n=centre_steps_n,
        grid_lead_n=_unpacked(arrays["grid_lead_n"]),
        numerical_steps_n=_unpacked(arrays["numerical_steps_n"]),
        placed_steps_n=_unpacked(arrays["placed_steps_n"]),
        wider_steps_n=_unpacked(arrays["wider_steps_n"]),
        effects=effects,
    )
    names = [name.removeprefix("cells ") for name in arrays if name.startswith("cells ")]
    cells = {name: _cells(arrays[f"cells {name}"], arrays[f"samples {name}"].astype(float)) for name in names}
    return Panels(
        designs, objects, {name: TrueSet.model_validate_json(str(arrays[f"set {name}"])) for name in names}, cells
    ), bank


def _cells(table: np.ndarray, samples: np.ndarray) -> dict[tuple[int, int], Trace]:
    ends = np.cumsum(table[:, 2])
    return {
        (int(tool), int(obj)): Trace(*samples[:, end - n : end])
        for (tool, obj, n), end in zip(table, ends, strict=True)
    }


def _unpacked(packed: np.ndarray) -> np.ndarray:
    is_lost = (packed == np.iinfo(np.int16).min).all(axis=-1)
    steps_n = STEP_N * np.cumsum(packed.astype(np.int32), axis=-1)
    steps_n[is_lost] = np.nan
    return np.asarray(steps_n)

"""Writes the small panel that is read by `read_small`."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fast.flows.challenge.hidden.panel_file import STEP_N
from fast.flows.challenge.hidden.panels import CHANNELS, Panels
from fast.models.gap.bank.bank import Bank

ARRAYS = ("grid_steps_n", "grid_lead_n", "centre_steps_n", "numerical_steps_n", "placed_steps_n", "wider_steps_n")


def write_small(path: Path, panels: Panels, bank: Bank, names: Sequence[str]) -> None:
    """Keep these sets of true grasps and the bank of the same designs and objects."""
    arrays: dict[str, np.ndarray] = {"grid": bank.grid, "designs": np.array(panels.designs)}
    arrays["objects"] = np.array(panels.objects)
    for name in ARRAYS:
        arrays[name] = _packed(getattr(bank, name))
    for name, field in bank.effects.items():
        arrays[f"field {name}"] = _packed(field.steps_n)
        arrays[f"amplitudes {name}"] = np.array(json.dumps([dict(row) for row in field.parameters]))
    for name in names:
        cells = panels.cells[name]
        arrays[f"set {name}"] = np.array(panels.sets[name].model_dump_json())
        arrays[f"cells {name}"] = np.array([[*place, len(trace.time_s)] for place, trace in cells.items()])
        samples = [np.stack([getattr(trace, channel) for channel in CHANNELS]) for trace in cells.values()]
        arrays[f"samples {name}"] = np.concatenate(samples, axis=1).astype(np.float32)
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _packed(steps_n: np.ndarray) -> np.ndarray:
    """Forces as differences of whole steps along the lift, which compress well; NaN as the least number."""
    whole = np.round(np.nan_to_num(steps_n) / STEP_N).astype(np.int32)
    packed = np.diff(whole, axis=-1, prepend=0).astype(np.int16)
    packed[np.isnan(steps_n).any(axis=-1)] = np.iinfo(np.int16).min
    return np.asarray(packed)

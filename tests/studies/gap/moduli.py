"""Which effects make a fitted modulus depend on the object: what one finger on two objects can tell, from the bank.

A modulus is fitted to the forces of each object alone, by the simulator without the effect. Effects that change all
objects alike are a modulus to these data; the others leave a ratio that no modulus explains.
"""

import numpy as np

from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from fast.models.gap.bank.bank import Bank
from tests.studies.benchmarks.base import Options, Rows, Tables


def measure_moduli(options: Options) -> Tables:
    """By how much fitted moduli of two objects differ under each simulated effect, over pairs of objects."""
    _, bank = read_small(options.panel or PANEL)
    return {"smaller over larger modulus of two objects": list_ratios(bank)}


def list_ratios(bank: Bank) -> Rows:
    """Of each effect at each size, the median and the least ratio of two moduli, over pairs of objects."""
    rows: Rows = []
    for name, runs in bank.effects.items():
        for place, parameters in enumerate(runs.parameters):
            moduli = _fit_moduli(bank.centre_steps_n, runs.steps_n[:, :, place])
            first, second = np.triu_indices(moduli.shape[1], k=1)
            ratios = moduli[:, first] / moduli[:, second]
            smaller = np.nanmedian(np.minimum(ratios, 1.0 / ratios), axis=0)
            setting = ", ".join(f"{key} {value:g}" for key, value in parameters.items())
            row = {"median": round(float(np.median(smaller)), 2), "least": round(float(smaller.min()), 2)}
            rows.append({"effect": name, "setting": setting} | row)
    return rows


def _fit_moduli(bare_n: np.ndarray, with_it_n: np.ndarray) -> np.ndarray:
    """Moduli of each tool on each object (t x o) over that of the bank, by least squares of the lift (t x o x 120)."""
    return np.asarray((with_it_n * bare_n).sum(axis=-1) / (bare_n**2).sum(axis=-1))

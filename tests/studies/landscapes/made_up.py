"""A small made-up bank of landscapes: two truths that differ from the believed simulator by a shift and a limit."""

from pathlib import Path

import numpy as np

from fast.models.design.space import from_unit, random_unit, to_unit
from fast.models.records import EffectValue, Theta
from tests.studies.landscapes.bank import EFFECT, THETA, TRUE, DesignSet, LandscapeBank, Truth, mean_peaks

N_COMMON, N_BELIEVED = 40, 90


def believed_n(x: np.ndarray) -> np.ndarray:
    """A smooth hill, N."""
    return np.asarray(4.0 + 16.0 * np.exp(-2.0 * ((x[:, 4:7] - 0.5) ** 2).sum(axis=1)))


def true_n(x: np.ndarray, number: int) -> np.ndarray:
    """The hill moved, or cut off, N."""
    return believed_n(x - 0.15) if number == 0 else np.asarray(12.0 * np.tanh(believed_n(x) / 12.0))


def made_up_bank() -> LandscapeBank:
    """Night finds theta (a factor), and the whole truth with the effect."""
    x = to_unit(from_unit(random_unit(N_BELIEVED, np.random.default_rng(5))))
    truths = [
        Truth(
            name=f"truth {number}",
            theta=Theta(),
            laws=(EffectValue(effect="shear_adhesion", parameters={"shear_strength_mpa": 0.001}),),
            theta_only=Theta(),
            theta_found=Theta(),
            sets={
                TRUE: mean_peaks(true_n(x[:N_COMMON], number)[:, None]),
                THETA: mean_peaks(0.8 * believed_n(x[:N_COMMON])[:, None]),
                EFFECT: mean_peaks(true_n(x[:N_COMMON], number)[:, None]),
            },
        )
        for number in range(2)
    ]
    believed = DesignSet.of(x, believed_n(x)[:, None])
    return LandscapeBank(objects=(2,), believed=believed, n_common=N_COMMON, truths=tuple(truths))


def write_bank(folder: Path) -> Path:
    """The bank as a file."""
    path = folder / "landscapes.json"
    path.write_text(made_up_bank().model_dump_json())
    return path

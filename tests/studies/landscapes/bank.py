"""Stored designs with their simulated peaks: what landscapes are made of (`docs/benchmarks/landscapes.json`)."""

from pathlib import Path

import numpy as np
from pydantic import ValidationError

from fast.models.design.fin_ray import FinRay
from fast.models.design.space import from_unit, to_unit
from fast.models.errors import UsageError
from fast.models.ids import content_id
from fast.models.records import EffectValue, Record, Theta

BELIEVED, TRUE, THETA, EFFECT = "believed", "true", "theta", "theta and effect"


def mean_peaks(peaks_n: np.ndarray) -> tuple[float | None, ...]:
    """Means over the objects of peaks (n x objects), N; none where a grasp failed."""
    return tuple(round(float(n), 4) if np.isfinite(n) else None for n in peaks_n.mean(axis=1))


class DesignSet(Record):
    """Designs with the mean over the objects of their peaks, N; none where a grasp failed."""

    designs: tuple[tuple[float, ...], ...]  # n x 9, in the units of `Design`
    mean_peak_n: tuple[float | None, ...]

    @staticmethod
    def of(x: np.ndarray, peaks_n: np.ndarray) -> "DesignSet":
        """From unit-cube designs (n x 9) and their peaks (n x objects); NaN where a grasp failed."""
        designs = tuple(tuple(design.model_dump().values()) for design in from_unit(x))
        return DesignSet(designs=designs, mean_peak_n=mean_peaks(peaks_n))

    @property
    def x(self) -> np.ndarray:
        """Designs in the unit cube, n x 9."""
        names = tuple(FinRay.model_fields)
        return to_unit([FinRay.model_validate(dict(zip(names, row, strict=True))) for row in self.designs])

    @property
    def y(self) -> np.ndarray:
        """Mean peaks, n, N; NaN where a grasp failed."""
        return np.array(self.mean_peak_n, dtype=float)


class Truth(Record):
    """One hidden truth, and what a night finds of it.

    `theta_only`: what a night finds without a name. `theta_found`, `found`: theta and effects, given the names of the
    laws; one that explains nothing is not among them. `sets`: mean peaks of the same designs in the truth, and in the
    simulator after either night.
    """

    name: str
    theta: Theta
    laws: tuple[EffectValue, ...]
    theta_only: Theta
    theta_found: Theta
    found: tuple[EffectValue, ...] = ()
    sets: dict[str, tuple[float | None, ...]]


class LandscapeBank(Record):
    """Designs on `objects`: `believed` of all of them, and each truth's of the first `n_common` of them."""

    objects: tuple[int, ...]
    believed: DesignSet
    n_common: int
    truths: tuple[Truth, ...]

    @property
    def bank_id(self) -> str:
        """Id derived from the content."""
        return content_id("U", self.model_dump(mode="json"))

    def landscape_name(self, number: int) -> str:
        """What the landscape of a truth is called: another bank makes another one."""
        return f"{self.truths[number].name} of {self.bank_id}"

    @staticmethod
    def read(path: Path) -> "LandscapeBank":
        """The bank of a file.

        Raises:
            UsageError: there is no such file, or it is no bank.
        """
        try:
            return LandscapeBank.model_validate_json(path.read_text())
        except OSError as error:
            raise UsageError(f"`{path}` cannot be read: {error.strerror}; give the bank of landscapes.") from error
        except ValidationError as error:
            raise UsageError(f"`{path}` is no bank of landscapes; `docs/benchmarks/landscapes.json` is one.") from error

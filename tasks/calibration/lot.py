"""The priors of a calibration from the material lot of its tools, the same way for means and for traces."""

from collections.abc import Collection

import numpy as np

from fast.lake.store import Lake
from fast.models.calibration.inference.lot_priors import TAIL, make_lot_priors
from fast.models.calibration.inference.settings import CalibrationSettings
from fast.models.material import modulus_of_hardness_mpa
from fast.tasks.campaign.material import StoredLot, find_lot


def take_lot(
    lake: Lake, settings: CalibrationSettings, asked: str | None, campaign_ids: Collection[str]
) -> tuple[CalibrationSettings, StoredLot | None]:
    """Settings with the priors of the lot that was asked for or that the campaigns name, and the lot.

    Without a lot the settings stay as they are; `asked` as in `tasks.campaign.material.find_lot`.

    Raises:
        UsageError: the lot is not there, cannot be used, or makes no prior.
    """
    lot = find_lot(lake, asked, campaign_ids)
    if lot is None:
        return settings, None
    return settings.model_copy(update={"priors": make_lot_priors(lot.name, lot.lot)}), lot


def describe_lot(settings: CalibrationSettings, stored: StoredLot) -> str:
    """The priors that a lot gave, in words, and what its hardness would say of the modulus."""
    lot, ends = stored.lot, settings.priors.quantile(np.outer([0.5, TAIL, 1.0 - TAIL], np.ones(3)))
    given = {"Young's modulus": lot.young_modulus, "friction": lot.static_friction or lot.dynamic_friction}
    parts = [
        f"{words} {ends[0, k]:.3g}{unit} ({ends[1, k]:.3g} to {ends[2, k]:.3g})"
        + ("" if given[words] is not None else " from Table 3")
        for k, (words, unit) in enumerate((("Young's modulus", " MPa"), ("friction", "")))
    ]
    sentence = f"priors of material lot {stored.name}, median and 90 % interval: {', '.join(parts)}"
    if lot.hardness is None:
        return sentence
    modulus_mpa = modulus_of_hardness_mpa(lot.hardness.value)
    return f"{sentence}; only to check: {lot.hardness.value:g} Shore A is about {modulus_mpa:.3g} MPa by Gent's formula"

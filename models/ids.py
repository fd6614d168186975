"""Ids derived from content: doing the same thing twice gives the same id, so nothing is duplicated."""

import hashlib
import json
from typing import Any

# What each prefix of an id stands for: one meaning each. `docs/reference/identifiers.md` says what an id is made from.
PREFIXES = {
    "A": "a run of gap discovery",
    "B": "a physics request of a virtual bench",
    "C": "a calibration",
    "D": "a design",
    "E": "an event",
    "F": "a fit of the surrogate",
    "G": "a grasp setup, with the placement asked for",
    "H": "the settings of a run",
    "I": "a grasp that is asked for",
    "K": "a measured grasp",
    "L": "a quantity of a material lot",
    "M": "a mesh",
    "N": "a finding of gap discovery",
    "P": "a proposal",
    "Q": "draws of one parameter in one chain",
    "S": "a simulated grasp",
    "T": "features of a trace",
    "U": "a row of a study, never in a lake",
    "V": "a simulator version",
    "W": "a world",
    "X": "an effect of a simulator version",
    "Y": "an anomaly flag",
    "Z": "a held-out split",
}


def canonical_json(payload: Any) -> str:
    """Write JSON with sorted keys and no spaces; floats as Python's shortest round-trip text."""
    return json.dumps(payload, sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_id(prefix: str, payload: Any) -> str:
    """Return `prefix` (one of `PREFIXES`) plus 12 hex digits of the SHA-256 of `payload` (any JSON value).

    >>> content_id("K", ["B01T0", 30, 0, 0])
    'K32e915377c6e'
    """
    if prefix not in PREFIXES:
        raise ValueError(f"the id prefix {prefix!r} has no meaning in models.ids.PREFIXES; give it one there")
    return prefix + hashlib.sha256(canonical_json(payload).encode()).hexdigest()[:12]


def seed_from(*parts: Any) -> int:
    """Derive a 63-bit random seed from its parts, so that a resumed task draws the same numbers."""
    return int(hashlib.sha256(canonical_json(list(parts)).encode()).hexdigest()[:16], 16) >> 1


def tool_label(batch: int, slot: int) -> str:
    """Return the short label of a tool as the paper prints it: batch 7, slot 8 is `B07T8`."""
    return f"B{batch:02d}T{slot}"


def id_in_lab(id_: str, lab: str | None) -> str:
    """Return `<lab>.<id>`, so that ids of two labs never meet; the id itself if the lab has no name, or is in it."""
    return id_ if lab is None or id_.startswith(f"{lab}.") else f"{lab}.{id_}"

"""Ids derived from content: doing the same thing twice gives the same id, so nothing is duplicated."""

import hashlib
import json
from typing import Any


def canonical_json(payload: Any) -> str:
    """JSON with sorted keys and no spaces; floats as Python's shortest round-trip text."""
    return json.dumps(payload, sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_id(prefix: str, payload: Any) -> str:
    """`prefix` plus 12 hex digits of the SHA-256 of `payload` (any JSON value)."""
    return prefix + hashlib.sha256(canonical_json(payload).encode()).hexdigest()[:12]


def seed_from(*parts: Any) -> int:
    """A 63-bit random seed derived from its parts, so that a resumed task draws the same numbers."""
    return int(hashlib.sha256(canonical_json(list(parts)).encode()).hexdigest()[:16], 16) >> 1


def tool_label(batch: int, slot: int) -> str:
    """Short label of a tool as the paper prints it: batch 7, slot 8 is `B07T8`."""
    return f"B{batch:02d}T{slot}"

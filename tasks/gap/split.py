"""Which designs and objects are held out: chosen once from a seed, and written down before anything is looked at.

New designs and objects join the split of the same seed; none ever changes sides, so what was held out stays unseen.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow
from fast.models.ids import content_id, seed_from
from fast.models.objects.catalogue import get_object
from fast.tasks.calibration.mean_data import TooLittleDataError

KIND = "gap_split"
MIN_DESIGNS, MIN_OBJECTS = 7, 5  # five tools and four objects are left to look at
DESIGN_SHARE, OBJECT_SHARE = 0.3, 0.22  # 6 of 20 designs, 8 of 36 objects


@dataclass(frozen=True)
class Split:
    """Designs and objects of a seed, and whether each is held out; `split_id` is derived from all of it."""

    designs: Mapping[str, bool]
    objects: Mapping[int, bool]

    @property
    def split_id(self) -> str:
        """Id derived from the content: the hash that the report states."""
        return content_id("Z", self._payload())

    @property
    def words(self) -> str:
        """How many are held out."""
        designs, objects = self.designs.values(), self.objects.values()
        return f"{sum(designs)} of {len(designs)} designs and {sum(objects)} of {len(objects)} objects"

    def json(self) -> str:
        """Return the split as it is kept in the lake."""
        return json.dumps(self._payload(), sort_keys=True)

    def _payload(self) -> dict[str, dict[str, bool]]:
        return {"designs": dict(self.designs), "objects": {str(key): held for key, held in self.objects.items()}}


def freeze_split(
    lake: Lake, campaign_id: str | None, design_ids: Sequence[str], object_ids: Sequence[int], seed: int
) -> Split:
    """Return the split of these designs and objects, from the lake or made now and written there.

    Raises:
        TooLittleDataError: there are too few designs or objects to hold any out.
    """
    counts = (("designs", len(set(design_ids)), MIN_DESIGNS), ("objects", len(set(object_ids)), MIN_OBJECTS))
    for what, n, least in counts:
        if n < least:
            raise TooLittleDataError(
                f"{n} {what} were measured, gap discovery needs at least {least} to hold some out; with 14 designs it "
                "finds about 8 of 10 effects that change forces by 5 %, so measure more."
            )
    known = _newest(lake, campaign_id, seed)
    split = _extend(known, sorted(set(design_ids)), sorted(set(object_ids)), seed)
    if split != known:
        _write(lake, campaign_id, seed, split)
    return split


def _extend(known: Split, design_ids: Sequence[str], object_ids: Sequence[int], seed: int) -> Split:
    """Extend the split by those it lacks; shares are of all, so that later ones make up for what came before."""
    rng = np.random.default_rng(seed_from(seed, "gap split", len(known.designs), len(known.objects)))
    all_designs = list(dict.fromkeys([*known.designs, *design_ids]))
    all_objects = list(dict.fromkeys([*known.objects, *object_ids]))
    by_class = {str(object_id): get_object(object_id).object_class for object_id in all_objects}
    objects = {str(object_id): held for object_id, held in known.objects.items()}
    designs = _hold_out(known.designs, dict.fromkeys(all_designs, ""), rng, DESIGN_SHARE)
    held_objects = _hold_out(objects, by_class, rng, OBJECT_SHARE)
    return Split(designs, {int(key): held for key, held in held_objects.items()})


def _hold_out(
    known: Mapping[str, bool], class_of: Mapping[str, str], rng: np.random.Generator, share: float
) -> dict[str, bool]:
    """Return what is known with the others of `class_of`: hold out a share of all, from the class due the most."""
    held = {key: known.get(key, False) for key in class_of}
    size = Counter(class_of.values())
    taken = Counter(class_of[key] for key, is_held in held.items() if is_held)
    for _ in range(max(round(share * len(held)), 1) - sum(held.values())):
        free = [key for key in held if key not in known and not held[key]]
        if not free:
            break
        due = np.array([share * size[class_of[key]] - taken[class_of[key]] for key in free])
        chosen = free[int(rng.choice(np.flatnonzero(due >= due.max() - 1e-9)))]
        held[chosen] = True
        taken[class_of[chosen]] += 1
    return held


def _newest(lake: Lake, campaign_id: str | None, seed: int) -> Split:
    for row in reversed(lake.records(EventRow, kind=KIND, campaign_id=campaign_id or "")):
        payload = row.payload
        if payload["seed"] == seed:
            objects = {int(key): held for key, held in payload["objects"].items()}
            return Split(payload["designs"], objects)
    return Split({}, {})


def _write(lake: Lake, campaign_id: str | None, seed: int, split: Split) -> None:
    message = f"{split.words} are held out of gap discovery, {split.split_id}"
    payload = json.loads(split.json()) | {"seed": seed}
    row = EventRow.of([KIND, campaign_id, seed, split.split_id], KIND, message, payload, campaign_id)
    lake.append([row], current_provenance(seed=seed))

"""Simpler fingers that are as good as the best one of a campaign: for its cards, and as tools of a batch."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fast.models.design.reference import reference_within
from fast.models.records import Record
from fast.models.scientist.acquisition.candidates import Spacing
from fast.models.scientist.insights.simplest import Simpler, find_simpler
from fast.models.scientist.insights.worlds import Worlds
from fast.models.scientist.propose import MIN_DISTANCE, keep_allowed
from fast.models.scientist.surrogate.observations import REAL
from fast.models.scientist.surrogate.posterior import Surrogate
from fast.tasks.campaign.campaign import Campaign


class SimplerFinger(Record):
    """A simpler finger that is as good, as a design to print: parameters by name."""

    finding: Simpler
    design: Mapping[str, Any]


def find_simpler_fingers(
    campaign: Campaign, worlds: Worlds, rng: np.random.Generator, taken: np.ndarray | None = None
) -> list[SimplerFinger]:
    """Find one for each criterion by which there is one that may be printed.

    taken: points (k x d, unit cube) that it must not be near, since they are printed already; none: it may be one of
    them.
    """
    space, config = campaign.space, campaign.config
    nowhere = np.zeros((0, space.n_dims))
    spacing = Spacing(nowhere, nowhere if taken is None else taken, MIN_DISTANCE)

    def keep(points: np.ndarray) -> np.ndarray:
        allowed = keep_allowed(points, config.proposal_rules, campaign.constraint, space)
        return np.asarray(allowed[spacing.allowed(allowed)])

    best = best_measured_point(worlds.surrogate)
    found = find_simpler(worlds, space, best, rng, default=reference_within(space), keep=keep)
    designs = space.from_unit(np.array([one.point for one in found]).reshape(-1, space.n_dims))
    return [SimplerFinger(finding=one, design=design.model_dump()) for one, design in zip(found, designs, strict=True)]


def best_measured_point(surrogate: Surrogate) -> np.ndarray:
    """Return the measured finger with the largest predicted outcome, d."""
    x = surrogate.data.x[surrogate.data.s == REAL]
    return np.asarray(np.clip(x[np.argmax(surrogate.mean(x, REAL))], 0.0, 1.0))

"""The acquisition rules by name: a new rule is one function and one line here."""

from collections.abc import Callable

import numpy as np

from models.scientist.acquisition.joint_entropy import select_by_jes
from models.scientist.acquisition.mes import select_by_mes
from models.scientist.acquisition.nei import select_by_nei
from models.scientist.acquisition.spacing import Spacing
from models.scientist.acquisition.thompson import select_by_thompson
from models.scientist.surrogate.posterior import Surrogate

# (surrogate, points m x 9, fidelity, n, pending p x 10, spacing, rng) -> [(row of points, value)], best first
Selection = Callable[
    [Surrogate, np.ndarray, int, int, np.ndarray, Spacing, np.random.Generator], list[tuple[int, float]]
]

# Rules that need a surrogate; `random` needs none and lives in `models.scientist.propose`.
ACQUISITIONS: dict[str, Selection] = {
    "mes": select_by_mes,
    "nei": select_by_nei,
    "thompson": select_by_thompson,
    "jes": select_by_jes,
}

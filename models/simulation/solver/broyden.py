"""Secant corrections of a factorised tangent: Broyden's good update, limited memory, in the energy metric.

A factor of K stays in use while the tangent moves on (contact points come and go, friction couples pressure and
traction unsymmetrically, which K leaves out). Each accepted step s changes the residual by -y; the update

    H <- (I + c v^T) H,   c = (s - H y) / (v . H y),   v = K s,   H = K^-1 at first

makes the inverse tangent H send y to s (Kelley 1995, Iterative Methods for Linear and Nonlinear Equations, section
7.3). Broyden takes v = s; v = K s is the same update for unknowns scaled by K^1/2, so that stiff contact and soft
bending count by their energy. It needs no product with K: K c is known because K times a direction is.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

MEMORY = 20  # corrections kept; when they are used up, start again from the factor
SMALLEST_PIVOT = 1e-2  # |v . H y| against v . s, below which an update is left out
_COUNT, _HAS_LAST = 0, 1


class Secants(NamedTuple):
    """The corrections to the inverse of one factorised tangent K, for n unknown numbers.

    Of each correction `weights` (MEMORY, n), `changes` (MEMORY, n), and `images` (MEMORY, n), K times the changes. The
    `last` direction (n), and `last_image` (n), K times it. `marks` (2): how many corrections there are, and whether
    there is a last direction.
    """

    weights: np.ndarray
    changes: np.ndarray
    images: np.ndarray
    last: np.ndarray
    last_image: np.ndarray
    marks: np.ndarray


def make_secants(n: int) -> Secants:
    """Make secants without corrections yet, for n unknown numbers."""
    weights, changes, images = np.zeros((3, MEMORY, n))
    return Secants(weights, changes, images, np.zeros(n), np.zeros(n), np.zeros(2, dtype=np.int64))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def forget_all(secants: Secants) -> None:
    """Forget everything: there is a new factor."""
    secants.marks[:] = 0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def begin_load(secants: Secants) -> None:
    """Begin a new load: corrections still serve, but the next residual is no answer to the last step."""
    secants.marks[_HAS_LAST] = 0


@nb.njit(cache=True, nogil=True, error_model="numpy")
def correct_direction(secants: Secants, direction: np.ndarray, residual: np.ndarray, step: float) -> None:
    """Turn K^-1 r in `direction` (n) into H r, for a residual r (n).

    `step`: which multiple of the last direction was gone to arrive at this residual.
    """
    marks = secants.marks
    if marks[_COUNT] == MEMORY:
        forget_all(secants)
    image = residual.copy()
    _correct(secants, 0, marks[_COUNT], direction, image)
    if marks[_HAS_LAST] and _learn(secants, marks[_COUNT], direction, image, step):
        marks[_COUNT] += 1
        _correct(secants, marks[_COUNT] - 1, marks[_COUNT], direction, image)
    secants.last[:] = direction
    secants.last_image[:] = image
    marks[_HAS_LAST] = 1


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _learn(secants: Secants, k: int, direction: np.ndarray, image: np.ndarray, step: float) -> bool:
    """Put the correction of a step at k: s = step * last, H y = last - direction. False if it would be ill-posed."""
    last, last_image, energy, pivot = secants.last, secants.last_image, 0.0, 0.0
    for a in range(len(last)):
        energy += last_image[a] * last[a]
        pivot += last_image[a] * (last[a] - direction[a])
    if not abs(pivot) > SMALLEST_PIVOT * step * abs(energy):
        return False
    scale = 1.0 / (step * pivot)
    for a in range(len(last)):
        secants.weights[k, a] = step * last_image[a]
        secants.changes[k, a] = scale * (direction[a] - (1.0 - step) * last[a])
        secants.images[k, a] = scale * (image[a] - (1.0 - step) * last_image[a])
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _correct(secants: Secants, first: int, end: int, direction: np.ndarray, image: np.ndarray) -> None:
    """Apply the corrections first..end to a direction and its image, in place."""
    weights, changes, images = secants.weights, secants.changes, secants.images
    for k in range(first, end):
        share = 0.0
        for a in range(len(direction)):
            share += weights[k, a] * direction[a]
        for a in range(len(direction)):
            direction[a] += share * changes[k, a]
            image[a] += share * images[k, a]

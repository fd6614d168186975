"""Secant corrections of a factorised tangent: Broyden's good update, limited memory, in the energy metric.

A factor of K stays in use while the tangent moves on (contact points come and go, friction couples pressure and
traction unsymmetrically, which K leaves out). Each accepted step s changes the residual by -y; the update

    H <- (I + c v^T) H,   c = (s - H y) / (v . H y),   v = K s,   H = K^-1 at first

makes the inverse tangent H send y to s (Kelley 1995, Iterative Methods for Linear and Nonlinear Equations, section
7.3). Broyden takes v = s; v = K s is the same update for unknowns scaled by K^1/2, so that stiff contact and soft
bending count by their energy. It needs no product with K: K c is known because K times a direction is.
"""

import numba as nb
import numpy as np

MEMORY = 20  # corrections kept; when they are used up, start again from the factor
SMALLEST_PIVOT = 1e-2  # |v . H y| against v . s, below which an update is left out


class SecantMemory:
    """The corrections to the inverse of one factorised tangent K, for unknowns of `size` numbers."""

    def __init__(self, size: int) -> None:
        self._weights = np.zeros((MEMORY, size))
        self._changes = np.zeros((MEMORY, size))
        self._images = np.zeros((MEMORY, size))  # K times the changes
        self._last, self._last_image = np.zeros(size), np.zeros(size)  # the last direction and K times it
        self._count, self._has_last = 0, False

    def clear(self) -> None:
        """Forget everything: there is a new factor."""
        self._count, self._has_last = 0, False

    def begin(self) -> None:
        """A new load: corrections still serve, but the next residual is no answer to the last step."""
        self._has_last = False

    def direction(self, solved: np.ndarray, residual: np.ndarray, step: float) -> np.ndarray:
        """Corrected direction H r for a residual r, in its shape; `solved` is K^-1 r.

        `step`: which multiple of the last direction was gone to arrive at this residual.
        """
        if self._count == MEMORY:
            self.clear()
        direction, image = solved.ravel().copy(), residual.ravel().copy()
        memory = self._weights, self._changes, self._images
        _correct(*memory, 0, self._count, direction, image)
        if self._has_last and _learn(*memory, self._count, self._last, self._last_image, direction, image, step):
            self._count += 1
            _correct(*memory, self._count - 1, self._count, direction, image)
        self._last, self._last_image, self._has_last = direction, image, True
        return direction.reshape(solved.shape)


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _learn(
    weights: np.ndarray,
    changes: np.ndarray,
    images: np.ndarray,
    k: int,
    last: np.ndarray,
    last_image: np.ndarray,
    direction: np.ndarray,
    image: np.ndarray,
    step: float,
) -> bool:
    """Put the correction of a step at k: s = step * last, H y = last - direction. False if it would be ill-posed."""
    energy = pivot = 0.0
    for a in range(len(last)):
        energy += last_image[a] * last[a]
        pivot += last_image[a] * (last[a] - direction[a])
    if not abs(pivot) > SMALLEST_PIVOT * step * abs(energy):
        return False
    scale = 1.0 / (step * pivot)
    for a in range(len(last)):
        weights[k, a] = step * last_image[a]
        changes[k, a] = scale * (direction[a] - (1.0 - step) * last[a])
        images[k, a] = scale * (image[a] - (1.0 - step) * last_image[a])
    return True


@nb.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")
def _correct(
    weights: np.ndarray,
    changes: np.ndarray,
    images: np.ndarray,
    first: int,
    end: int,
    direction: np.ndarray,
    image: np.ndarray,
) -> None:
    """Apply the corrections first..end to a direction and its image, in place."""
    for k in range(first, end):
        share = 0.0
        for a in range(len(direction)):
            share += weights[k, a] * direction[a]
        for a in range(len(direction)):
            direction[a] += share * changes[k, a]
            image[a] += share * images[k, a]

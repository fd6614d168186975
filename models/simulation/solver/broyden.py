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
        self._count = 0
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # the last direction and K times it

    def clear(self) -> None:
        """Forget everything: there is a new factor."""
        self._count, self._last = 0, None

    def begin(self) -> None:
        """A new load: corrections still serve, but the next residual is no answer to the last step."""
        self._last = None

    def direction(self, solved: np.ndarray, residual: np.ndarray, step: float) -> np.ndarray:
        """Corrected direction H r for a residual r, in its shape; `solved` is K^-1 r.

        `step`: which multiple of the last direction was gone to arrive at this residual.
        """
        if self._count == MEMORY:
            self.clear()
        direction, image = solved.ravel().copy(), residual.ravel().copy()
        _correct(self._weights, self._changes, self._images, 0, self._count, direction, image)
        if self._last is not None and self._learn(*self._last, direction, image, step):
            _correct(self._weights, self._changes, self._images, self._count - 1, self._count, direction, image)
        self._last = direction, image
        return direction.reshape(solved.shape)

    def _learn(
        self, last: np.ndarray, last_image: np.ndarray, direction: np.ndarray, image: np.ndarray, step: float
    ) -> bool:
        """Add the correction of a step: s = step * last, H y = last - direction. False if it would be ill-posed."""
        energy = float(np.dot(last_image, last))
        pivot = energy - float(np.dot(last_image, direction))
        if not abs(pivot) > SMALLEST_PIVOT * step * abs(energy):
            return False
        k, scale = self._count, 1.0 / (step * pivot)
        self._weights[k] = step * last_image
        self._changes[k] = scale * (direction - (1.0 - step) * last)
        self._images[k] = scale * (image - (1.0 - step) * last_image)
        self._count += 1
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

"""The random effects of whitened cells given their residuals: tools, objects, and what all grasps share.

    r_to = F_to b_t + G_to g + H_to a_o + e_to,    e ~ N(0, 1 / weight),    b ~ N(0, tool_sd^2), g ~ N(0, 1),
    a ~ N(0, object_sd^2).

The precision of (b, g, a) is an arrow: a cell has one tool and one object, so objects meet through tools and g alone.
They are eliminated one by one, which leaves tools and g.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Cells:
    """Whitened cells at given parameters, with the effects they are under.

    residual, weight: t x o x f, measured less predicted features, and their precision (0 in cells that were not
    measured). force: t x o x f, F. shared: t x o x f x q, G. obj: t x o x f x f, H.
    """

    residual: np.ndarray
    weight: np.ndarray
    force: np.ndarray
    shared: np.ndarray
    obj: np.ndarray


@dataclass(frozen=True, eq=False)
class Effects:
    """Effects given the residuals of cells: means b (t), g (q), a (o x f), and covariances.

    head_cov: (t + q) x (t + q), of b and g. a_cov: o x f x f. cross_cov: o x f x (t + q), of a with b and g.
    log_det: of the precision of all effects times their prior covariance. explained: squares that they take up.
    """

    cells: Cells
    b: np.ndarray
    g: np.ndarray
    a: np.ndarray
    head_cov: np.ndarray
    a_cov: np.ndarray
    cross_cov: np.ndarray
    log_det: float
    explained: float

    @staticmethod
    def of(cells: Cells, tool_sd: float, object_sd: float) -> "Effects":
        """Effects given cells and the scales of tools and objects."""
        force, residual, weight, shared, obj = cells.force, cells.residual, cells.weight, cells.shared, cells.obj
        t, o, f = force.shape
        to_obj = np.swapaxes(weight[..., None] * obj, -1, -2)
        to_shared = np.swapaxes(weight[..., None] * shared, -1, -2)
        sides = np.stack([force, residual], axis=-1)
        of_obj, of_shared = to_obj @ sides, to_shared @ sides
        coupling = np.concatenate([of_obj[..., 0].transpose(1, 2, 0), (to_obj @ shared).sum(axis=0)], axis=-1)
        own = of_obj[..., 1].sum(axis=0)
        precision = (to_obj @ obj).sum(axis=0) + np.eye(f) / object_sd**2
        inverse = np.linalg.inv(precision)
        towards = inverse @ coupling
        head = _head(cells, of_shared[..., 0].sum(axis=1), (to_shared @ shared).sum(axis=(0, 1)), tool_sd)
        head = head - np.tensordot(coupling, towards, axes=([0, 1], [0, 1]))
        pull = np.concatenate([(weight * force * residual).sum(axis=(1, 2)), of_shared[..., 1].sum(axis=(0, 1))])
        head_cov = np.linalg.inv(head)
        found = head_cov @ (pull - np.tensordot(own, towards, 2))
        a = (inverse @ own[..., None])[..., 0] - towards @ found
        cross_cov = -towards @ head_cov
        log_det = np.linalg.slogdet(precision)[1].sum() + np.linalg.slogdet(head)[1]
        log_det += 2.0 * (t * np.log(tool_sd) + o * f * np.log(object_sd))
        return Effects(
            cells=cells,
            b=found[:t],
            g=found[t:],
            a=a,
            head_cov=head_cov,
            a_cov=inverse - cross_cov @ np.swapaxes(towards, 1, 2),
            cross_cov=cross_cov,
            log_det=float(log_det),
            explained=float(pull @ found + (own * a).sum()),
        )

    @property
    def left(self) -> np.ndarray:
        """What the mean effects leave of the residuals, t x o x f."""
        cells = self.cells
        taken = cells.force * self.b[:, None, None] + cells.shared @ self.g + (cells.obj @ self.a[..., None])[..., 0]
        return np.asarray(cells.residual - taken)

    @property
    def with_tool(self) -> np.ndarray:
        """Covariance of what the effects do to each feature with the effect of its tool, t x o x f."""
        t = len(self.b)
        tools = self.cells.force * np.diag(self.head_cov)[:t, None, None]
        by_shared = self.cells.shared @ self.head_cov[t:, :t].T[:, None, :, None]
        by_object = self.cells.obj @ self.cross_cov[:, :, :t].transpose(2, 0, 1)[..., None]
        return np.asarray(tools + (by_shared + by_object)[..., 0])

    @property
    def variance(self) -> np.ndarray:
        """Variance of what the effects do to each feature, t x o x f."""
        cells, t = self.cells, len(self.b)
        twice = 2.0 * self.with_tool - cells.force * np.diag(self.head_cov)[:t, None, None]
        objects = ((cells.obj @ self.a_cov) * cells.obj).sum(axis=-1)
        rest = cells.shared @ self.head_cov[t:, t:] + 2.0 * cells.obj @ self.cross_cov[:, :, t:]
        return np.asarray(cells.force * twice + objects + (rest * cells.shared).sum(axis=-1))


def _head(cells: Cells, tool_shared: np.ndarray, shared: np.ndarray, tool_sd: float) -> np.ndarray:
    """Precision of b and g while a is known, (t + q) x (t + q), from its blocks off the tools."""
    tools = np.diag((cells.weight * cells.force**2).sum(axis=(1, 2)) + 1.0 / tool_sd**2)
    return np.block([[tools, tool_shared], [tool_shared.T, shared + np.eye(len(shared))]])

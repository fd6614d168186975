"""Rows of a calibration problem that say the same twice."""

import numpy as np

from models.calibration.means.problem import CalibrationProblem


def without_repeats(problem: CalibrationProblem) -> tuple[CalibrationProblem, tuple[str, ...]]:
    """The problem with each row once, and a sentence for every kind of row left out.

    A row is left out when its design, theta, force and variance all repeat an earlier one: a deterministic simulator
    run twice, or a measurement entered twice, tells nothing new, while a second copy would be taken for proof that
    nugget and noise are zero. The same design with another force stays: that is what nugget and noise are for.
    """
    sim = np.column_stack([problem.x_sim, problem.theta_sim, problem.y_sim, problem.variance_sim])
    real = np.column_stack([problem.x_real, problem.y_real, problem.variance_real])
    first_sim, first_real = _first_rows(sim), _first_rows(real)
    sentences = []
    for what, n_all, kept in (("simulations", len(sim), first_sim), ("measured designs", len(real), first_real)):
        if len(kept) < n_all:
            repeated = int(np.setdiff1d(np.arange(n_all), kept)[0])
            sentences.append(
                f"{n_all - len(kept)} of {n_all} {what} repeat another in design and force (the first is row "
                f"{repeated}) and were left out; check whether they were entered twice."
            )
    if not sentences:
        return problem, ()
    fewer = CalibrationProblem(
        x_sim=problem.x_sim[first_sim],
        theta_sim=problem.theta_sim[first_sim],
        y_sim=problem.y_sim[first_sim],
        variance_sim=problem.variance_sim[first_sim],
        x_real=problem.x_real[first_real],
        y_real=problem.y_real[first_real],
        variance_real=problem.variance_real[first_real],
        scales_with_modulus=problem.scales_with_modulus,
    )
    return fewer, tuple(sentences)


def _first_rows(rows: np.ndarray) -> np.ndarray:
    """Numbers of the rows that repeat no earlier one, ascending."""
    _, first = np.unique(rows, axis=0, return_index=True)
    return np.sort(first)

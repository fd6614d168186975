"""WHERE: everything that is said about the place of the gap, from one set of residuals."""

from dataclasses import dataclass

import numpy as np

from models.gap.findings import WhereFinding
from models.gap.where.permutation_tests import TestTree, run_tests
from models.gap.where.residuals import Residuals
from models.gap.where.sentences import find_where
from models.gap.where.theta_by_stratum import ThetaStratum, ThetaTrend, theta_by_stratum, theta_trends
from models.gap.where.variance_shares import PhaseShares, variance_shares


@dataclass(frozen=True, eq=False)
class Where:
    """Where simulation and measurement disagree after theta was calibrated again."""

    findings: tuple[WhereFinding, ...]
    tests: TestTree
    shares: tuple[PhaseShares, ...]
    strata: tuple[ThetaStratum, ...]
    trends: tuple[ThetaTrend, ...]


def locate(residuals: Residuals, friction_slope_n: np.ndarray | None = None, seed: int = 0) -> Where:
    """Shares, tests, state-aware theta and findings of the grasps to learn from.

    friction_slope_n: n x steps, slope of the prediction by the logarithm of friction; without it only the modulus is
    refitted by stratum.
    """
    tests = run_tests(residuals, seed)
    return Where(
        findings=find_where(residuals, tests, seed),
        tests=tests,
        shares=variance_shares(residuals),
        strata=theta_by_stratum(residuals, friction_slope_n),
        trends=theta_trends(residuals, friction_slope_n),
    )

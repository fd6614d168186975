"""How simulations are chosen: with the last fit until the data have grown, the same after a restart."""

import numpy as np
import pytest

from lake.store import Lake
from lake.tables import FitRow
from models.design_space import random_unit
from models.surrogate.observations import REAL, SIM, ObservationSet
from tasks.campaign import Campaign
from tasks.proposing import REFIT_LEAST, fit, fitted_before, propose_simulation, surrogate_for_simulation

N_REAL, N_SIM = 8, 12


def grown_by(n: int, n_real: int = N_REAL) -> ObservationSet:
    rng = np.random.default_rng(4)
    x = random_unit(N_SIM + 40 + N_REAL + 4, rng)
    sim, real = np.arange(N_SIM + n), np.arange(N_SIM + 40, N_SIM + 40 + n_real)
    rows = np.concatenate([sim, real])
    y = 10 + 3 * np.sin(3 * x[rows, 0]) + x[rows, 5]
    return ObservationSet(x[rows], np.repeat([SIM, REAL], [len(sim), len(real)]), y, np.zeros(len(rows)))


def fits_of(campaign: Campaign) -> list[dict]:
    return campaign.lake.rows(FitRow, purpose="simulations")


def test_the_fit_is_kept_until_the_data_have_grown(campaign):
    _, first = surrogate_for_simulation(campaign, 2, 0, grown_by(0), list)
    same, kept = surrogate_for_simulation(campaign, 2, 1, grown_by(REFIT_LEAST - 1), list)
    assert (kept, len(fits_of(campaign))) == (first, 1)
    assert same.data.n_sim == N_SIM + REFIT_LEAST - 1  # conditioned on all there is
    _, again = surrogate_for_simulation(campaign, 2, 2, grown_by(REFIT_LEAST), list)
    assert again != first
    _, measured = surrogate_for_simulation(campaign, 2, 3, grown_by(REFIT_LEAST, N_REAL + 1), list)
    assert measured != again
    assert len(fits_of(campaign)) == 3


def test_a_restart_gives_the_same_surrogate_and_proposal(campaign):
    surrogate_for_simulation(campaign, 2, 0, grown_by(0), list)
    restarted = Campaign(Lake.open(campaign.lake.root), campaign.config)
    before, fit_id = surrogate_for_simulation(campaign, 2, 1, grown_by(2), list)
    after, again = surrogate_for_simulation(restarted, 2, 1, grown_by(2), list)
    assert (again, after.parameters) == (fit_id, before.parameters)
    points = random_unit(20, np.random.default_rng(0))
    np.testing.assert_array_equal(after.mean(points, REAL), before.mean(points, REAL))
    for owner, surrogate in ((campaign, before), (restarted, after)):
        propose_simulation(owner, 2, 1, surrogate, fit_id, owner.state())
    assert len(campaign.state().simulations_of(2)) == 1


def test_a_fit_for_tools_keeps_its_health_and_can_be_had_again(campaign):
    surrogate = fit(campaign, 2, grown_by(0), ["K1"])
    (row,) = campaign.lake.rows(FitRow, purpose="tools")
    assert row["shared_variance"] == pytest.approx(
        surrogate.parameters.rho**2
        * surrogate.parameters.sd_h**2
        / (surrogate.parameters.rho**2 * surrogate.parameters.sd_h**2 + surrogate.parameters.sd_e**2)
    )
    assert row["measured_only_loo_rmse_n"] > 0
    again = fitted_before(row, grown_by(0))
    points = random_unit(20, np.random.default_rng(0))
    np.testing.assert_allclose(again.mean(points, REAL), surrogate.mean(points, REAL))

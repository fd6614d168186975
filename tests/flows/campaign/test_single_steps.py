"""Single steps of a campaign, as far as they go without a Prefect server: what they refuse."""

import pytest

from fast.flows.campaign.single_steps import measure_one_batch, simulate_missing
from fast.lake.leases import exclusive
from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow
from fast.models.errors import FastError
from tests.flows.cli.cli_lakes import proposed_lake


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("single")
    return folder / "quick.toml", str(proposed_lake(folder))


def test_a_batch_that_nobody_confirmed_is_not_measured(place):
    config, lake = place
    with pytest.raises(FastError, match="batch quick B01 is not confirmed; say what became of it"):
        measure_one_batch(config, lake, 1)
    assert Lake.open(lake).ids(GraspRow) == set()


def test_a_campaign_that_runs_is_left_alone(place):
    config, lake = place
    with (
        exclusive(Lake.open(lake).storage, "campaign-quick", "busy"),
        pytest.raises(FastError, match="quick is being run"),
    ):
        simulate_missing(config, lake)

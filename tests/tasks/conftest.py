from pathlib import Path

import pytest

from fast.tasks.campaign.campaign import Campaign
from tests.tasks.campaign.small_campaign import small_campaign


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """A small campaign on an empty lake."""
    return small_campaign(tmp_path)

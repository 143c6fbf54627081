"""An empty campaign."""

from pathlib import Path

import pytest

from cfid.records.campaign import Campaign
from tests.lab import new_campaign


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """A campaign with a rig.toml and nothing else, in the folder where `cfid` runs."""
    return new_campaign(tmp_path)

"""A campaign with the thesis' numbers."""

from pathlib import Path

import pytest

from cfid.records.campaign import open_campaign
from tests.export.thesis_vehicle import sections
from tests.lab import keep, new_campaign


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """A campaign with the thesis' numbers, in the folder where `cfid` runs."""
    new_campaign(tmp_path)
    for name, fit in sections().items():
        keep(tmp_path, name, fit)
    open_campaign(tmp_path).write_parameters()
    return tmp_path

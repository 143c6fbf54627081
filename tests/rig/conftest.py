"""Fixtures that the tests of this package share."""

from pathlib import Path

import pytest
from twisted.internet.task import Clock

from tests.rig.virtual import Session


@pytest.fixture(autouse=True, scope="module")
def wires_in_time(in_time: None) -> None:
    """Run the wires of this package in time."""


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session(tmp_path, Clock())

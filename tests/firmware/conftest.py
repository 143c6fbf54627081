"""A fixture that the tests of this folder share: a core of the app on a stand."""

import pytest

from tests.firmware.stand import Stand, new_core


@pytest.fixture
def stand() -> Stand:
    return Stand(new_core())

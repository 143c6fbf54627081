"""What the tests of this room share: both forms of the app's core."""

from collections.abc import Callable

import pytest

from cfid.sim.app_core import AppCore
from tests.firmware.stand import CORES, Stand


@pytest.fixture(params=CORES)
def new_core(request: pytest.FixtureRequest) -> Callable[[], AppCore]:
    make: Callable[[], AppCore] = request.param
    return make


@pytest.fixture
def stand(new_core: Callable[[], AppCore]) -> Stand:
    return Stand(new_core())

"""The slowest command of a vehicle with idle thrust: half the throttle that DSHOT carries at idle, rounded up."""

import pytest

from cfid.rig.motors import Limits
from cfid.units import MOTORS


@pytest.mark.parametrize(
    ("idle_thrust", "throttle_at_idle"), [(0, 0), (7000, 171), (7008, 172), (5000, 109), (2000, 15), (1536, 1)]
)
def test_half_the_throttle_of_idle_is_the_slowest(idle_thrust: int, throttle_at_idle: int) -> None:
    slowest = Limits(idle_thrust=idle_thrust).slowest_command(MOTORS)

    if not idle_thrust:
        assert slowest == 0
    else:
        assert 2 * ((slowest >> 5) - 47) >= throttle_at_idle
        assert 2 * ((slowest - 1 >> 5) - 47) < throttle_at_idle


@pytest.mark.parametrize("idle_thrust", [32, 1000, 1535])
def test_an_idle_thrust_that_turns_nothing_allows_nothing_slower(idle_thrust: int) -> None:
    assert Limits(idle_thrust=idle_thrust).slowest_command(MOTORS) == idle_thrust + 1


def test_beside_motors_at_zero_a_command_has_to_be_above_idle() -> None:
    assert Limits(idle_thrust=7000).slowest_command((1, 3)) == 7001

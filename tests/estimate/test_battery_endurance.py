"""How long a battery lasts: currents against Bitcraze's table, and batteries that are full, low, or no single cell."""

import pytest

from cfid.estimate.battery_endurance import CELL_MAH, Held, endurance
from cfid.units import FULL_COMMAND

# Bitcraze's thrust table of 2015: PWM in percent, and the current of all four motors in amperes.
TABLE = ((12.5, 0.56), (25.0, 0.94), (37.5, 1.37), (50.0, 1.83), (62.5, 2.39), (75.0, 3.06), (93.75, 4.44))


@pytest.mark.parametrize(("percent", "amperes"), TABLE)
def test_currents_are_those_of_the_table(percent: float, amperes: float) -> None:
    found = endurance(4.2, [Held(round(percent / 100 * FULL_COMMAND), 4, 60.0)])

    assert found is not None
    assert found.lasts_s == pytest.approx(CELL_MAH * 3.6 / amperes, rel=0.05)


def test_a_low_cell_does_not_last_for_a_plan_that_a_full_one_does() -> None:
    plan = [Held(40000, 2, 300.0), Held(0, 0, 100.0)]
    full, low = endurance(4.2, plan), endurance(3.7, plan)

    assert full is not None
    assert low is not None
    assert full.takes_s == low.takes_s == 400.0
    assert full.enough
    assert not low.enough


def test_two_cells_are_no_single_one() -> None:
    assert endurance(7.9, [Held(30000, 4, 10.0)]) is None

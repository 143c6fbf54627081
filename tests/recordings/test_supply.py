"""Impossible supply voltages are found, and real ones stay, for batteries of one to twelve cells and bench supplies."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.recordings import supply

Array = npt.NDArray[np.float64]

ROWS = 4000


def battery(cells: float, *, sag: float = 0.3) -> Array:
    """Return the voltage of lithium cells that discharge under loads that change from one row to the next."""
    rng = np.random.default_rng(4)
    load = np.repeat(rng.uniform(0, 1, ROWS // 20) ** 2, 20)
    return np.asarray(cells * (np.linspace(4.3, 3.7, ROWS) - sag * 3.7 * load + rng.normal(0, 0.01, ROWS)))


@pytest.mark.parametrize("cells", [1, 4, 12])
def test_a_battery_that_gives_way_by_a_third_under_load_keeps_every_voltage(cells: int) -> None:
    assert not supply.impossible(battery(cells)).any()


@pytest.mark.parametrize(
    "volts",
    [
        np.linspace(3.0, 25.0, ROWS),
        np.repeat(np.arange(2.0, 18.0, 2.0), ROWS // 8),
        np.tile(np.repeat([12.0, 4.0], [80, 20]), ROWS // 100),
    ],
    ids=["swept", "in steps", "switched"],
)
def test_a_supply_that_is_set_to_other_voltages_keeps_them(volts: Array) -> None:
    assert not supply.impossible(volts + np.random.default_rng(4).normal(0, 0.01, len(volts))).any()


@pytest.mark.parametrize(("cells", "times"), [(1, 0.3), (6, 2.0)])
@pytest.mark.parametrize(("begin", "count"), [(0, 1), (1000, 350), (ROWS - 30, 30)])
def test_voltages_that_jump_far_off_the_others_and_back_are_impossible(
    cells: int, times: float, begin: int, count: int
) -> None:
    volts = battery(cells)
    volts[begin : begin + count] = times * 3.8 * cells
    assert np.array_equal(np.flatnonzero(supply.impossible(volts)), np.arange(begin, begin + count))


def test_voltages_that_are_noise_for_a_while_and_those_beyond_any_battery_are_impossible() -> None:
    volts = battery(3)
    volts[500:600] = np.random.default_rng(2).uniform(20.0, 59.0, 100)
    volts[2000:2003] = 0.0, 1e300, -5.0
    volts[3000:3010] = np.nan
    assert np.array_equal(np.flatnonzero(supply.impossible(volts)), [*range(500, 600), 2000, 2001, 2002])
    assert supply.usual(volts, supply.impossible(volts)) == pytest.approx(12.0, rel=0.1)
    assert not supply.impossible(np.full(3, np.nan)).any()
    assert supply.impossible(np.zeros(3)).all()

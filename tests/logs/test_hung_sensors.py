"""Three-axis sensors that hang are distinguished from sensors with coarse steps."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.records.logs.hung import without_hung

Array = npt.NDArray[np.float64]

RATE_HZ, ROWS = 500, 10000


def hovering(noise_deg_s: float) -> tuple[Array, Array]:
    """Return times (n,) and rates (n, 3) in deg/s of a vehicle that hovers but turns back and forth for 2 s."""
    rng = np.random.default_rng(6)
    time_s = np.arange(ROWS) / RATE_HZ
    turning = (time_s > 8) & (time_s < 10)
    slow = 0.4 * np.sin(0.7 * time_s[:, np.newaxis] + np.arange(3))
    turned = 200 * np.sin(2 * np.pi * time_s)[:, np.newaxis] * turning[:, np.newaxis]
    return time_s, slow + turned + rng.normal(0, noise_deg_s, (ROWS, 3))


def forces() -> tuple[Array, Array]:
    return np.arange(ROWS) / RATE_HZ, np.random.default_rng(7).normal([0, 0, 9.81], 0.1, (ROWS, 3))


def test_a_gyro_in_whole_degrees_per_second_does_not_hang_while_the_vehicle_hovers() -> None:
    """Previously, 189 of 12500 rows of a hovering vehicle's blackbox log were left out, as if the gyro hung."""
    time_s, rates = hovering(0.2)
    (_, kept), _ = without_hung({"gyro": (time_s, np.radians(np.rint(rates))), "accelerometer": forces()})[0]
    assert len(kept) == ROWS


@pytest.mark.parametrize("begin", [4150, 2000])
def test_a_gyro_of_coarse_steps_that_hangs_while_the_vehicle_turns_is_named(begin: int) -> None:
    time_s, rates = hovering(0.2)
    coarse = np.rint(rates)
    coarse[begin:4420, 0] = coarse[begin, 0]  # the vehicle turns between rows 4000 and 5000
    (_, kept), _ = without_hung({"gyro": (time_s, np.radians(coarse)), "accelerometer": forces()})[0]
    assert ROWS - len(kept) == pytest.approx(4420 - begin, abs=40)


def test_a_gyro_of_fine_steps_that_hangs_to_the_end_is_named() -> None:
    time_s, rates = hovering(0.2)
    fine = np.rint(rates / 0.06) * 0.06
    fine[9000:, 1] = fine[9000, 1]
    found, notes = without_hung({"gyro": (time_s, np.radians(fine)), "accelerometer": forces()})
    assert len(found[0][0]) == 9000
    assert "gyro: 1000 rows of 10000 left out in which it repeats one value" in notes[0]

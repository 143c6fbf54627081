"""Clocks compared by stamps that arrive late: lines under the stamps, counters that wrap."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.latency.clocks import COUNTER_S, clock_line, sessions, unwrapped_s

Array = npt.NDArray[np.float64]

UNIX_S = 1.75e9
JITTER_S = 0.016


def stamps(count: int, rng: np.random.Generator, *, rate: float = 85 / 84) -> tuple[Array, Array]:
    """Return times of a vehicle's clock, and of their arrival at the host at least 12 ms later."""
    device_s = np.sort(rng.uniform(0, 100, count))
    return device_s, UNIX_S + rate * device_s + 0.012 + rng.exponential(JITTER_S, count)


def test_the_line_under_the_stamps_is_right_to_microseconds_where_an_average_is_milliseconds_late() -> None:
    line = clock_line(*stamps(3000, np.random.default_rng(1)))
    earliest_s = UNIX_S + 85 / 84 * line.middle_device_s + 0.012

    assert line.middle_host_s == pytest.approx(earliest_s, abs=3e-5)
    assert line.skew == pytest.approx(-1 / 85, abs=2e-6)
    assert line.mean_offset_s == pytest.approx(JITTER_S, rel=0.05)
    assert line.lateness_s.mean() == pytest.approx(JITTER_S, rel=0.05)
    assert line.offset_s == pytest.approx(UNIX_S + 0.012, abs=1e-4)


@pytest.mark.parametrize("count", [8, 40, 400])
def test_the_line_is_without_bias_and_scatters_as_stated(count: int) -> None:
    rng = np.random.default_rng(count)
    offsets, rates = [], []
    for _ in range(400):
        line = clock_line(*stamps(count, rng))
        error = line.middle_host_s - (UNIX_S + 85 / 84 * line.middle_device_s + 0.012)
        offsets.append(error / line.offset_std_s)
        rates.append((line.rate - 85 / 84) / line.rate_std)

    assert abs(np.mean(offsets)) < 0.2
    assert 0.8 < np.std(offsets) < 1.35
    assert 0.75 < np.std(rates) < 1.35


def test_a_counter_of_32_bits_continues_where_it_wraps() -> None:
    host_s = UNIX_S + np.arange(0, 20000, 50.0)
    device_s = (np.arange(0, 20000, 50.0) + 4000) * 84 / 85
    late_s = np.random.default_rng(3).exponential(JITTER_S, len(host_s))

    assert unwrapped_s(device_s % COUNTER_S, host_s + late_s) == pytest.approx(device_s)


def test_a_vehicle_that_was_restarted_has_another_clock() -> None:
    host_s = [0.0, 11.0, 22.0, 4000.0, 4011.0]
    whole_s = [84 / 85 * passed_s + 1000.0 for passed_s in host_s]

    assert sessions([own_s % COUNTER_S for own_s in whole_s], host_s) == [0, 0, 0, 0, 0]
    assert sessions([*whole_s[:3], 7.0, 7.0 + 84 / 85 * 11], host_s) == [0, 0, 0, 1, 1]

"""From a thrust to its intervals, onsets and steady segments."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.estimate.signals import Slow, find_spikes
from cfid.estimate.staircase import Stretch, changes_seen, commanded_intervals, onsets, prepared, steady_stretch

Array = npt.NDArray[np.float64]

TIME_S = np.arange(0, 12, 0.01)
STILL = [0, 0, 0, 0]


def noise(seed: int = 1) -> Array:
    """Return white noise after smoothing to 20 Hz, with a standard deviation of one."""
    white = np.random.default_rng(seed).standard_normal(len(TIME_S) + 4)
    return np.convolve(white, np.ones(5) / np.sqrt(5), mode="valid")


def response(begin_s: float, *, lag_s: float) -> Array:
    """Return the thrust of rotors that start from standstill, as a share of its final value."""
    gone = -np.expm1(-np.maximum(TIME_S - begin_s, 0) / lag_s)
    return np.asarray(gone**2)


def begins(slow: Slow) -> list[float]:
    return [interval.begin_s for interval in changes_seen(slow)[1:]]


def test_repeated_commands_are_one_interval_and_the_motors_stand_before_the_first() -> None:
    times = np.array([2.0, 2.5, 3.0, 7.0])
    log = np.array([[5000, 0, 5000, 0], [5000, 0, 5000, 0], [9000, 0, 0, 0], STILL], float)

    found = commanded_intervals(times, log, begin_s=0.0, end_s=10.0)
    assert [(each.begin_s, each.end_s, each.pause) for each in found] == [
        (0.0, 2.0, True),
        (2.0, 3.0, False),
        (3.0, 7.0, False),
        (7.0, 10.0, True),
    ]
    assert found[1].commands == (5000, 0, 5000, 0)


@pytest.mark.parametrize(
    ("times", "log", "expected"),
    [
        ([1.0, 2.0], [STILL], "as many rows of four"),
        ([2.0, 1.0], [STILL, STILL], "do not rise"),
        ([1.0, 2.0], [STILL, [0, 0, -1, 0]], "below zero"),
        ([1.0, 2.0], [STILL, [0, 0, np.nan, 0]], "no numbers"),
    ],
)
def test_a_log_that_is_none_is_refused(times: list[float], log: list[list[float]], expected: str) -> None:
    with pytest.raises(DataError, match=expected):
        commanded_intervals(np.array(times), np.array(log, float), begin_s=0.0, end_s=5.0)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 300.0])
def test_steps_are_seen_whatever_the_unit_and_the_bias(scale: float) -> None:
    steps = response(3, lag_s=0.06) + response(6, lag_s=0.06) - 2 * response(9, lag_s=0.06)

    assert begins(Slow(TIME_S, scale * (steps + 0.02 * noise() - 40))) == pytest.approx([3.1, 6.1, 9.1], abs=0.08)


def test_a_record_ends_at_rest_though_the_load_cell_drifted() -> None:
    step = response(3, lag_s=0.06) - response(9, lag_s=0.06)

    found = changes_seen(Slow(TIME_S, step + 0.006 * TIME_S))
    assert [each.pause for each in found] == [True, False, True]


@pytest.mark.parametrize(
    "slow_change",
    [
        lambda: 0.03 * noise(),
        lambda: 0.1 * TIME_S + 0.02 * noise(),
        lambda: np.sin(TIME_S / 4) + 0.01 * noise(),
    ],
)
def test_noise_ramps_and_slow_waves_are_no_changes(slow_change: Callable[[], Array]) -> None:
    assert begins(Slow(TIME_S, slow_change())) == []


@pytest.mark.parametrize("lag_s", [0.03, 0.06, 0.2])
@pytest.mark.parametrize("commanded", [True, False])
def test_onset_and_lag_are_found(lag_s: float, commanded: bool) -> None:
    slow = Slow(TIME_S, 1.4 + 0.3 * response(4.03, lag_s=lag_s) + 0.004 * noise())
    log = np.array([STILL, [30000, 0, 30000, 0]], float)
    logged = commanded_intervals(np.array([0.0, 4.0]), log, begin_s=0.0, end_s=12.0)

    (found,) = onsets(slow, logged if commanded else changes_seen(slow), baseline=1.4)
    assert found.time_s == pytest.approx(4.03, abs=0.01 + 0.1 * lag_s)
    assert found.lag_s == pytest.approx(lag_s, rel=0.15)


def test_a_step_in_the_noise_takes_delay_and_lag_of_the_others() -> None:
    steps = response(2.1, lag_s=0.08) + response(4.1, lag_s=0.08) + 0.01 * response(6.1, lag_s=0.5)
    log = np.array([STILL, [5000] * 4, [9000] * 4, [9100] * 4], float)
    logged = commanded_intervals(np.array([0.0, 2.0, 4.0, 6.0]), log, begin_s=0.0, end_s=12.0)

    first, second, weak = onsets(Slow(TIME_S, steps + 0.02 * noise()), logged, baseline=0.0)
    assert weak.time_s - 6.0 == pytest.approx((first.time_s - 2.0 + second.time_s - 4.0) / 2)
    assert weak.lag_s == pytest.approx((first.lag_s + second.lag_s) / 2)


def steady(value: Array, *, drift: float = 0.05, wave: float = 0.005, hold_s: float = 0.01) -> Stretch:
    return steady_stretch(Slow(TIME_S, value), (2.0, 10.0), drift=drift, wave=wave, hold_s=hold_s)


def test_the_unsteady_beginning_of_a_window_is_cut_off() -> None:
    found = steady(1 - np.exp(-(TIME_S - 2) / 0.8) + 0.001 * noise())

    assert found.reason == ""
    assert 4.0 <= found.begin_s <= 6.5
    assert found.end_s == 10.0


def test_a_wave_about_a_line_is_not_steady_but_noise_as_large_is() -> None:
    wave = 0.02 * np.sin(2 * np.pi * TIME_S / 3)

    assert "about a line" in steady(1 + wave).reason
    assert steady(1 + 0.05 * noise()).reason == ""


def test_spikes_of_a_record_of_hours_are_those_of_the_whole() -> None:
    """A million samples at 100 Hz and more are searched in parts; some spikes lie at the seams between parts."""
    draw = np.random.default_rng(8)
    count, seam = 2_300_000, -(-(1 << 20) // 64) * 64
    value = draw.normal(0, 0.1, count)
    at = np.unique([*draw.integers(3, count - 3, 200), *(seam + np.array([-65, -2, 0, 63]))])
    value[at] += 5
    found = prepared(np.arange(count) / 100, value[:, np.newaxis], status=None, thrust=0)
    _, place, instead = find_spikes(value[np.newaxis], length=64)
    value[place] = instead

    assert found.spikes == len(place)
    assert set(at) <= set(place.tolist())
    np.testing.assert_allclose(found.value[0], value, rtol=0, atol=1e-12)

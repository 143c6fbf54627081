"""Samples of a busy computer are placed by the stamps of the device that took them."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.records.tables.stamps import StampedTimes, stamped_times

Array = npt.NDArray[np.float64]

SKEW = 40e-6


def busy(rng: np.random.Generator, *, seconds: float = 4.0) -> tuple[Array, Array, Array]:
    """Return when samples were taken, when they arrived, and the device's stamps of a crystal that is too fast.

    A poll waits for its answer, and this computer turns to other programs for up to 16 ms.
    """
    taken, arrived, now = [], [], 1.7e9
    while now < 1.7e9 + seconds:
        stalled = rng.exponential(4e-3) if rng.random() < 0.1 else 0.0
        taken.append(now)
        arrived.append(now + rng.gamma(3.0, 15e-6) + min(stalled, 16e-3))
        now = max(now + 1e-3, arrived[-1])
    return np.array(taken), np.array(arrived), np.floor((np.array(taken) - 1.7e9) * (1 + SKEW) * 1e6) + 3.3e6


def placed(arrival_s: Array, stamp_us: Array) -> StampedTimes:
    found = stamped_times(arrival_s, stamp_us)
    assert found is not None
    return found


def test_stalls_of_16_ms_leave_intervals_true_within_their_stated_scale() -> None:
    scores = []
    for seed in range(40):
        taken, arrived, stamps = busy(np.random.default_rng(seed))
        found = placed(arrived, stamps)
        off_s = (found.time_s - taken) - (found.time_s - taken).mean()
        scale = float(np.polyfit(taken - taken[0], off_s, 1)[0])
        scores.append(abs(scale) / found.scale_std)

        assert np.ptp(arrived - taken) > 10e-3
        assert np.ptp(off_s) < 1e-4
    assert max(scores) < 1.96
    assert found.scale_std < 3e-5


def test_the_scale_is_as_uncertain_as_the_median_arrival_is_late() -> None:
    taken_s: Array = 0.01 * np.arange(401.0)
    late_s = np.where(np.arange(401) % 4, 1e-3, 0.0)
    found = placed(taken_s + late_s, 1e6 * taken_s)

    assert found.scale_std == pytest.approx(1e-3 / 4.0, rel=1e-3)


@pytest.mark.parametrize(("jump_us", "used"), [(1000, True), (3000, False)])
def test_a_device_clock_that_jumps_is_not_used(jump_us: float, used: bool) -> None:
    taken_s: Array = 0.005 * np.arange(2400.0)
    stamps = 1e6 * taken_s + np.where(taken_s > 6, jump_us, 0)

    assert (stamped_times(taken_s, stamps) is not None) == used


def test_stamps_are_not_used_that_count_something_else_or_start_anew() -> None:
    _, arrived, stamps = busy(np.random.default_rng(1))
    anew = stamps - np.where(np.arange(len(stamps)) > len(stamps) // 2, stamps[len(stamps) // 2], 0)

    assert stamped_times(arrived, stamps) is not None
    assert stamped_times(arrived, np.floor(stamps / 1000)) is None  # milliseconds
    assert stamped_times(arrived, anew) is None
    assert stamped_times(arrived, np.full_like(stamps, 7.0)) is None
    assert stamped_times(arrived[:20], stamps[:20]) is None

"""Times of samples that a device counts, from arrivals that are sometimes late; and the host's own clock."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.rig.clock import SampleClock
from cfid.rig.hardware import Real
from cfid.rig.instrument import Silence
from cfid.rig.loadcell import _ticks_per_s as ticks_per_s_of

Array = npt.NDArray[np.float64]

HZ = 7000
BLOCK = 350  # samples in 50 ms
DATAGRAM = 70
SMALLEST_DELAY_S = 2e-4
BEGAN_S = 123_456.7  # on a monotonic clock
NO_ARRIVAL: Any = {"arrived": np.empty(0, np.intp), "arrival_s": np.empty(0)}


class Stream:
    """Samples of a device that runs `ppm` fast; now and then datagrams wait 50 ms, as those of the start.

    `ticks` (n,) are its counts, `true_s` (n,) their instants; each datagram arrives at one of `arrival_s`.
    """

    def __init__(
        self, *, blocks: int = 200, ppm: float = 0, jitter_s: float = 1e-3, first_tick: int = 1000, waits_s: float = 0
    ) -> None:
        rng, index = np.random.default_rng(1), np.arange(blocks * BLOCK)
        self.true_s = BEGAN_S + index / HZ / (1 + 1e-6 * ppm)
        self.ticks = ((first_tick + index) % (1 << 32)).astype(np.uint32)
        sent_s = self.true_s[DATAGRAM - 1 :: DATAGRAM]
        arrival_s = sent_s + SMALLEST_DELAY_S + rng.exponential(jitter_s, len(sent_s))
        for begin_s in rng.uniform(BEGAN_S + 1, self.true_s[-1], blocks // 60):
            arrival_s[(arrival_s > begin_s) & (arrival_s < begin_s + 0.05)] = begin_s + 0.05
        self.arrival_s = np.maximum.accumulate(np.maximum(arrival_s, BEGAN_S + waits_s))

    def timed(self, clock: SampleClock) -> Array:
        """Pass all blocks in turn to a clock; return the instants that it finds."""
        ends = np.arange(DATAGRAM - 1, BLOCK, DATAGRAM)
        blocks = zip(self.ticks.reshape(-1, BLOCK), self.arrival_s.reshape(-1, len(ends)), strict=True)
        return np.concatenate(
            [
                clock.instants_s(ticks, arrived=ends, arrival_s=came_s, read_s=float(came_s[-1]))
                for ticks, came_s in blocks
            ]
        )

    def error_s(self, found_s: Array) -> Array:
        """Return how late the found instants are, beyond the smallest delay, which cannot be known."""
        return found_s - self.true_s - SMALLEST_DELAY_S


@pytest.fixture
def clock() -> SampleClock:
    return SampleClock(ticks_per_s=HZ)


def check_regular(found_s: Array) -> None:
    """Check that the steps are regular to a tenth of a microsecond, where 100 would be allowed."""
    steps_s = np.diff(found_s)
    assert steps_s.min() > 0
    assert np.abs(steps_s - 1 / HZ).max() < 1e-7


@pytest.mark.parametrize(("ppm", "jitter_s"), [(-200, 5e-4), (0, 3e-3), (200, 1e-3)])
def test_minutes_of_jitter_and_stalls_and_the_wrap_are_evenly_timed_and_do_not_drift(
    clock: SampleClock, ppm: float, jitter_s: float
) -> None:
    device = Stream(blocks=2400, ppm=ppm, jitter_s=jitter_s, first_tick=2**32 - 100_000)
    found_s = device.timed(clock)
    error_s = device.error_s(found_s)

    check_regular(found_s)
    assert np.abs(error_s[20 * HZ :]).max() < 5e-4
    assert np.ptp(error_s.reshape(4, -1)[1:].mean(axis=1)) < 5e-5


@pytest.mark.parametrize("ppm", [-200, 200])
def test_a_start_that_stalled_is_healed_without_a_leap(clock: SampleClock, ppm: float) -> None:
    device = Stream(blocks=4000, ppm=ppm, waits_s=0.1)
    found_s = device.timed(clock)
    error_s = device.error_s(found_s)

    check_regular(found_s)
    assert error_s[0] > 0.02  # the last datagram of the first block waited that long
    assert np.abs(error_s[-10 * HZ :]).max() < 5e-4


def test_samples_without_an_arrival_continue_the_count_and_are_expected_when_it_says(clock: SampleClock) -> None:
    device = Stream(first_tick=2**32 - 10_000)
    found_s = device.timed(clock)
    last = int(device.ticks[-1])
    assert clock.predicted_s(last) == pytest.approx(found_s[-1], abs=1e-6)
    assert clock.predicted_s(last + 70_000) == pytest.approx(found_s[-1] + 10, abs=1e-6)
    later = clock.instants_s(device.ticks[-1] + np.arange(1, 11, dtype=np.uint32), **NO_ARRIVAL, read_s=found_s[-1] + 3)

    check_regular(np.concatenate([found_s, later]))


@pytest.mark.parametrize("rounding", [math.floor, round, math.ceil])
def test_every_rate_of_a_net_ft_is_7000_by_a_number_however_it_is_rounded(rounding: Callable[[float], int]) -> None:
    assert {ticks_per_s_of(rounding(7000 / step), step) for step in range(1, 7001)} == {7000}


def test_the_hosts_clock_is_the_wall_clock_when_it_was_tied_and_runs_with_the_monotonic_one() -> None:
    computer = Real()
    before, monotonic, after = time.time(), time.monotonic(), time.time()
    begin, later = computer.unix_times_s(np.array([monotonic, monotonic + 3600]))

    assert before - 1e-3 < begin < after + 1e-3
    assert later - begin == pytest.approx(3600, abs=1e-6)


class Computer(Real):
    """A computer whose clock the test sets."""

    now_s = 1000.0

    def seconds(self) -> float:
        return self.now_s


def test_a_silence_leaves_out_the_time_in_which_the_program_stood_still_and_a_gap_states_it() -> None:
    computer = Computer()
    silence = Silence(computer, period_s=0.01)

    def go_on(seconds: float, step_s: float = 0.05) -> None:
        for _ in range(round(seconds / step_s)):
            computer.now_s += step_s
            computer.awake_s()

    go_on(1.0)
    assert silence.seconds == pytest.approx(1.0)
    go_on(3.0, step_s=3.0)
    assert silence.seconds == pytest.approx(1.2)  # a stall of 0.2 s is usual
    assert silence.exceeds(1.0)
    assert not silence.exceeds(1.5)
    assert silence.end("nothing came")
    assert not silence.end("nothing came")
    (gap,) = silence.gaps
    assert float(gap["to_s"]) - float(gap["from_s"]) == pytest.approx(4.0)
    assert gap["stood_s"] == pytest.approx(2.8)

"""Times of samples that a device counts, from arrivals that are sometimes late; and the host's own clock."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.rig.clock import HostClock, SampleClock
from cfid.rig.hardware import Real
from cfid.rig.instrument import Silence
from cfid.rig.loadcell import _ticks_per_s as ticks_per_s_of

Array = npt.NDArray[np.float64]

HZ = 7000
BLOCK = 350  # samples in 50 ms
DATAGRAM = 70
SMALLEST_DELAY_S = 2e-4
BEGAN_S = 123_456.7  # on a monotonic clock
TWO_MINUTES = 2400  # blocks
NO_ARRIVAL: Any = {"arrived": np.empty(0, np.intp), "arrival_s": np.empty(0)}


@dataclass(frozen=True, kw_only=True)
class Stream:
    """The samples of a device: counts (n,), instants (n,), and the arrival of every datagram."""

    ticks: npt.NDArray[np.uint32]
    true_s: Array
    arrival_s: Array

    def timed(self, clock: SampleClock) -> Array:
        """Pass all blocks in turn to a clock; return the instants that it finds."""
        ends = np.arange(DATAGRAM - 1, BLOCK, DATAGRAM)
        arrivals = self.arrival_s.reshape(-1, len(ends))
        blocks = self.ticks.reshape(-1, BLOCK)
        found = [
            clock.instants_s(ticks, arrived=ends, arrival_s=arrival, read_s=float(arrival[-1]))
            for ticks, arrival in zip(blocks, arrivals, strict=True)
        ]
        return np.concatenate(found)

    def error_s(self, found_s: Array) -> Array:
        """Return how late the found instants are, beyond the smallest delay, which cannot be known."""
        return found_s - self.true_s - SMALLEST_DELAY_S


def stream(
    *, blocks: int, ppm: float, jitter: str, first_tick: int = 1000, late_start_s: float = 0.0, seed: int = 1
) -> Stream:
    """Return the samples of a device that runs `ppm` fast; every few seconds, its datagrams stall for 50 ms."""
    rng = np.random.default_rng(seed)
    index = np.arange(blocks * BLOCK)
    true_s = BEGAN_S + index / HZ / (1 + 1e-6 * ppm)
    sent_s = true_s[DATAGRAM - 1 :: DATAGRAM]
    delay_s = {"exponential": rng.exponential(5e-4, len(sent_s)), "uniform": rng.uniform(0, 3e-3, len(sent_s))}[jitter]
    arrival_s = sent_s + SMALLEST_DELAY_S + delay_s
    for begin_s in rng.uniform(BEGAN_S + 1, true_s[-1], blocks // 60):
        stalled = (arrival_s > begin_s) & (arrival_s < begin_s + 0.05)
        arrival_s[stalled] = begin_s + 0.05
    arrival_s[arrival_s < BEGAN_S + late_start_s] = BEGAN_S + late_start_s
    ticks = ((first_tick + index) % (1 << 32)).astype(np.uint32)
    return Stream(ticks=ticks, true_s=true_s, arrival_s=np.maximum.accumulate(arrival_s))


def check_regular(found_s: Array) -> None:
    """Check that the steps are regular to a tenth of a microsecond, where 100 would be allowed."""
    steps_s = np.diff(found_s)
    assert steps_s.min() > 0
    assert np.abs(steps_s - 1 / HZ).max() < 1e-7


@pytest.mark.parametrize(("ppm", "jitter"), [(-200, "exponential"), (0, "uniform"), (200, "uniform")])
def test_minutes_of_jitter_and_stalls_are_evenly_timed_and_do_not_drift(ppm: float, jitter: str) -> None:
    device = stream(blocks=TWO_MINUTES, ppm=ppm, jitter=jitter, first_tick=2**32 - 100_000)

    found_s = device.timed(SampleClock(ticks_per_s=HZ))
    error_s = device.error_s(found_s)
    parts = error_s[: len(error_s) // 4 * 4].reshape(4, -1)

    check_regular(found_s)
    assert np.abs(error_s[20 * HZ :]).max() < 5e-4
    assert np.ptp(parts[1:].mean(axis=1)) < 5e-5


def test_the_counts_wrap_changes_no_time() -> None:
    one = stream(blocks=400, ppm=50, jitter="exponential")
    wraps = stream(blocks=400, ppm=50, jitter="exponential", first_tick=2**32 - 70_003)

    assert wraps.ticks.min() == 0
    found_s = wraps.timed(SampleClock(ticks_per_s=HZ))
    assert found_s == pytest.approx(one.timed(SampleClock(ticks_per_s=HZ)), abs=1e-8)


@pytest.mark.parametrize("ppm", [-200, 200])
def test_a_start_that_stalled_is_healed_without_a_leap(ppm: float) -> None:
    device = stream(blocks=4000, ppm=ppm, jitter="exponential", late_start_s=0.1)

    found_s = device.timed(SampleClock(ticks_per_s=HZ))
    error_s = device.error_s(found_s)

    check_regular(found_s)
    assert error_s[0] > 0.02  # the last datagram of the first block waited that long
    assert np.abs(error_s[-10 * HZ :]).max() < 5e-4


def test_a_device_that_counts_anew_is_timed_anew() -> None:
    clock = SampleClock(ticks_per_s=HZ)
    before = stream(blocks=200, ppm=0, jitter="exponential", first_tick=3_000_000)
    after = stream(blocks=200, ppm=0, jitter="exponential", first_tick=0, seed=2)

    before.timed(clock)
    clock.restart()

    assert np.abs(after.error_s(after.timed(clock))).max() < 2e-3


def test_samples_without_an_arrival_continue_the_count() -> None:
    clock = SampleClock(ticks_per_s=HZ)
    device = stream(blocks=200, ppm=0, jitter="exponential")
    found_s = device.timed(clock)

    on = clock.instants_s(device.ticks[-1] + np.arange(1, 11, dtype=np.uint32), **NO_ARRIVAL, read_s=found_s[-1] + 3)

    check_regular(np.concatenate([found_s, on]))


def test_samples_before_any_arrival_are_timed_by_when_they_were_read() -> None:
    """The box' count alone gives its own uptime, which is no time on this computer's clock."""
    clock = SampleClock(ticks_per_s=HZ)
    device = stream(blocks=200, ppm=0, jitter="exponential")

    first_s = clock.instants_s(device.ticks[:BLOCK], **NO_ARRIVAL, read_s=BEGAN_S + 0.06)
    clock.restart()
    again_s = clock.instants_s(device.ticks[:BLOCK], **NO_ARRIVAL, read_s=BEGAN_S + 9.06)

    assert first_s[-1] == pytest.approx(BEGAN_S + 0.06)
    assert again_s[-1] == pytest.approx(BEGAN_S + 9.06)
    check_regular(first_s)
    assert np.abs(device.error_s(device.timed(clock))).max() < 2e-3  # the first arrival counts as usual


def test_a_sample_is_expected_when_its_count_says() -> None:
    clock = SampleClock(ticks_per_s=HZ)
    device = stream(blocks=200, ppm=0, jitter="exponential", first_tick=2**32 - 10_000)
    found_s = device.timed(clock)

    assert clock.predicted_s(int(device.ticks[-1])) == pytest.approx(found_s[-1], abs=1e-6)
    assert clock.predicted_s(int(device.ticks[-1]) + 70_000) == pytest.approx(found_s[-1] + 10, abs=1e-6)


@pytest.mark.parametrize("rounding", [math.floor, round, math.ceil])
def test_every_rate_of_a_net_ft_is_7000_by_a_number_however_it_is_rounded(rounding: Callable[[float], int]) -> None:
    for step in range(1, 7001):
        assert ticks_per_s_of(rounding(7000 / step), step) == 7000


@pytest.mark.parametrize(("rate_hz", "step"), [(7912, 1), (3956, 2), (989, 8), (6000, 1), (500, 10)])
def test_a_box_that_counts_otherwise_is_believed(rate_hz: int, step: int) -> None:
    assert ticks_per_s_of(rate_hz, step) == rate_hz * step


def test_the_hosts_clock_is_the_wall_clock_when_it_was_tied_and_runs_with_the_monotonic_one() -> None:
    clock = HostClock.now()
    before, monotonic, after = time.time(), time.monotonic(), time.time()
    begin, later = clock.unix_s(np.array([monotonic, monotonic + 3600]))

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


def test_a_pause_of_a_few_periods_is_no_gap() -> None:
    computer = Computer()
    silence = Silence(computer, period_s=2.0)
    computer.now_s += 7.0

    assert not silence.end("nothing came")
    assert silence.gaps == []

"""The app's sine is eq. 3.6, u[n] = A cos(2 pi l n/N) + 30000, cut to an integer; its crossings are those of C.2.4."""

import subprocess
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire import app
from tests.firmware.compiling import program
from tests.firmware.stand import Stand, new_core

N = 8000  # as in the thesis (3.4.2)
Integers = npt.NDArray[np.int64]


def eq_3_6(amplitude: int, periods: int, samples: int) -> npt.NDArray[np.float64]:
    """Return u[n] before it is cut; whole turns are removed, since thousands of them would add an error of 1e-7."""
    return amplitude * np.cos(2 * np.pi * (periods * np.arange(samples) % samples) / samples) + 30000


def cut(u: npt.NDArray[np.float64]) -> Integers:
    """Return samples, cut but not clipped; a value that is whole except for rounding counts as whole."""
    whole = np.rint(u)
    return np.where(np.abs(u - whole) < 1e-7, whole, np.trunc(u)).astype(np.int64)


def commands_of(amplitude: int, periods: int, samples: int) -> Integers:
    return np.clip(cut(eq_3_6(amplitude, periods, samples)), 0, 65535)


def crossings_of(commands: Integers) -> list[tuple[int, int]]:
    """Return index and value of what C.2.4 reports: the first sample, and each that leaves its side of the middle."""
    side = np.sign(commands - 30000)
    crosses = (side[:-1] != 0) & (side[1:] != side[:-1])
    return [(int(n), int(commands[n])) for n in (0, *(np.flatnonzero(crosses) + 1))]


def played(stand: Stand, amplitude: int, periods: int, samples: int, motor: int = 1) -> Integers:
    """Play a whole sine and return the motor's commands, one per sample."""
    stand.keep_alive()
    answer = stand.sine(motor, amplitude, app.omega_of(periods, samples), samples)
    assert (answer.verdict, answer.periods) == (app.AppVerdict.ACCEPTED, periods)
    return np.array(stand.run(2 * samples))[::2, max(motor - 1, 0)]


def test_every_l_of_8000_samples_is_within_a_unit_of_eq_3_6(tmp_path: Path) -> None:
    amplitude, made = 30000, program("play_all.c", tmp_path, "-O2")
    done = subprocess.run([made, str(amplitude), str(N)], capture_output=True, check=True)
    commands = np.frombuffer(done.stdout, np.uint16).reshape(N // 2 + 1, N)
    turn = commands_of(amplitude, 1, N)
    for periods, sine in enumerate(commands):  # exact, since no rounding of eq. 3.6 is involved
        assert np.array_equal(sine, turn[periods * np.arange(N) % N])
    for periods, sine in enumerate(commands):
        u = amplitude * np.cos(2 * np.pi * periods / N * np.arange(N)) + 30000
        assert np.abs(sine - np.trunc(u)).max() <= 1


@pytest.mark.parametrize("periods", [0, 1, 12, 1000, 1333, 2000, 3999, 4000])
def test_the_sine_is_eq_3_6_in_both_forms_of_the_core(stand: Stand, periods: int) -> None:
    assert np.array_equal(played(stand, 20000, periods, N), commands_of(20000, periods, N))


@given(samples=st.integers(1, 2**32 - 1), data=st.data())
def test_every_whole_number_of_periods_survives_the_packets_float(samples: int, data: st.DataObject) -> None:
    periods = data.draw(st.integers(0, min(samples // 2, 2**22)))
    stand = Stand(new_core())
    stand.keep_alive()
    answer = stand.sine(1, 100, app.omega_of(periods, samples), samples)
    assert (answer.verdict, answer.periods) == (app.AppVerdict.ACCEPTED, periods)


@pytest.mark.parametrize("motor", [0, 1, 4])
@pytest.mark.parametrize(("amplitude", "periods"), [(20000, 0), (20000, 12), (30000, 13), (3, 7), (0, 5), (65535, 3)])
def test_crossings_are_those_of_eq_3_6(stand: Stand, motor: int, amplitude: int, periods: int) -> None:
    samples = 1000
    commands = commands_of(amplitude, periods, samples)
    assert np.array_equal(played(stand, amplitude, periods, samples, motor), commands)
    stand.run(1)
    *reports, end = stand.crossings()
    assert [(report.sample, report.command) for report in reports] == crossings_of(commands)
    assert (end.sample, end.command) == (samples, 0)
    assert [report.number for report in (*reports, end)] == list(range(len(reports) + 1))


@pytest.mark.parametrize(
    ("amplitude", "periods", "samples", "clips"),
    [
        (30000, 12, 8000, False),
        (30001, 12, 8000, True),
        (30001, 0, 8000, False),  # constant at its largest value
        (35535, 0, 8000, False),
        (35536, 0, 8000, True),
        (30001, 1, 3, False),  # none of its three samples reaches the smallest value
        (35535, 1, 3, False),
        (35536, 1, 3, True),
        (30001, 4, 8, True),
        (65535, 12, 8000, True),
    ],
)
def test_a_sine_that_is_clipped_anywhere_says_so_and_how_often(
    stand: Stand, amplitude: int, periods: int, samples: int, clips: bool
) -> None:
    stand.keep_alive()
    assert stand.sine(1, amplitude, app.omega_of(periods, samples), samples).clips is clips
    stand.run(2 * samples + 1001)
    u = cut(eq_3_6(amplitude, periods, samples))
    [(_, done)] = stand.done()
    assert done.clipped == np.count_nonzero((u < 0) | (u > 65535))
    assert bool(done.clipped) is clips

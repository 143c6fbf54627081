"""Samples that reach a busy computer late get their times from the stamps of the device that took them."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.recordings.angle import AngleRecord, angle_record
from cfid.recordings.stamps import stamped_times
from cfid.records.rig_file import STAMP
from tests.lab import codes, made_run

Array = npt.NDArray[np.float64]

SKEW = 40e-6


def busy(rng: np.random.Generator, *, seconds: float = 4.0) -> tuple[Array, Array, Array]:
    """Return the times of samples, the times of their arrivals, and the stamps of a device whose crystal is too fast.

    A poll waits for its answer, and the computer runs other programs for up to 16 ms.
    """
    taken, arrived, now = [], [], 1.7e9
    while now < 1.7e9 + seconds:
        stalled = rng.exponential(4e-3) if rng.random() < 0.1 else 0.0
        taken.append(now)
        arrived.append(now + rng.gamma(3.0, 15e-6) + min(stalled, 16e-3))
        now = max(now + 1e-3, arrived[-1])
    return np.array(taken), np.array(arrived), np.floor((np.array(taken) - 1.7e9) * (1 + SKEW) * 1e6) + 3.3e6


def recorded(folder: Path, taken_s: Array, arrived_s: Array, sent_us: npt.NDArray[np.int64]) -> AngleRecord:
    """Return the record that is read from a run in which a pendulum's angles arrived with a device's stamps."""
    angle = np.round(40 * np.exp(-taken_s / 20) * np.cos(14 * taken_s) * 4096 / 360).astype(int) + 2000
    columns = {"encoder": {"t": arrived_s, "phi": angle, STAMP: sent_us}}
    return angle_record(made_run(folder, "swing", columns, facts_of={"encoder": {"counts_per_turn": 4096.0}}).folder)


def test_stalls_of_16_ms_leave_intervals_true_within_their_stated_scale() -> None:
    scores = []
    for seed in range(10):
        taken, arrived, stamps = busy(np.random.default_rng(seed))
        found = stamped_times(arrived, stamps)
        assert found is not None
        off_s = (found.time_s - taken) - (found.time_s - taken).mean()
        scale = float(np.polyfit(taken - taken[0], off_s, 1)[0])
        scores.append(abs(scale) / found.scale_std)

        assert np.ptp(arrived - taken) > 10e-3
        assert np.ptp(off_s) < 1e-4
        assert found.scale_std < 3e-5
    assert max(scores) < 1.96


def test_stamps_are_not_used_that_count_something_else_or_start_anew() -> None:
    _, arrived, stamps = busy(np.random.default_rng(1))
    anew = stamps - np.where(np.arange(len(stamps)) > len(stamps) // 2, stamps[len(stamps) // 2], 0)

    assert stamped_times(arrived, stamps) is not None
    assert stamped_times(arrived, np.floor(stamps / 1000)) is None  # milliseconds
    assert stamped_times(arrived, anew) is None
    assert stamped_times(arrived, np.full_like(stamps, 7.0)) is None
    assert stamped_times(arrived[:20], stamps[:20]) is None
    jumped = stamps + np.where(np.arange(len(stamps)) > len(stamps) // 2, 3000, 0)
    assert stamped_times(arrived, jumped) is None


def test_stamps_that_lost_a_digit_cost_their_rows_alone(tmp_path: Path) -> None:
    """Previously, times from such stamps jumped back and forth, and a swing ended in a traceback."""
    rng = np.random.default_rng(3)
    seconds = 0.002 * np.arange(6000.0)
    arrived, stamps = 1.7e9 + seconds + rng.gamma(3.0, 15e-6, 6000), (1e6 * seconds + 812_000).astype(np.int64)
    wrong = rng.choice(6000, 120, replace=False)
    short = np.array([int(str(stamp)[:-1]) for stamp in stamps[wrong]])
    sent = stamps.copy()
    sent[wrong] = short
    record = recorded(tmp_path, seconds, arrived, sent)

    assert 5850 < len(record.time_s) <= 5880  # a right stamp between two wrong ones is left out too
    assert np.all(np.diff(record.time_s) > 0)
    assert record.time_s == pytest.approx(0.002 * np.round(record.time_s / 0.002), abs=1e-4)
    assert codes(record) == ["stamps-wrong"]


@pytest.mark.parametrize(
    ("unit_s", "expected"),
    [(1e-6, []), (1e-3, ["time-repeats", "stamps-no-clock"])],
)
def test_lines_in_bunches_are_placed_by_a_clock_that_is_one_and_any_other_is_named(
    tmp_path: Path, unit_s: float, expected: list[str]
) -> None:
    """A clock in microseconds separates lines that arrive together; otherwise their times repeat, with a warning."""
    seconds: npt.NDArray[np.float64] = 0.002 * np.arange(6000.0)
    arrived = 1.7e9 + 0.016 * np.ceil(seconds / 0.016)
    record = recorded(tmp_path, seconds, arrived, (seconds / unit_s + 812).astype(np.int64))

    assert codes(record) == expected

"""Runs of a vehicle's gyro, read like those of an encoder: times from its stamps, angle and rate about its axis."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.recordings.angle import AngleRecord, angle_record
from cfid.recordings.gyro import GYRO, integrated
from cfid.recordings.stamps import stamped_times
from cfid.records.rig_file import STAMP
from cfid.records.run import Clock, Label, Origin
from cfid.swing.window import swing_in
from tests.lab import STARTED_S, codes, made_run

Array = npt.NDArray[np.float64]

AXIS = np.array([0.6, 0.0, 0.8])


def rocking(time_s: Array, *, amplitude_rad: float = 0.5, per_s: float = 10.0) -> tuple[Array, Array]:
    """Return the angle of a decaying oscillation in rad, and its rate in rad/s."""
    decay = amplitude_rad * np.exp(-0.1 * time_s)
    angle = decay * np.cos(per_s * time_s)
    return angle, -decay * (per_s * np.sin(per_s * time_s) + 0.1 * np.cos(per_s * time_s))


def gyro_run(
    folder: Path,
    rate: Array,
    *,
    stamps_ms: Array | None,
    arrivals_s: Array,
    bias_dps: float = 0.3,
    clock: Clock | None = None,
) -> Path:
    """Write a run of a gyro that turns about AXIS; without stamps it is like a run imported from a card."""
    rates = np.degrees(rate)[:, None] * AXIS + bias_dps
    stamps = {} if stamps_ms is None else {"vehicle_ms": stamps_ms}
    columns = {"t": STARTED_S + arrivals_s, **stamps, **dict(zip(GYRO, rates.T, strict=True))}
    origin = None if clock is None else Origin(file="LOG00", sha256="0" * 64, program="uSD log", clock=clock)
    return made_run(folder, "swing", {"crazyflie": columns}, label=Label(axis="x"), origin=origin).folder


def test_the_vehicles_stamps_place_its_rows_however_late_they_arrive_and_where_they_wrap(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(0, 10, 0.005)
    late_s = np.maximum.accumulate(time_s + rng.exponential(0.02, len(time_s)))
    stamps_ms = (np.round(1000 * time_s) + (1 << 24) - 3000) % (1 << 24)
    angle, rate = rocking(time_s)

    found = angle_record(gyro_run(tmp_path, rate, stamps_ms=stamps_ms, arrivals_s=late_s))

    assert found.time_s == pytest.approx(time_s, abs=1e-3)
    assert found.time_scale_std == pytest.approx(5e-5)
    assert found.rates is not None
    assert found.rates.axis == pytest.approx(AXIS, abs=1e-3)
    assert np.abs(found.angle_rad - angle).max() < 5e-3


@pytest.mark.parametrize("late_s", [0.006, 0.02])
def test_arrivals_that_are_late_on_a_busy_computer_are_no_other_unit_of_stamps(tmp_path: Path, late_s: float) -> None:
    """First rows that arrive 6 ms late shorten a recording of one second to 0.9935 s per second of the stamps."""
    time_s = np.arange(0, 1, 0.005)
    _, rate = rocking(time_s)
    busy = time_s + late_s * (time_s < 0.4)

    found = angle_record(gyro_run(tmp_path, rate, stamps_ms=1000 * time_s, arrivals_s=np.maximum.accumulate(busy)))

    assert found.time_s == pytest.approx(time_s, abs=1e-6)


@pytest.mark.parametrize("fault", ["at 84/85", "restarted"])
def test_stamps_that_are_no_milliseconds_are_refused_and_not_corrected_twice(tmp_path: Path, fault: str) -> None:
    time_s = np.arange(0, 10, 0.005)
    late_s = np.maximum.accumulate(time_s + np.random.default_rng(1).exponential(0.003, len(time_s)))
    restarted_ms = np.where(time_s < 5, 60_000 + 1000 * time_s, 1000 * (time_s - 5) + 300)
    stamps_ms = restarted_ms if fault == "restarted" else 1000 * time_s * 84 / 85
    folder = gyro_run(tmp_path, rocking(time_s)[1], stamps_ms=stamps_ms, arrivals_s=late_s)

    with pytest.raises(DataError) as caught:
        angle_record(folder)
    assert caught.value.code == "vehicle-clock"


def test_a_gap_in_a_gyro_s_rows_is_named_where_its_angle_goes_over_the_top(tmp_path: Path) -> None:
    time_s = np.arange(0, 20, 0.005)
    rate = rocking(time_s, amplitude_rad=1.2, per_s=6.0)[1]
    kept = (time_s < 5.10) | (time_s > 5.62)  # a gap of half a swing, in which the gyro turned by over 1 rad
    folder = gyro_run(tmp_path, rate[kept] + 4.0 * (time_s[kept] > 5.6), stamps_ms=None, arrivals_s=time_s[kept])

    with pytest.raises(DataError, match=r"over the top.* The gyro has no rows for 0\.5\d s, after 5\.1 s"):
        swing_in(angle_record(folder))


@pytest.mark.parametrize("rate_hz", [1000, 100])
@pytest.mark.parametrize(("amplitude_dps", "range_dps"), [(4000, 2000), (394, 300)])
def test_a_gyro_at_the_end_of_its_range_is_refused(
    tmp_path: Path, rate_hz: int, amplitude_dps: float, range_dps: float
) -> None:
    time_s = np.arange(0, 10, 1 / rate_hz)
    rate = np.radians(amplitude_dps * np.exp(-0.01 * time_s) * np.sin(6.0 * time_s))
    clipped = np.clip(rate, *np.radians([-range_dps, range_dps]) / AXIS[2])
    folder = gyro_run(tmp_path, clipped, stamps_ms=None, arrivals_s=time_s, bias_dps=0.0)
    with pytest.raises(DataError) as caught:
        angle_record(folder)
    assert caught.value.code == "gyro-at-end"


def test_a_turn_that_begins_at_rest_loses_its_bias_there() -> None:
    time_s = np.arange(0, 5, 0.002)
    rate = np.where(time_s > 1, 20 * (1 - np.exp(1 - time_s)), 0.0)

    angle, bias = integrated(time_s, rate + 0.01)

    assert bias == pytest.approx(0.01, abs=1e-4)
    assert angle[-1] == pytest.approx(np.trapezoid(rate, time_s), abs=1e-3)


@pytest.mark.parametrize(("clock", "undecided"), [("unknown", True), ("true", False), ("84/85", False)])
def test_a_clock_that_nothing_shows_rejects_what_rests_on_times(
    tmp_path: Path, clock: Clock, *, undecided: bool
) -> None:
    time_s = np.arange(0, 10, 0.005)
    found = angle_record(gyro_run(tmp_path, rocking(time_s)[1], stamps_ms=None, arrivals_s=time_s, clock=clock))
    rejections = [finding for finding in found.findings if finding.severity == "rejection"]
    assert [finding.code for finding in rejections] == ["gyro-clock-undecided"] * undecided
    assert all(finding.concerns("swing.axis_inertia_kg_m2") for finding in rejections)


@pytest.mark.parametrize("device", ["encoder", "crazyflie"])
def test_a_run_without_rows_is_refused(tmp_path: Path, device: str) -> None:
    names = ("t", "phi") if device == "encoder" else ("t", *GYRO)
    run = made_run(tmp_path, "swing", {device: {name: [] for name in names}})
    with pytest.raises(DataError):
        angle_record(run.folder)


# Stamps of the device that took the samples


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


def stamped_record(folder: Path, taken_s: Array, arrived_s: Array, sent_us: npt.NDArray[np.int64]) -> AngleRecord:
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
    record = stamped_record(tmp_path, seconds, arrived, sent)

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
    record = stamped_record(tmp_path, seconds, arrived, (seconds / unit_s + 812).astype(np.int64))

    assert codes(record) == expected

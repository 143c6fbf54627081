"""Runs of a vehicle's gyro, read like those of an encoder: times from its stamps, angle and rate about its axis."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.recordings.angle import angle_record
from cfid.recordings.gyro import GYRO, integrated
from cfid.records.run import Clock, Label, Origin
from cfid.swing.window import swing_in
from tests.lab import STARTED_S, made_run

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

"""What no vehicle's log can show: hung three-axis sensors and repeated times; and parts of a log hold it all."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.recordings.crazyflie import channel, windows
from cfid.recordings.limits import refuse_repeated_times, without_hung
from cfid.recordings.read import of_run
from cfid.records.run import DeviceRecord, Label, read_run
from cfid.records.run_writer import create_run
from tests.recordings.made import made_log, made_series

Array = npt.NDArray[np.float64]

RATE_HZ, ROWS = 500, 10000
EVERY_2_MS = 0.002 * np.arange(3000)
COUNT = 70_000
FAST_S = np.linspace(7.0, 7.0 + (COUNT - 1) * 1e-3, COUNT)
SLOW_S = np.linspace(7.05, 71.95, 650)
LOG = made_log(
    made_series("fast", FAST_S, [("a", ""), ("speed", "rpm")], [FAST_S - 7, np.ones(COUNT)]),
    made_series("slow", SLOW_S, [("volts", "V")], [4 - SLOW_S / 100]),
)


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


@pytest.mark.parametrize("time_s", [np.floor(EVERY_2_MS * 100) / 100, np.repeat(EVERY_2_MS, 2)])
def test_times_that_are_rounded_or_of_two_recordings_are_refused(time_s: Array) -> None:
    with pytest.raises(DataError) as refused:
        refuse_repeated_times(Path("log"), time_s)
    assert refused.value.code == "time-repeats"
    refuse_repeated_times(Path("log"), np.repeat(EVERY_2_MS, np.where(np.arange(3000) % 20, 1, 2)))


def test_parts_hold_what_the_log_holds() -> None:
    parts = list(windows(LOG, ["speed", "volts", "a"], from_s=0.0, long_s=10.0))
    assert len(parts) == 7
    for name in ("a", "speed", "volts"):
        time_s, value = channel(LOG, name)
        np.testing.assert_array_equal(np.concatenate([part[name].time_s for part in parts]), time_s)
        np.testing.assert_array_equal(np.concatenate([part[name].value for part in parts]), value)
    for at, part in enumerate(parts):
        for time_s, _ in part.values():
            assert len(time_s) == 0 or 10 * at <= time_s[0] <= time_s[-1] < 10 + 10 * at
    with pytest.raises(DataError, match="no column b; it has fast: a, speed; slow: volts"):
        list(windows(LOG, ["b"], from_s=0.0, long_s=10.0))


def test_rows_that_a_run_gets_while_it_is_read_change_nothing(tmp_path: Path) -> None:
    """Before, rows were counted once and read again later, which failed where some had come in between."""
    began = datetime.now(UTC)
    begin_s = began.timestamp()
    run = create_run(
        tmp_path,
        kind="flight",
        label=Label(),
        devices={"crazyflie": DeviceRecord(file="crazyflie.csv", columns=("t", "gyro.x"))},
        started=began,
        cfid_version="0",
    )
    run.append("crazyflie", (begin_s + np.arange(1000) / 100, np.zeros(1000)))
    log = of_run(read_run(run.folder))
    assert log.series["crazyflie"].rows == 1000
    run.append("crazyflie", (begin_s + 10 + np.arange(100) / 100, np.zeros(100)))
    assert channel(log, "gyro.x").value.shape == (1000,)
    run.close("complete")

"""`cfid log gyro` over real wires: a vehicle in the swing is recorded and judged, and no motor turns."""

import json
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from cfid.errors import DeviceError
from cfid.recordings.angle import angle_record
from cfid.recordings.vehicle import read_rows
from cfid.records.rig_file import load_rig
from cfid.rig.log_rate import fastest_period_ms, shortest
from cfid.rig.ready_vehicle import INERTIAL, connect_vehicle
from tests.flying_in_a_folder import bench_in


def test_a_vehicle_in_the_swing_is_recorded_and_gives_its_axis_and_its_motors_never_turn(tmp_path: Path) -> None:
    with bench_in(tmp_path, hung_on="x") as bench:
        ended = bench.start("log", "gyro", "--axis", "x", "--for", 26, "--log-ms", 5, "--json")
        assert ended.end() == 0, ended.err
        motors = [motors for _, motors in bench.history if any(motors)]
        run = bench.run()
    rows = read_rows(run, "crazyflie")
    found = angle_record(run.folder)
    told = json.loads(ended.out)

    assert motors == []
    assert tuple(rows.columns) == ("vehicle_ms", *INERTIAL)
    assert told["command"] == "log gyro"
    assert told["devices"]["crazyflie"]["rows"] == len(rows.time_s)
    assert run.header.kind == "swing"
    assert found.rates is not None
    assert found.rates.axis == pytest.approx((1, 0, 0), abs=0.05)
    assert 0.2 < np.abs(found.angle_rad).max() < 1.4


def test_a_link_gets_the_shortest_period_that_loses_less_than_a_hundredth(tmp_path: Path) -> None:
    with bench_in(tmp_path, hung_on="x", radio={"packets_per_s": 400}) as bench, ExitStack() as held:
        setting = load_rig(tmp_path / "rig.toml").devices.crazyflie
        period_ms, losses = fastest_period_ms(connect_vehicle(setting, held), INERTIAL)
        assert bench.motors == (0, 0, 0, 0)

    assert period_ms in (5, 10)  # a busy computer may lose rows at 5 ms too
    assert losses[1] > 0.5
    assert losses[period_ms] < 0.01


def test_periods_are_tried_from_the_shortest_until_one_loses_little() -> None:
    assert shortest({1: 0.3, 2: 0.02, 5: 0.004}.__getitem__, uri="radio://0") == (5, {1: 0.3, 2: 0.02, 5: 0.004})
    assert shortest({1: 0.0099}.__getitem__, uri="radio://0") == (1, {1: 0.0099})


def test_a_link_that_loses_at_every_rate_is_named_with_what_it_loses() -> None:
    with pytest.raises(DeviceError, match=r"radio://0: the link loses 4 % of rows that are 10 ms apart \(limit 1 %\)"):
        shortest({1: 0.5, 2: 0.4, 5: 0.1, 10: 0.04}.__getitem__, uri="radio://0")

"""Staircases, sines and pings with a simulated vehicle, and all ways in which its motors stop, in virtual time."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import ConfigError, DeviceError
from cfid.latency.record import ping_often
from cfid.motors.plan import StaircasePlan
from cfid.motors.staircase.record import run_staircase
from cfid.records.run import Run
from cfid.rig.loop import Ending
from cfid.rig.motor_commands import hold
from cfid.rig.motors import MAY_BE_RUNNING, Limits
from cfid.rig.recorder import Block, no_rows, sleep
from cfid.sim.faults import CrazyflieFaults
from cfid.sim.link import RadioTruth
from cfid.sim.propulsion import BatteryTruth
from cfid.transfer.sines.record import play_sine
from cfid.wire.app import SineRequest, omega_of
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_PORT
from tests.known import known
from tests.rig.flying import UNIX_S, Flight

KINDS = pytest.mark.parametrize("firmware", ["app", "stock"])
RESET = b"\x05"  # deletes every block of the vehicle's log, as a client does that connects
STAIRS = StaircasePlan(steps=(0, 10000, 20000), motors=(1, 3), hold_s=2.0, rest_s=1.0)


def rows(run: Run, device: str) -> pd.DataFrame:
    return pd.read_csv(run.device_file(device))


def silent(text: str) -> None:
    pass


def sine(l: int, samples: int = 2000, *, amplitude: int = 20000, motor: int = 1) -> SineRequest:  # noqa: E741
    return SineRequest(motor, amplitude, omega_of(l, samples), samples)


def commanded(request: SineRequest, l: int) -> np.ndarray[Any, np.dtype[np.int64]]:  # noqa: E741
    """Return the commands of eq. 3.6, cut and clipped."""
    n = np.arange(request.samples)
    exact = request.amplitude * np.cos(2 * np.pi * l * n / request.samples) + 30000
    return np.clip(np.trunc(np.round(exact, 6)), 0, 65535).astype(np.int64)


def crossings_of(u: np.ndarray[Any, np.dtype[np.int64]]) -> list[int]:
    """Return where C.2.4 reports: at the first sample, and where the middle is crossed or reached."""
    falls = (u[:-1] > 30000) & (u[1:] <= 30000)
    rises = (u[:-1] < 30000) & (u[1:] >= 30000)
    return [0, *(np.flatnonzero(falls | rises) + 1).tolist()]


# What is recorded


@KINDS
def test_a_staircase_drives_the_motors_and_writes_down_when(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware)
    messages: list[str] = []

    run, failure = flight.record(
        [flight.commands(), flight.log()],
        lambda there: run_staircase(STAIRS, there["commands"], loop=flight.clock, tell=messages.append),
    )

    assert failure is None
    assert flight.motors[-1][1] == (0, 0, 0, 0)
    driven = [motors for _, motors in flight.motors[1:]]
    assert (10000, 0, 10000, 0) in driven
    assert (20000, 0, 20000, 0) in driven
    assert all(motors[1] == motors[3] == 0 for motors in driven)
    commands = rows(run, "commands")
    steps = commands[commands.m1 > 0]
    assert steps.m1.tolist() == [10000, 20000]
    for _, row in steps.iterrows():
        began_s = next(time_s for time_s, motors in flight.motors if motors[0] == row.m1)
        assert row.t - UNIX_S == pytest.approx(began_s, abs=0.15)  # the link's latency; parameters are set one by one
    assert messages[0] == "command 0 (1 of 3)"
    log = rows(run, "crazyflie")
    assert set(log["motor.m1"]) == {0, 10000, 20000}
    assert (log["pm.vbat"] > 3).all()


@pytest.mark.parametrize("l", [0, 1, 7, 12, 250, 999, 1000])
def test_the_crossings_of_a_sine_are_those_of_equation_3_6(tmp_path: Path, l: int) -> None:  # noqa: E741
    flight = Flight(tmp_path)
    request = sine(l)
    u = commanded(request, l)

    run, failure = flight.record(
        [flight.crossings()],
        lambda there: play_sine(request, there["crossings"], before_s=0.5, loop=flight.clock, tell=silent),
    )

    assert failure is None
    reports = rows(run, "crossings")
    expected = crossings_of(u)
    assert reports.thrust_rec.tolist()[-1] == 0
    assert reports["sample"].tolist() == [*expected, request.samples]
    assert np.abs(reports.thrust_rec.to_numpy()[:-1] - u[expected]).max() <= 1
    on_board_s = np.diff(reports.vehicle_us.to_numpy()) / 1e6
    assert on_board_s == pytest.approx(np.diff(reports["sample"].to_numpy()) / 500, abs=0.0021)
    assert reports.report.tolist() == list(range(len(reports)))
    assert run.header.devices["crossings"].lost == 0


def test_the_other_motors_rest_while_one_plays(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.record(
        [flight.crossings()],
        lambda there: play_sine(sine(3, motor=2), there["crossings"], before_s=0.1, loop=flight.clock, tell=silent),
    )
    driven = np.array([motors for _, motors in flight.motors[1:]])
    assert driven[:, 1].max() == 50000
    assert driven[:, [0, 2, 3]].max() == 0


def test_reports_that_the_link_lost_are_counted(tmp_path: Path) -> None:
    flight = Flight(tmp_path, faults=CrazyflieFaults(drop_every=9))
    request = sine(40)
    run, failure = flight.record(
        [flight.crossings()],
        lambda there: play_sine(request, there["crossings"], before_s=0.1, loop=flight.clock, tell=silent),
    )
    reports = rows(run, "crossings")
    missing = len(crossings_of(commanded(request, 40))) + 1 - len(reports)
    assert missing > 0
    assert run.header.devices["crossings"].lost == missing
    assert failure is None


@KINDS
def test_round_trips_are_those_of_the_radio(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware, radio=RadioTruth(latency_s=0.0285, jitter_s=0.008))
    run, failure = flight.record(
        [flight.pings()],
        lambda there: ping_often(there["pings"], count=200, every_s=0.1, loop=flight.clock, tell=silent),
    )
    assert failure is None
    measured_s = rows(run, "pings").rtt_s
    if firmware == "stock":
        injected_s = [ping.round_trip_s for ping in flight.sim.radio.pings if len(ping.payload) == 9]
    else:
        injected_s = [ping.round_trip_s for ping in flight.sim.radio.pings if ping.port == 12]
    assert len(measured_s) == 200
    assert measured_s.to_numpy() == pytest.approx(np.array(injected_s), abs=0.0021)
    assert measured_s.mean() == pytest.approx(np.mean(injected_s), rel=0.01)


def test_pings_that_get_no_answer_are_lost_and_the_next_is_sent(tmp_path: Path) -> None:
    flight = Flight(tmp_path, radio=RadioTruth(latency_s=0.004, jitter_s=0.001, loss=0.1))
    run, failure = flight.record(
        [flight.pings()],
        lambda there: ping_often(there["pings"], count=50, every_s=0.1, loop=flight.clock, tell=silent),
    )
    assert failure is None
    assert 0 < known(run.header.devices["pings"].lost) < 25
    assert len(rows(run, "pings")) + known(run.header.devices["pings"].lost) == 50


def test_a_lossy_link_costs_repetitions_and_no_command(tmp_path: Path) -> None:
    flight = Flight(tmp_path, radio=RadioTruth(latency_s=0.004, jitter_s=0.001, loss=0.05))
    _, failure = flight.record(
        [flight.commands()],
        lambda there: run_staircase(STAIRS, there["commands"], loop=flight.clock, tell=silent),
    )
    assert failure is None
    assert {motors[0] for _, motors in flight.motors} == {0, 10000, 20000}


# What is refused


@KINDS
def test_a_command_beyond_rig_tomls_limit_never_leaves(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware, limits=Limits(largest_command=15000))
    _, failure = flight.record(
        [flight.commands()],
        lambda there: run_staircase(STAIRS, there["commands"], loop=flight.clock, tell=silent),
    )
    assert isinstance(failure, ConfigError)
    assert "command 20000: commands go from 0 to 15000 (devices.crazyflie.largest_command in rig.toml)." in str(failure)
    assert max(max(motors) for _, motors in flight.motors) == 10000
    assert not any((20000).to_bytes(2, "little") in packet.payload for packet in flight.link.sent)


def test_a_sine_beyond_the_limit_never_leaves(tmp_path: Path) -> None:
    flight = Flight(tmp_path, limits=Limits(largest_command=45000))
    _, failure = flight.record(
        [flight.crossings()],
        lambda there: play_sine(sine(3), there["crossings"], before_s=0.1, loop=flight.clock, tell=silent),
    )
    assert isinstance(failure, ConfigError)
    assert not any(packet.port == 11 for packet in flight.link.sent)
    assert len(flight.motors) == 1


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        (SineRequest(1, 20000, 0.1, 0), "N is zero"),
        (SineRequest(1, 20000, float("nan"), 100), "omega is no frequency from 0 to pi"),
        (SineRequest(1, 20000, 0.1, 1000), "omega is no multiple of 2 pi/N"),
        (SineRequest(7, 20000, omega_of(3, 100), 100), "there is no such motor"),
    ],
)
def test_the_app_refuses_nonsense_and_says_why(tmp_path: Path, request_: SineRequest, expected: str) -> None:
    flight = Flight(tmp_path)
    _, failure = flight.record(
        [flight.crossings()],
        lambda there: play_sine(request_, there["crossings"], before_s=0.1, loop=flight.clock, tell=silent),
    )
    assert isinstance(failure, DeviceError)
    assert expected in str(failure)
    assert len(flight.motors) == 1


class FaultyAtOnce:
    """An instrument whose first block already has a fault."""

    name = "loadcell"
    columns = ("t", "Fz")

    def start(self) -> None:
        """It samples by itself."""

    def take(self) -> Block:
        return Block(no_rows(2), fault="loadcell: the link to the transducer failed.")

    async def stop(self) -> None:
        """It needs no stop."""

    def close(self) -> None:
        """Nothing is open."""

    def facts(self) -> dict[str, Any]:
        return {}


@KINDS
def test_after_a_faulty_first_block_no_procedure_begins(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware)
    begun: list[str] = []

    async def drive(there: Any) -> None:
        begun.append("begun")
        await hold(there["commands"], 20000, (1, 2, 3, 4), for_s=1.0, loop=flight.clock)

    _, failure = flight.record([flight.commands(), FaultyAtOnce()], drive)
    flight.turn(for_s=0.5)

    assert "the link to the transducer failed" in str(failure)
    assert not begun
    assert len(flight.motors) == 1  # none has ever turned
    assert not any((20000).to_bytes(2, "little") in packet.payload for packet in flight.link.sent)
    assert not any(packet.port in (3, 7, 10, 11) for packet in flight.link.sent)


# Ways out: the motors are off 0.7 s later, or a message states that they may not be

BEGUN_S = 3.0

WAYS = [
    ("silent", CrazyflieFaults(silent_after_s=BEGUN_S), "the app answered no keep-alive for"),
    ("closed", CrazyflieFaults(closed_after_s=BEGUN_S), "the link was closed"),
    ("battery", CrazyflieFaults(low_battery_after_s=BEGUN_S), "the battery is at 2.90 V, below the 3.1 V"),
    ("tumbled", CrazyflieFaults(tumble_after_s=BEGUN_S), "its supervisor does not let the motors run"),
    ("emergency", CrazyflieFaults(emergency_after_s=BEGUN_S), "its supervisor does not let the motors run"),
    ("reboot", CrazyflieFaults(reboot_after_s=BEGUN_S), ""),
]
APP_WAYS = pytest.mark.parametrize(("fault", "told"), [way[1:] for way in WAYS], ids=[way[0] for way in WAYS])


@APP_WAYS
def test_with_the_app_every_fault_stops_the_motors(tmp_path: Path, fault: CrazyflieFaults, told: str) -> None:
    flight = Flight(tmp_path, faults=fault, stop_below_v=3.1)
    run, failure = flight.record(
        [flight.commands(), flight.log()],
        lambda there: hold(there["commands"], 30000, (1, 2), for_s=20.0, loop=flight.clock),
    )
    flight.turn(for_s=1.0)
    assert isinstance(failure, DeviceError)
    assert told in str(failure)
    assert MAY_BE_RUNNING not in str(failure)
    late_s = 0.5 if told.startswith("the battery") else 0.0  # it has to be low for this long
    assert flight.stopped_after(1.0 + BEGUN_S + late_s) < 0.7
    assert max(max(motors) for _, motors in flight.motors) == 30000
    assert rows(run, "commands").iloc[-1].tolist()[1:] == [0, 0, 0, 0]


@APP_WAYS
def test_with_the_app_every_fault_ends_a_sine(tmp_path: Path, fault: CrazyflieFaults, told: str) -> None:
    flight = Flight(tmp_path, faults=fault, stop_below_v=3.1)
    _, failure = flight.record(
        [flight.crossings(), flight.log()],
        lambda there: play_sine(sine(5, 5000), there["crossings"], before_s=0.5, loop=flight.clock, tell=silent),
    )
    flight.turn(for_s=1.0)
    assert isinstance(failure, DeviceError)
    late_s = 0.5 if told.startswith("the battery") else 1.0 if told.startswith("its supervisor") else 0.0
    assert flight.stopped_after(1.0 + BEGUN_S) < 0.7 + late_s


STALLS = [
    ("app", 0.35, ""),
    ("app", 1.5, "it received no keep-alive, since cfid itself was suspended or kept waiting for 1.5 s"),
    ("stock", 1.5, ""),
]


@pytest.mark.parametrize(("firmware", "stall_s", "expected"), STALLS)
def test_a_stall_of_cfid_itself_is_not_taken_for_the_vehicles_silence(
    tmp_path: Path, firmware: str, stall_s: float, expected: str
) -> None:
    flight = Flight(tmp_path, firmware=firmware)

    async def stall(there: Any) -> None:
        await hold(there["commands"], 30000, (1, 2), for_s=1.0, loop=flight.clock)
        flight.clock.pause(stall_s)
        await hold(there["commands"], 30000, (1, 2), for_s=2.5, loop=flight.clock)

    _, failure = flight.record([flight.commands(), flight.log()], stall)

    assert (expected in str(failure)) if expected else (failure is None)
    assert not any(flight.motors[-1][1])


def test_a_pause_between_two_recordings_is_no_stall(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    flight.record([flight.log()], lambda _: sleep_for(flight, 1.0))
    flight.turn(for_s=4.0)

    async def end_log(_: Any) -> None:
        await sleep(flight.clock, 0.3)
        flight.vehicle.send(LOG_PORT, LOG_CONTROL_CHANNEL, RESET)
        await sleep(flight.clock, 20.0)

    _, failure = flight.record([flight.log()], end_log)
    assert "its battery is not monitored: does another program use it?" in str(failure)


async def sleep_for(flight: Flight, seconds: float) -> None:
    await sleep(flight.clock, seconds)


def test_a_log_that_ends_after_a_stall_of_cfid_itself_is_noticed_at_once_and_the_stall_is_named(tmp_path: Path) -> None:
    """Firmware ends its logs if the link is silent for a second; a stall is over when the next row arrives."""
    flight = Flight(tmp_path)
    ended_s: list[float] = []

    async def stall(_: Any) -> None:
        await sleep(flight.clock, 1.0)
        flight.clock.pause(4.0)
        await sleep(flight.clock, 0.04)
        flight.vehicle.send(LOG_PORT, LOG_CONTROL_CHANNEL, RESET)
        ended_s.append(flight.clock.seconds())
        await sleep(flight.clock, 20.0)

    _, failure = flight.record([flight.log()], stall)

    assert "its battery is not monitored: cfid itself was suspended or kept waiting for 4.0 s" in str(failure)
    assert flight.clock.seconds() - ended_s[0] < 1.0


@pytest.mark.parametrize("fault", [CrazyflieFaults(silent_after_s=BEGUN_S), CrazyflieFaults(closed_after_s=BEGUN_S)])
def test_without_the_app_a_lost_link_is_told_in_a_sentence_that_nobody_misses(
    tmp_path: Path, fault: CrazyflieFaults
) -> None:
    flight = Flight(tmp_path, firmware="stock", faults=fault)
    _, failure = flight.record(
        [flight.commands(), flight.log()],
        lambda there: hold(there["commands"], 30000, (1, 2), for_s=20.0, loop=flight.clock),
    )
    assert isinstance(failure, DeviceError)
    assert MAY_BE_RUNNING in str(failure)
    assert "PULL THE BATTERY" in str(failure)
    assert flight.motors[-1][1] == (30000, 30000, 0, 0)  # the motors do still run


def test_without_the_app_a_low_battery_stops_the_motors(tmp_path: Path) -> None:
    fault = CrazyflieFaults(low_battery_after_s=BEGUN_S)
    flight = Flight(tmp_path, firmware="stock", faults=fault, stop_below_v=3.1)
    _, failure = flight.record(
        [flight.commands(), flight.log()],
        lambda there: hold(there["commands"], 30000, (1, 2), for_s=20.0, loop=flight.clock),
    )
    assert "below the 3.1 V" in str(failure)
    assert flight.stopped_after(1.0 + BEGUN_S + 0.5) < 0.7


@KINDS
@pytest.mark.parametrize("raised", [ValueError("a bug"), DeviceError("the load cell is lost")])
def test_whatever_a_procedure_raises_the_motors_stop(tmp_path: Path, firmware: str, raised: Exception) -> None:
    flight = Flight(tmp_path, firmware=firmware)

    async def fail(there: Any) -> None:
        await hold(there["commands"], 30000, (1, 2), for_s=1.0, loop=flight.clock)
        flight.said.append(str(flight.clock.seconds()))
        raise raised

    _, failure = flight.record([flight.commands()], fail)
    assert failure is raised
    assert flight.stopped_after(float(flight.said[0])) < 0.7


def test_a_stop_that_needs_several_tries_is_tried_again(tmp_path: Path) -> None:
    flight = Flight(tmp_path, radio=RadioTruth(latency_s=0.004, jitter_s=0.001, loss=0.2))
    _, failure = flight.record(
        [flight.commands()],
        lambda there: hold(there["commands"], 30000, (1,), for_s=2.0, loop=flight.clock),
    )
    assert failure is None
    assert not any(flight.motors[-1][1])


@pytest.mark.parametrize("pause_s", [0.0, 0.3, 0.6, 0.9])
def test_the_last_word_of_an_interrupted_sine_is_not_taken_for_that_of_the_next(tmp_path: Path, pause_s: float) -> None:
    flight = Flight(tmp_path)

    def play(there: Any) -> Any:
        return play_sine(sine(5, 500), there["crossings"], before_s=0.1, loop=flight.clock, tell=silent)

    flight.clock.callLater(0.5, flight.ending.request, "SIGTERM")
    first, _ = flight.record([flight.crossings()], play)
    flight.turn(for_s=pause_s)
    flight.ending = Ending(flight.clock)
    second, failure = flight.record([flight.crossings()], play)

    assert rows(first, "crossings")["sample"].max() < 500
    assert failure is None
    assert rows(second, "crossings")["sample"].tolist() == [*crossings_of(commanded(sine(5, 500), 5)), 500]


def test_a_battery_that_is_empty_until_the_end_is_named_once(tmp_path: Path) -> None:
    """Its voltage rises a little once the motors stop, and the rows that follow are written too."""
    battery = BatteryTruth(kind="lipo", capacity_mah=4.0, resistance_ohm=0.02, open_circuit_v=(2.8, 3.3))
    flight = Flight(tmp_path, battery=battery, stop_below_v=3.1)
    _, failure = flight.record(
        [flight.commands(), flight.log(period_ms=1)],
        lambda there: hold(there["commands"], 60000, (1, 2, 3, 4), for_s=60.0, loop=flight.clock),
    )
    assert str(failure).count("the battery is at") == 1


def test_a_sagging_battery_is_seen_in_the_log(tmp_path: Path) -> None:
    flight = Flight(tmp_path, battery=BatteryTruth(kind="lipo"))
    stairs = StaircasePlan(steps=(60000,), motors=(1, 2, 3, 4), hold_s=3.0, rest_s=0.5)
    run, failure = flight.record(
        [flight.commands(), flight.log()],
        lambda there: run_staircase(stairs, there["commands"], loop=flight.clock, tell=silent),
    )
    assert failure is None
    log = rows(run, "crazyflie")
    before, under = log[log["motor.m1"] == 0]["pm.vbat"].iloc[0], log[log["motor.m1"] == 60000]["pm.vbat"].iloc[-1]
    assert before - under > 0.2


@pytest.mark.parametrize("period_ms", [1, 10, 100])
def test_the_log_keeps_its_period_and_counts_what_the_link_lost(tmp_path: Path, period_ms: int) -> None:
    flight = Flight(tmp_path, faults=CrazyflieFaults(drop_every=50))
    run, failure = flight.record(
        [flight.pings(), flight.log(period_ms=period_ms)],
        lambda there: ping_often(there["pings"], count=30, every_s=0.1, loop=flight.clock, tell=silent),
    )
    log, record = rows(run, "crazyflie"), run.header.devices["crazyflie"]
    span = log.vehicle_ms.iloc[-1] - log.vehicle_ms.iloc[0]
    assert failure is None
    assert span / period_ms + 1 == len(log) + known(record.lost)
    assert known(record.lost) > 0 or period_ms == 100

"""Motors under a supervisor whose state changes: arming, states that end a run, stops that are confirmed."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cfid.errors import ConfigError, DeviceError, StopError
from cfid.motors.plan import StaircasePlan
from cfid.motors.staircase.record import run_staircase
from cfid.rig.motor_commands import hold
from cfid.rig.motors import MAY_BE_RUNNING, Limits
from cfid.sim.faults import CrazyflieFaults
from cfid.sim.supervisor import SupervisorState
from cfid.transfer.sines.record import play_sine
from cfid.wire.app import SineRequest, omega_of
from cfid.wire.crtp import Packet, encode_packet
from cfid.wire.supervisor import Bits, VehicleState
from tests.rig.flying import CLIENT, Flight

ALL = (1, 2, 3, 4)
SETPOINT = Packet(3, 0, bytes(14))  # the stock library sends this when it closes
BOTH = pytest.mark.parametrize("platform", ["cf2", "cf21bl"])
FIRMWARES = pytest.mark.parametrize("firmware", ["app", "stock"])


def holding(flight: Flight, command: int, motors: tuple[int, ...] = ALL, for_s: float = 1.0) -> Any:
    return lambda there: hold(there["commands"], command, motors, for_s=for_s, loop=flight.clock)


def states(run: Any) -> list[str]:
    rows = pd.read_csv(run.device_file("supervisor"))
    return [VehicleState.of(int(word)).name for word in rows["state"]]


def state_of(flight: Flight) -> SupervisorState:
    return flight.sim.vehicle.supervisor.state


def idle_of(flight: Flight) -> int:
    vehicle = flight.sim.vehicle
    number = vehicle.parameter_number("powerDist.idleThrust").to_bytes(2, "little")
    answers = vehicle.receive(encode_packet(Packet(2, 1, number)), flight.clock.seconds())
    return int.from_bytes(answers[0].packet[4:], "little")


@pytest.mark.parametrize("time_constant_s", [0.02, 0.05, 0.1, 0.2, 0.3])
def test_a_brushless_vehicle_is_armed_driven_and_left_as_it_was_found(tmp_path: Path, time_constant_s: float) -> None:
    flight = Flight(tmp_path, time_constant_s=time_constant_s, platform="cf21bl")
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=2.0))
    flight.turn(for_s=8.0)

    assert failure is None
    assert (20000,) * 4 in [motors for _, motors in flight.motors]
    assert flight.motors[-1][1] == (0, 0, 0, 0)
    assert "flying" in states(run)
    assert state_of(flight) is SupervisorState.PASSED
    assert idle_of(flight) == 7000


@pytest.mark.parametrize("time_constant_s", [0.02, 0.1, 0.3])
def test_pauses_of_a_staircase_lock_no_brushless_vehicle(tmp_path: Path, time_constant_s: float) -> None:
    flight = Flight(tmp_path, time_constant_s=time_constant_s, platform="cf21bl")
    stairs = StaircasePlan(steps=(0, 4256, 9000, 60000), motors=ALL, hold_s=1.5, rest_s=1.0)
    run, failure = flight.record(
        [flight.commands(), flight.states()],
        lambda there: run_staircase(stairs, there["commands"], loop=flight.clock, tell=lambda text: None),
    )
    flight.turn(for_s=6.0)

    assert failure is None
    assert {motors for _, motors in flight.motors} >= {(step,) * 4 for step in stairs.steps}
    assert "locked" not in states(run)
    assert state_of(flight) is SupervisorState.PASSED


def test_a_sine_on_one_motor_leaves_the_others_of_a_brushless_vehicle_idling(tmp_path: Path) -> None:
    flight = Flight(tmp_path, time_constant_s=0.3, platform="cf21bl")
    sine = SineRequest(1, 20000, omega_of(4, 1000), 1000)
    run, failure = flight.record(
        [flight.crossings(), flight.states()],
        lambda there: play_sine(sine, there["crossings"], before_s=0.5, loop=flight.clock, tell=lambda text: None),
    )
    flight.turn(for_s=6.0)

    assert failure is None
    assert {motors[1:] for _, motors in flight.motors} == {(0, 0, 0), (7000, 7000, 7000)}
    assert max(motors[0] for _, motors in flight.motors) == 50000
    assert "locked" not in states(run)


@pytest.mark.parametrize(
    ("motors", "command", "allowed"),
    [(ALL, 4256, True), (ALL, 4255, False), ((1,), 7001, True), ((1,), 7000, False), ((1, 2, 3), 7000, False)],
)
def test_commands_that_would_hold_a_rotor_too_slow_are_refused(
    tmp_path: Path, motors: tuple[int, ...], command: int, allowed: bool
) -> None:
    flight = Flight(tmp_path, platform="cf21bl")
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, command, motors))

    if allowed:
        assert failure is None
    else:
        assert isinstance(failure, ConfigError)
        assert "slower than 500 rpm" in str(failure)
        assert not any(any(commands) for _, commands in flight.motors)


@pytest.mark.parametrize(("motor", "amplitude"), [(0, 25745), (1, 23000)])
def test_a_sine_whose_trough_is_too_slow_is_refused(tmp_path: Path, motor: int, amplitude: int) -> None:
    limits = Limits(idle_thrust=7000)
    with pytest.raises(ConfigError, match="slower than 500 rpm"):
        limits.check_sine(SineRequest(motor, amplitude, 0.1, 1000))
    limits.check_sine(SineRequest(motor, amplitude - 1, 0.1, 1000))


@pytest.mark.parametrize("firmware", ["app", "stock"])
@pytest.mark.parametrize(("command", "allowed"), [(20000, True), (20001, False)])
def test_the_limit_itself_is_allowed_and_one_more_never_leaves(
    tmp_path: Path, firmware: str, command: int, allowed: bool
) -> None:
    flight = Flight(tmp_path, firmware=firmware, limits=Limits(largest_command=20000))
    _, failure = flight.record([flight.commands()], holding(flight, command))

    assert (failure is None) is allowed
    assert max(max(motors) for _, motors in flight.motors) == (command if allowed else 0)


def test_a_brushless_vehicle_whose_rotor_is_blocked_is_reported_and_left_disarmed(tmp_path: Path) -> None:
    flight = Flight(tmp_path, stall_rpm=4000.0, platform="cf21bl")
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))
    flight.turn(for_s=4.0)

    assert isinstance(failure, DeviceError)
    assert "each rotor has to show 1000 to 3500 rpm" in str(failure)
    assert flight.motors[-1][1] == (0, 0, 0, 0)
    assert state_of(flight) is SupervisorState.PASSED


@BOTH
@pytest.mark.parametrize("after_s", [0.2, 0.5, 1.0, 1.5, 2.5])
def test_a_setpoint_that_a_closing_client_leaves_locks_nothing_with_the_app(
    tmp_path: Path, platform: str, after_s: float
) -> None:
    flight = Flight(tmp_path, platform=platform)
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))
    flight.turn(for_s=after_s)
    flight.sim.received(encode_packet(SETPOINT), CLIENT, flight.clock.seconds())
    flight.turn(for_s=8.0)

    assert failure is None
    assert state_of(flight) in (SupervisorState.READY, SupervisorState.PASSED)


@FIRMWARES
def test_a_setpoint_left_by_an_earlier_client_locks_nothing(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware)
    flight.sim.received(encode_packet(SETPOINT), CLIENT, flight.clock.seconds())
    flight.turn(for_s=4.0)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=4.0))
    flight.turn(for_s=8.0)

    assert failure is None
    assert "locked" not in states(run)
    assert state_of(flight) is SupervisorState.READY


@FIRMWARES
@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (CrazyflieFaults(tumble_after_s=2.0), "crashed"),
        (CrazyflieFaults(emergency_after_s=2.0), "locked"),
    ],
)
def test_a_state_in_which_motors_may_not_run_fails_the_run_by_its_name(
    tmp_path: Path, firmware: str, fault: CrazyflieFaults, name: str
) -> None:
    flight = Flight(tmp_path, firmware=firmware, faults=fault)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=10.0))

    assert isinstance(failure, DeviceError)
    assert f"is {name}" in str(failure)
    assert run.header.state == "failed"
    assert states(run)[-1] == name
    assert (run.header.devices["supervisor"].model_extra or {})["state_before"] == "ready"
    assert (run.header.devices["supervisor"].model_extra or {})["state_after"] == name
    assert flight.stopped_after(1.0 + 2.0) < 1.0


def test_motors_wait_for_a_vehicle_that_is_away_for_a_moment(tmp_path: Path) -> None:
    """A vehicle that arms itself refuses thrust for 120 to 160 ms, 30 s after it became ready."""
    flight = Flight(tmp_path)
    for late_s in (29.8, 30.1, 30.2, 30.3):
        flight = Flight(tmp_path, powered_for_s=100.0)
        flight.turn(for_s=late_s)
        _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))
        assert failure is None


@pytest.mark.parametrize("rest_s", [4.8, 4.9, 4.94, 4.97, 5.0, 5.03, 5.1])
def test_a_pause_that_ends_when_the_vehicle_disarms_itself_takes_no_motors_back(tmp_path: Path, rest_s: float) -> None:
    """The vehicle lands 2 s after its motors stop and disarms itself 3 s later, just when the next step may begin."""
    flight = Flight(tmp_path)
    stairs = StaircasePlan(steps=(10000, 20000, 30000), motors=ALL, hold_s=0.5, rest_s=rest_s)
    _, failure = flight.record(
        [flight.commands(), flight.states()],
        lambda there: run_staircase(stairs, there["commands"], loop=flight.clock, tell=lambda text: None),
    )

    assert failure is None
    starts = [motors for (_, before), (_, motors) in pairwise(flight.motors) if any(motors) and not any(before)]
    assert starts == [(step,) * 4 for step in stairs.steps]


def test_a_vehicle_that_somebody_disarms_in_a_run_is_named_so(tmp_path: Path) -> None:
    flight = Flight(tmp_path, platform="cf21bl")
    disarm = encode_packet(Packet(9, 1, b"\x01\x00"))
    flight.clock.callLater(1.5, lambda: flight.sim.received(disarm, CLIENT, flight.clock.seconds()))
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=6.0))

    assert isinstance(failure, DeviceError)
    assert "stopped its motors: it is " in str(failure)


@BOTH
def test_older_firmware_is_armed_and_watched_by_its_own_ways(tmp_path: Path, platform: str) -> None:
    flight = Flight(tmp_path, platform=platform, protocol=10)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=2.0))

    assert failure is None
    assert (20000,) * 4 in [motors for _, motors in flight.motors]
    assert "flying" in states(run)
    assert not [packet for packet in flight.link.sent if packet.port == 9]


@pytest.mark.parametrize(
    ("firmware", "fault"),
    [
        ("app", CrazyflieFaults(stop_misnumbered=True)),
        ("app", CrazyflieFaults(stop_late_s=60.0)),
        ("stock", CrazyflieFaults(stop_ignored=True)),
        ("stock", CrazyflieFaults(stop_misnumbered=True)),
        ("stock", CrazyflieFaults(stop_late_s=60.0)),
    ],
)
def test_a_stop_is_confirmed_by_its_own_answer_and_by_nothing_else(
    tmp_path: Path, firmware: str, fault: CrazyflieFaults
) -> None:
    flight = Flight(tmp_path, firmware=firmware, faults=fault)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert isinstance(failure, StopError)
    assert run.header.state == "failed"
    assert "stopped_in_s" not in (run.header.devices["commands"].model_extra or {})
    if firmware == "stock":
        assert MAY_BE_RUNNING in str(failure)


def test_rotors_that_may_idle_on_are_named_where_nobody_saw_them_disarmed(tmp_path: Path) -> None:
    flight = Flight(tmp_path, platform="cf21bl")

    async def unreported(there: Any) -> None:
        await holding(flight, 20000)(there)
        flight.link.loses.add((9, 0))

    _, failure = flight.record([flight.commands()], unreported)

    assert isinstance(failure, StopError)
    assert "was not seen disarmed: its rotors may idle" in str(failure)


def test_a_stop_that_is_answered_and_not_obeyed_is_confirmed_once_the_motors_stand(tmp_path: Path) -> None:
    """The app itself stops the motors half a second after the last keep-alive, and only then answers zeros."""
    flight = Flight(tmp_path, faults=CrazyflieFaults(stop_ignored=True))
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))
    stopped_s = flight.motors[-1][0]

    assert failure is None
    assert flight.motors[-1][1] == (0, 0, 0, 0)
    assert flight.clock.seconds() >= stopped_s
    assert (run.header.devices["commands"].model_extra or {})["stopped_in_s"] > 0.35


@FIRMWARES
def test_a_stop_that_is_answered_late_is_confirmed_late(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware, faults=CrazyflieFaults(stop_late_s=0.3))
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert failure is None
    assert (run.header.devices["commands"].model_extra or {})["stopped_in_s"] >= 0.3


@BOTH
@FIRMWARES
def test_every_run_with_motors_states_how_long_its_stop_took(tmp_path: Path, firmware: str, platform: str) -> None:
    flight = Flight(tmp_path, firmware=firmware, platform=platform)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert failure is None
    assert 0.0 < (run.header.devices["commands"].model_extra or {})["stopped_in_s"] < 0.6


def test_another_programs_stop_ends_ours_for_good(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    stop = Packet(12, 3, bytes(4))
    flight.clock.callLater(1.0, lambda: flight.sim.received(encode_packet(stop), CLIENT, flight.clock.seconds()))
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=5.0))

    assert isinstance(failure, DeviceError)
    assert "another program stopped the motors" in str(failure)
    assert flight.stopped_after(2.0) < 0.1


def test_a_program_that_drives_the_motors_keeps_a_second_one_out(tmp_path: Path) -> None:
    flight = Flight(tmp_path)
    other = Packet(12, 2, bytes(4) + b"\x99\x00\x00\x00")

    def again() -> None:
        flight.sim.received(encode_packet(other), CLIENT, flight.clock.seconds())
        flight.clock.callLater(0.1, again)

    again()
    flight.turn(for_s=0.5)
    run, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert isinstance(failure, DeviceError)
    assert "another program drives the motors" in str(failure)
    assert "stopped_in_s" not in (run.header.devices["commands"].model_extra or {})  # the other's motors keep running
    assert not any(any(motors) for _, motors in flight.motors)


def test_answers_to_another_programs_keep_alives_end_no_run(tmp_path: Path) -> None:
    flight = Flight(tmp_path)

    def again(number: int) -> None:
        other = Packet(12, 2, number.to_bytes(4, "little") + b"\x99\x00\x00\x00")
        flight.sim.received(encode_packet(other), CLIENT, flight.clock.seconds())
        flight.clock.callLater(0.1, again, number + 1)

    flight.clock.callLater(0.5, again, 0)
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=3.0))

    assert failure is None
    turned = [at_s for at_s, motors in flight.motors if any(motors)]
    assert flight.motors[-1][0] - turned[0] == pytest.approx(3.0, abs=0.2)


@FIRMWARES
def test_a_brushed_vehicle_that_was_disarmed_while_it_armed_itself_is_armed(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware)
    disarm = encode_packet(Packet(9, 1, b"\x01\x00"))
    flight.turn(for_s=0.5)
    for _ in range(30):  # late or repeated requests: one of them meets the state in which the vehicle arms itself
        flight.sim.received(disarm, CLIENT, flight.clock.seconds())
        flight.turn(for_s=0.01)
    flight.turn(for_s=2.0)
    assert state_of(flight) is SupervisorState.PASSED

    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert failure is None
    assert (20000,) * 4 in [motors for _, motors in flight.motors]


@BOTH
def test_an_answer_to_arming_that_is_lost_leaves_no_vehicle_disarmed(tmp_path: Path, platform: str) -> None:
    flight = Flight(tmp_path, platform=platform)
    flight.link.loses.add((9, 1))
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000))

    assert failure is None
    assert (20000,) * 4 in [motors for _, motors in flight.motors]


@FIRMWARES
def test_a_vehicle_that_ceases_to_report_its_state_fails_the_run(tmp_path: Path, firmware: str) -> None:
    flight = Flight(tmp_path, firmware=firmware)
    flight.clock.callLater(2.0, flight.link.loses.add, (9, 0))
    _, failure = flight.record([flight.commands(), flight.states()], holding(flight, 20000, for_s=6.0))

    assert isinstance(failure, DeviceError)
    assert "not reported its state for 1." in str(failure)
    assert flight.motors[-1][1] == (0, 0, 0, 0)
    assert flight.motors[-1][0] < 5.0


def test_a_vehicle_that_was_armed_is_ready_for_any_other_client(tmp_path: Path) -> None:
    flight = Flight(tmp_path, platform="cf21bl")
    flight.record([flight.commands(), flight.states()], holding(flight, 20000))
    flight.turn(for_s=4.0)
    flight.sim.received(encode_packet(Packet(9, 1, b"\x01\x01")), CLIENT, flight.clock.seconds())
    flight.turn(for_s=1.0)

    assert flight.supervisor.state is not None
    assert Bits.ARMED not in flight.supervisor.state.bits  # the state that was seen last
    assert state_of(flight) is SupervisorState.READY

"""Motors stop on every way out, within every limit, and whatever else drives them is named."""

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from cfid.errors import ConfigError, DeviceError, StopError
from cfid.motors.plan import StaircasePlan
from cfid.rig.motor_commands import hold
from cfid.rig.motors import Limits
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.sim.crazyflie_services import parameters
from cfid.sim.supervisor import SupervisorState
from cfid.wire.app import SineRequest, omega_of
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_DATA_CHANNEL, LOG_PORT, RESET_LOG, LogCommand, Packet
from cfid.wire.supervisor import SUPERVISOR_PORT, encode_arming
from tests.rig.flying import ALL, Flight, facts, flight_in, states
from tests.virtual_bench import Bench, bench_in

SETPOINT = Packet(3, 0, bytes(14))  # the stock library sends this when it closes
KINDS = pytest.mark.parametrize("firmware", ["app", "stock"])
BOTH = pytest.mark.parametrize("platform", ["cf2", "cf21bl"])
LONGEST_STOP_S = 0.7
BEGUN_S = 2.0  # of a recording, when a fault begins


def state_of(flight: Flight) -> SupervisorState:
    return flight.rig.crazyflie.vehicle.supervisor.state


def idle_of(flight: Flight) -> int:
    number = flight.rig.crazyflie.vehicle.parameter_number("powerDist.idleThrust").to_bytes(2, "little")
    answers = flight.rig.crazyflie.vehicle.receive(b"\x2d" + number, flight.hardware.seconds())
    return int.from_bytes(answers[0][1][4:], "little")


def turned(bench: Bench) -> bool:
    return any(any(motors) for _, motors in bench.history)


# Limits


@pytest.mark.parametrize(("motor", "amplitude"), [(0, 25745), (1, 23000)])
def test_a_sine_whose_trough_is_too_slow_is_refused(motor: int, amplitude: int) -> None:
    limits = Limits(idle_thrust=7000)
    with pytest.raises(ConfigError, match="slower than 500 rpm"):
        limits.check_sine(SineRequest(motor, amplitude, 0.1, 1000))
    limits.check_sine(SineRequest(motor, amplitude - 1, 0.1, 1000))


@pytest.mark.parametrize(
    ("motors", "command", "allowed"),
    [(ALL, 4256, True), (ALL, 4255, False), ((1,), 7001, True), ((1,), 7000, False), ((1, 2, 3), 7000, False)],
)
def test_commands_that_would_hold_a_rotor_too_slow_are_refused(
    tmp_path: Path, motors: tuple[int, ...], command: int, allowed: bool
) -> None:
    with flight_in(tmp_path, crazyflie={"platform": "cf21bl"}) as flight:
        _, failure = flight.hold(command, motors)
        assert failure is None if allowed else isinstance(failure, ConfigError)
        assert turned(flight) == allowed


@KINDS
@pytest.mark.parametrize(("command", "allowed"), [(20000, True), (20001, False)])
def test_the_limit_of_rig_toml_is_allowed_and_one_more_never_leaves(
    tmp_path: Path, firmware: str, command: int, allowed: bool
) -> None:
    with flight_in(tmp_path, largest_command=20000, crazyflie={"firmware": firmware}) as flight:
        sent = flight.packets()
        _, failure = flight.hold(command)
    assert failure is None if allowed else isinstance(failure, ConfigError)
    assert max(max(motors) for _, motors in flight.history) == (command if allowed else 0)
    assert any(command.to_bytes(2, "little") in packet.payload for packet in sent) == allowed


def test_a_sine_beyond_the_limit_never_leaves(tmp_path: Path) -> None:
    with flight_in(tmp_path, largest_command=45000) as flight:
        sent = flight.packets()
        request = SineRequest(1, 20000, omega_of(3, 500), 500)
        _, failure = flight.record([flight.ready.crossings()], flight.playing(request))
    assert isinstance(failure, ConfigError)
    assert not any(packet.port == 11 for packet in sent)
    assert not turned(flight)


# Ways out: the motors are off 0.7 s later (tests/rig/test_motor_commands.py has those that commands see)


def silence(flight: Flight) -> None:
    """Lose all of the supervisor's answers from now on."""
    flight.disturb(arriving=lambda packet: [] if packet[:2] == (SUPERVISOR_PORT, 0) else [packet])


class Fault(NamedTuple):
    """What happens while motors run, a word of the failure, the supervisor's last state, and its own delay."""

    act: Callable[[Flight], object]
    told: str
    state: str = "flying"
    own_delay_s: float = 0.0


FAULTS = {
    "tumble": Fault(lambda flight: flight.vehicle_suffers(tumble_after_s=0), "is crashed", "crashed", 0.3),
    "emergency stop": Fault(lambda flight: flight.vehicle_suffers(emergency_after_s=0), "is locked", "locked"),
    "restart": Fault(lambda flight: flight.vehicle_suffers(reboot_after_s=0), "", "ready"),
    "state not reported": Fault(silence, "not reported its state", own_delay_s=1.0),
    "log reset by another program": Fault(
        lambda flight: flight.send(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, RESET_LOG)), "not monitored", own_delay_s=0.5
    ),
}


@KINDS
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_of_the_vehicle_stops_the_motors_and_is_named(tmp_path: Path, firmware: str, name: str) -> None:
    fault = FAULTS[name]
    with flight_in(tmp_path, crazyflie={"firmware": firmware}) as flight:
        flight.hardware.at(BEGUN_S, fault.act, flight)
        began_s = flight.hardware.seconds() + BEGUN_S
        watched = [flight.ready.commands(), *flight.ready.watch()]
        run, failure = flight.record(watched, flight.holding(20000, for_s=20.0))
        flight.go_on(1.0)
    assert isinstance(failure, DeviceError)
    assert fault.told in str(failure)
    assert flight.stopped_after(began_s + fault.own_delay_s) < LONGEST_STOP_S
    assert run.header.state == "failed"
    assert states(run)[-1] == fault.state


@pytest.mark.parametrize(("firmware", "after_s"), [("app", 0.1), ("stock", 0.2), ("app", 0.3)])
def test_a_stop_is_confirmed_while_another_program_connects_and_deletes_all_blocks(
    tmp_path: Path, firmware: str, after_s: float
) -> None:
    with flight_in(tmp_path, crazyflie={"firmware": firmware}) as flight:
        reset = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, RESET_LOG)
        flight.hardware.at(2.0 + after_s, flight.send, reset)
        _, failure = flight.record([flight.ready.commands()], flight.holding(20000, for_s=2.0))
    assert failure is None
    assert not any(flight.motors)


@pytest.mark.parametrize(
    ("firmware", "stands_s", "ends"), [("app", 0.35, False), ("app", 1.5, True), ("stock", 1.5, False)]
)
def test_a_program_that_stands_still_does_not_take_that_for_the_vehicles_silence(
    tmp_path: Path, firmware: str, stands_s: float, ends: bool
) -> None:
    """The app stops its motors after 0.5 s; stock firmware goes on."""
    with flight_in(tmp_path, crazyflie={"firmware": firmware}) as flight:

        async def stand(there: Any) -> None:
            await hold(there["commands"], 30000, (1, 2), for_s=1.0, hardware=flight.hardware)
            flight.hardware.stand_still(stands_s)
            await hold(there["commands"], 30000, (1, 2), for_s=1.5, hardware=flight.hardware)

        _, failure = flight.record([flight.ready.commands(), flight.ready.usual_log()], stand)
    assert ("no keep-alive" in str(failure)) if ends else (failure is None)
    assert not any(flight.motors)


# The supervisor


@pytest.mark.parametrize("time_constant_s", [0.02, 0.3])
def test_pauses_of_a_staircase_lock_no_brushless_vehicle_which_is_left_as_it_was_found(
    tmp_path: Path, time_constant_s: float
) -> None:
    stairs = StaircasePlan(steps=(0, 4256, 9000, 60000), motors=ALL, hold_s=1.0, rest_s=0.8)
    rotors = {"time_constant_s": time_constant_s}
    with flight_in(tmp_path, crazyflie={"platform": "cf21bl"}, rotors=rotors) as flight:
        run, failure = flight.record([flight.ready.commands(), flight.ready.supervisor_log()], flight.climbing(stairs))
        flight.go_on(6.0)
        assert failure is None
        assert {motors for _, motors in flight.history} >= {(step,) * 4 for step in stairs.steps}
        assert "flying" in states(run)
        assert "locked" not in states(run)
        assert state_of(flight) is SupervisorState.PASSED
        assert idle_of(flight) == 7000
        flight.send(encode_arming(arm=True, protocol=12))  # it is ready for any other client
        flight.go_on(1.0)
        assert state_of(flight) is SupervisorState.READY


def test_a_brushless_vehicle_whose_rotor_is_blocked_is_reported_and_left_disarmed(tmp_path: Path) -> None:
    with flight_in(tmp_path, crazyflie={"platform": "cf21bl", "stall_rpm": 4000.0}) as flight:
        _, failure = flight.hold()
        flight.go_on(4.0)
        assert isinstance(failure, DeviceError)
        assert "blocked" in str(failure)
        assert not any(flight.motors)
        assert state_of(flight) is SupervisorState.PASSED


@pytest.mark.parametrize(("platform", "after_s"), [("cf2", 2.5), ("cf21bl", 0.2), ("cf21bl", 2.5)])
def test_a_setpoint_that_a_closing_client_leaves_locks_nothing_with_the_app(
    tmp_path: Path, platform: str, after_s: float
) -> None:
    with flight_in(tmp_path, crazyflie={"platform": platform}) as flight:
        _, failure = flight.hold()
        flight.go_on(after_s)
        flight.send(SETPOINT)
        flight.go_on(6.0)
        assert failure is None
        assert state_of(flight) in (SupervisorState.READY, SupervisorState.PASSED)


@pytest.mark.parametrize("late_s", [30.1, 30.3])
def test_motors_wait_for_a_vehicle_that_is_away_for_a_moment(tmp_path: Path, late_s: float) -> None:
    """A vehicle that arms itself refuses thrust for 120 to 160 ms, 30 s after it became ready."""
    with flight_in(tmp_path) as flight:
        flight.go_on(late_s)
        assert flight.hold(for_s=0.3)[1] is None
        assert turned(flight)


@pytest.mark.parametrize("rest_s", [4.94, 5.0])
def test_a_pause_that_ends_when_the_vehicle_disarms_itself_takes_no_motors_back(tmp_path: Path, rest_s: float) -> None:
    """The vehicle lands 2 s after its motors stop and disarms itself 3 s later, just when the next step may begin."""
    stairs = StaircasePlan(steps=(10000, 20000), motors=ALL, hold_s=0.5, rest_s=rest_s)
    with flight_in(tmp_path) as flight:
        _, failure = flight.record([flight.ready.commands(), flight.ready.supervisor_log()], flight.climbing(stairs))
    starts = [motors for (_, before), (_, motors) in pairwise(flight.history) if any(motors) and not any(before)]
    assert failure is None
    assert starts == [(step,) * 4 for step in stairs.steps]


@BOTH
def test_older_firmware_is_armed_and_watched_by_its_own_ways(tmp_path: Path, platform: str) -> None:
    with flight_in(tmp_path, faults={"protocol": 10}, crazyflie={"platform": platform}) as flight:
        sent = flight.packets()
        run, failure = flight.hold(for_s=2.0)
        again, failure_again = flight.hold(for_s=0.5)
    assert failure is failure_again is None
    assert (20000,) * 4 in [motors for _, motors in flight.history]
    assert "flying" in states(run)
    assert "flying" in states(again)
    assert not [packet for packet in sent if packet.port == SUPERVISOR_PORT]


@BOTH
def test_an_answer_to_arming_that_is_lost_leaves_no_vehicle_disarmed(tmp_path: Path, platform: str) -> None:
    with flight_in(tmp_path, crazyflie={"platform": platform}) as flight:
        flight.disturb(arriving=lambda packet: [] if packet[:2] == (SUPERVISOR_PORT, 1) else [packet])
        assert flight.hold()[1] is None
        assert (20000,) * 4 in [motors for _, motors in flight.history]


# Stops that are confirmed


@pytest.mark.parametrize(
    ("firmware", "fault"),
    [
        ("app", {"stop_misnumbered": True}),
        ("app", {"stop_late_s": 60.0}),
        ("stock", {"stop_ignored": True}),
        ("stock", {"stop_misnumbered": True}),
        ("stock", {"stop_late_s": 60.0}),
    ],
)
def test_a_stop_is_confirmed_by_its_own_answer_and_by_nothing_else(
    tmp_path: Path, firmware: str, fault: dict[str, Any]
) -> None:
    with flight_in(tmp_path, faults=fault, crazyflie={"firmware": firmware}) as flight:
        run, failure = flight.hold()
    assert isinstance(failure, StopError)
    assert run.header.state == "failed"
    assert "stopped_in_s" not in facts(run, "commands")
    assert (MAY_BE_RUNNING in str(failure)) == (firmware == "stock")


@pytest.mark.parametrize(
    ("firmware", "platform", "late_s", "at_most_s"),
    [("app", "cf2", 0.0, 0.6), ("stock", "cf2", 0.3, 2.0), ("app", "cf21bl", 0.3, 2.0), ("stock", "cf21bl", 0.0, 0.6)],
)
def test_a_run_states_how_long_its_stop_took_and_one_that_is_answered_late_is_confirmed_late(
    tmp_path: Path, firmware: str, platform: str, late_s: float, at_most_s: float
) -> None:
    faults = {"stop_late_s": late_s}
    with flight_in(tmp_path, faults=faults, crazyflie={"firmware": firmware, "platform": platform}) as flight:
        run, failure = flight.hold()
    assert failure is None
    assert late_s < facts(run, "commands")["stopped_in_s"] < at_most_s


def test_rotors_that_may_idle_on_are_named_where_nobody_saw_them_disarmed(tmp_path: Path) -> None:
    with flight_in(tmp_path, crazyflie={"platform": "cf21bl"}) as flight:

        async def unreported(there: Any) -> None:
            await hold(there["commands"], 20000, ALL, for_s=0.5, hardware=flight.hardware)
            silence(flight)

        _, failure = flight.record([flight.ready.commands()], unreported)
    assert isinstance(failure, StopError)
    assert MAY_BE_RUNNING in str(failure)
    assert "idle" in str(failure)


NO_ROWS: Callable[[Packet], bool] = lambda packet: packet[:2] == (LOG_PORT, LOG_DATA_CHANNEL)  # noqa: E731


def refusing(packet: Packet) -> list[Packet]:
    """Replace the answer to the creation of a block by one of a vehicle without memory for it."""
    if packet[:2] == (LOG_PORT, LOG_CONTROL_CHANNEL) and packet.payload[0] == LogCommand.CREATE:
        return [packet._replace(payload=packet.payload[:2] + b"\x0c")]
    return [packet]


@KINDS
@pytest.mark.parametrize("disturbed", [lambda packet: [] if NO_ROWS(packet) else [packet], refusing])
def test_a_log_that_says_nothing_confirms_no_stop(tmp_path: Path, firmware: str, disturbed: Any) -> None:
    """Version 0.2 counted every motor whose row did not come as a motor at zero."""
    with flight_in(tmp_path, crazyflie={"firmware": firmware}) as flight:
        flight.disturb(arriving=disturbed)
        _, failure = flight.hold(watched=False)
        assert isinstance(failure, StopError)
        assert MAY_BE_RUNNING in str(failure)
        assert not any(flight.motors)
    with bench_in(tmp_path, crazyflie={"firmware": firmware}) as bench:
        bench.disturb(arriving=disturbed)
        stop = bench.start("motors", "stop")
        assert stop.end() == 3
        assert MAY_BE_RUNNING in stop.err
        assert "motors stopped" not in stop.out


# Others who drive


def other_owner(flight: Flight, number: int = 0) -> None:
    flight.send(Packet(12, 2, number.to_bytes(4, "little") + b"\x99\x00\x00\x00"))
    flight.hardware.at(0.1, other_owner, flight, number + 1)


def test_a_program_that_drives_the_motors_keeps_a_second_one_out(tmp_path: Path) -> None:
    with flight_in(tmp_path) as flight:
        other_owner(flight)
        flight.go_on(0.5)
        run, failure = flight.hold()
    assert "another program drives the motors" in str(failure)
    assert "stopped_in_s" not in facts(run, "commands")  # the other's motors keep running
    assert not turned(flight)


VEHICLES: dict[str, dict[str, Any]] = {
    "app": {"firmware": "app"},
    "stock": {"firmware": "stock"},
    "brushless": {"platform": "cf21bl"},
}
HOLD = ("motors", "set", 30000, "--yes", "--for")
STAIRS = ("log", "thrust", "--motor", "1,2,3,4", "--from", 20000, "--to", 30000, "--step", 10000, "--yes")
SINE = ("log", "sine", "--motor", 1, "--hz", 2.5, "--for", 40, "--yes")
QUICK = ("--hold", 1, "--rest", 1)
COMMANDS = pytest.mark.parametrize("words", [(*HOLD, 1), (*STAIRS, *QUICK)], ids=["set", "thrust"])
THRUST = 25000
ALIVE, OTHERS_THRUST = (  # of another owner
    Packet(12, 2, bytes(4) + b"\x4d\0\0\0"),
    Packet(10, 0, struct.pack("<Hi", 30000, 1) + b"\x4d\0\0\0"),
)


def fly(bench: Bench, thrust: int = 0, every_s: float = 0.05) -> None:
    """Stream setpoints as a second client of the vehicle does."""
    bench.send(Packet(3, 0, struct.pack("<fffH", 0, 0, 0, thrust)))
    bench.hardware.at(every_s, fly, bench, THRUST, every_s)


def override(bench: Bench, *commands: int) -> None:
    """Set the parameters motorPowerSet as another program does."""
    names = [parameter.name for parameter in parameters(rpm_deck=False)]
    values = [(f"m{motor}", struct.pack("<H", command)) for motor, command in enumerate(commands, 1)]
    for name, value in (*values, ("enable", b"\1")):
        bench.send(Packet(2, 2, struct.pack("<H", names.index(f"motorPowerSet.{name}")) + value))


def supervisor_line(bench: Bench) -> dict[str, str]:
    """Return the answer of `rig check` about the supervisor."""
    check = bench.start("rig", "check", "--json")
    check.end()
    answers = json.loads(check.out)["devices"]["crazyflie"]
    return next(dict(answer) for answer in answers if answer["asked"] == "supervisor")


@pytest.mark.parametrize(
    ("vehicle", "words"), [("app", (*HOLD, 1)), ("stock", (*STAIRS, *QUICK)), ("brushless", (*STAIRS, *QUICK))]
)
def test_a_command_does_not_start_motors_while_another_client_flies_the_vehicle(
    tmp_path: Path, vehicle: str, words: tuple[object, ...]
) -> None:
    with bench_in(tmp_path, crazyflie=VEHICLES[vehicle]) as bench:
        bench.send(encode_arming(arm=True, protocol=12))
        bench.hardware.pause(0.6)
        fly(bench)
        bench.hardware.pause(1.0)
        driven = bench.motors
        assert max(driven) >= THRUST
        refused = bench.start(*words)
        assert refused.end() == 3, refused.out
        assert "setpoints" in refused.err
        assert {motors for _, motors in bench.history} <= {(0,) * 4, (7000,) * 4, driven}
        answer = supervisor_line(bench)
        assert (answer["state"], "setpoints" in answer["advice"]) == ("fault", True)
        assert not list(bench.folder.glob("runs/*"))


@KINDS  # a stop disarms a Brushless, which ends its setpoints' effect
@COMMANDS
def test_a_command_whose_motors_another_client_drives_does_not_confirm_their_stop(
    tmp_path: Path, firmware: str, words: tuple[object, ...]
) -> None:
    """With the app, whose null setpoints compete with the client's, motors run in pulses after the stop."""
    with bench_in(tmp_path, crazyflie={"firmware": firmware}) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run()
        fly(bench)
        assert pilot.end() == 3, pilot.out
        assert MAY_BE_RUNNING in pilot.err
        assert "setpoints" in pilot.err
        assert "motors stopped" not in pilot.out


@pytest.mark.parametrize("later_s", [0.0, 0.009])
def test_pulses_between_two_null_setpoints_of_the_app_are_motors_that_run(tmp_path: Path, later_s: float) -> None:
    """On real firmware, 11 of 20 stops were confirmed beside setpoints every 0.1 s, 8 ms before the null setpoints."""
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD, 1)
        pilot.wait_until_motors_run(0.3 + later_s)
        fly(bench, every_s=0.1)
        assert pilot.end() == 3, pilot.out
        assert MAY_BE_RUNNING in pilot.err
        assert bench.start("motors", "stop").end() == 3


def test_a_link_that_fails_for_a_moment_does_not_keep_the_stop_from_stock_firmware(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start(*HOLD, 20)
        pilot.wait_until_motors_run()
        bench.vehicle_suffers(closed_after_s=0)
        bench.hardware.at(0.3, bench.vehicle_suffers)
        assert pilot.end() == 3
        assert not any(bench.motors)
        assert MAY_BE_RUNNING not in pilot.err


@pytest.mark.parametrize("words", [("log", "gyro", "--axis", "x", "--for", 1), ("log", "ping", "--count", 5)])
def test_a_measurement_of_a_vehicle_at_rest_is_refused_while_its_motors_turn(
    tmp_path: Path, words: tuple[object, ...]
) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        override(bench, 22000, 0, 0, 0)
        refused = bench.start(*words)
        assert refused.end() == 3
        assert "motorPowerSet" in refused.err
        assert not list(bench.folder.glob("runs/*"))


def test_motors_that_turn_in_a_runs_pause_end_it(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start(*STAIRS, "--hold", 1, "--rest", 15)
        pilot.wait_until_motors_run()
        pilot.wait_until(lambda: not any(bench.motors), "the pause")
        fly(bench)
        began_s = bench.hardware.seconds()
        assert pilot.end() == 3
        assert bench.hardware.seconds() - began_s < 10
        assert bench.run().header.state == "failed"


@pytest.mark.parametrize(
    ("vehicle", "commands"),
    [("app", (22000, 0, 0, 0)), ("stock", (0, 0, 0, 0)), ("stock", (22000, 0, 0, 0)), ("brushless", (0, 0, 0, 0))],
)
def test_overriding_parameters_are_named_before_a_motor_starts_and_a_stop_clears_them(
    tmp_path: Path, vehicle: str, commands: tuple[int, ...]
) -> None:
    """Those of a killed command too: version 0.2 recorded another motor beside it, and took its bias from it."""
    with bench_in(tmp_path, crazyflie=VEHICLES[vehicle]) as bench:
        override(bench, *commands)
        answer = supervisor_line(bench)
        assert (answer["state"], "motorPowerSet" in answer["advice"]) == ("fault", True)
        for words in ((*HOLD, 1), (*STAIRS, *QUICK)):
            refused = bench.start(*words)
            assert refused.end() == 3, refused.out
            assert "motorPowerSet" in refused.err
        assert {motors for _, motors in bench.history} <= {(0,) * 4, commands}
        assert bench.start("motors", "stop").end() == 0
        assert not any(bench.motors)
        assert supervisor_line(bench)["state"] == "ok"


@pytest.mark.parametrize(
    ("vehicle", "words", "commands"),
    [
        *((vehicle, (*HOLD, 60), (0, 0, 0, 0)) for vehicle in VEHICLES),
        ("stock", (*HOLD, 60), (22000, 0, 0, 0)),
        ("app", SINE, (0, 22000, 0, 0)),
    ],
)
def test_overriding_parameters_end_a_command_that_drives_the_motors(
    tmp_path: Path, vehicle: str, words: tuple[object, ...], commands: tuple[int, ...]
) -> None:
    with bench_in(tmp_path, crazyflie=VEHICLES[vehicle]) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run(0.5)
        override(bench, *commands)
        assert pilot.end() == 3
        assert "motorPowerSet" in pilot.err
        assert not any(bench.motors)


@contextmanager
def other_ports(folder: Path) -> Iterator[Bench]:
    """Open a bench whose rig.toml states other ports than the vehicle's app has, on which somebody drives motor 2."""
    with bench_in(folder) as bench:
        rig = bench.folder / "rig.toml"
        rig.write_text(rig.read_text() + "thrust_port = 1\nsine_port = 6\nping_port = 14\n")
        for packet in (ALIVE, OTHERS_THRUST):
            bench.send(packet)
        yield bench


@pytest.mark.parametrize("lost", [0, 2])
def test_a_motor_that_an_app_on_other_ports_drives_is_seen_whichever_deletion_is_lost(
    tmp_path: Path, lost: int
) -> None:
    """Version 0.2 read motor 1 in place of motor 2 when one request to delete a block was lost, and exited with 0."""
    left = [True] * lost

    def passes(packet: Packet) -> bool:
        is_deletion = packet[:2] == (LOG_PORT, LOG_CONTROL_CHANNEL) and packet.payload[0] == LogCommand.DELETE
        return not (is_deletion and left and left.pop())

    with other_ports(tmp_path) as bench:
        bench.send_often(0.02, ALIVE, OTHERS_THRUST)
        bench.disturb(leaving=passes)
        stop = bench.start("motors", "stop")
        assert stop.end() == 3, stop.out
        assert MAY_BE_RUNNING in stop.err
        assert "30000" in stop.err
        assert bench.motors[1] == 30000

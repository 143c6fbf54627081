"""The simulated vehicle's supervisor: clients that misbehave, limits that no trace shows, and faults at a stop."""

import struct

import pytest

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.faults import CrazyflieFaults
from cfid.sim.propulsion import STILL
from cfid.sim.supervisor import SupervisorState
from cfid.wire.app import (
    ALL_MOTORS_THRUST,
    AppPorts,
    PingChannel,
    ThrustChannel,
    ThrustRequest,
    decode_state,
    encode_alive,
    encode_thrust,
)
from tests.sim import protocol_1
from tests.sim.vehicle import Bench

PORTS = AppPorts()
BRUSHLESS = CrazyflieTruth(platform="cf21bl")
ARM, SETPOINT = b"\1\1", bytes(14)
RUNNING = (20000,) * 4


def state(bench: Bench) -> SupervisorState:
    return bench.vehicle.supervisor.state


def word(bench: Bench) -> int:
    return int(struct.unpack("<H", bench.ask(9, 0, b"\x0c")[1:])[0])


def run(bench: Bench, *, for_s: float) -> None:
    """Run all motors through the app, then stop them."""
    for _ in range(round(for_s / 0.1)):
        bench.keep_alive()
        bench.say(PORTS.thrust, ThrustChannel.SET, encode_thrust(ThrustRequest(RUNNING[0], ALL_MOTORS_THRUST)))
        bench.wait(0.1)
    bench.say(PORTS.ping, PingChannel.STOP, encode_alive(1))


# Mistakes of a client


def test_a_brushless_without_idle_thrust_never_gets_ready_until_it_is_given_back() -> None:
    bench = Bench(BRUSHLESS)
    bench.set("powerDist.idleThrust", 0)
    for _ in range(2):
        assert bench.ask(9, 1, ARM) == b"\x81\1\1"
        bench.wait(0.1)
        assert state(bench) is SupervisorState.ARMING
        bench.wait(2.1)
        assert state(bench) is SupervisorState.PASSED
        assert bench.motors == STILL
    bench.set("powerDist.idleThrust", 7000)
    bench.say(9, 1, ARM)
    bench.wait(0.5)
    assert state(bench) is SupervisorState.READY


@pytest.mark.parametrize("closes_after_s", [0.1, 1.0, 1.4])
def test_a_setpoint_left_soon_after_the_last_thrust_locks_the_vehicle_with_protocol_1_alone(
    closes_after_s: float,
) -> None:
    ends = []
    for load_app in (protocol_1.load_core, load_core):
        bench = Bench(load_app=load_app)
        run(bench, for_s=0.5)
        bench.wait(closes_after_s)
        bench.say(3, 0, SETPOINT)
        bench.wait(4.0)
        ends.append((state(bench) is SupervisorState.LOCKED, bool(word(bench) & 0x40)))
    assert ends == [(True, True), (False, False)]


def test_on_stock_firmware_an_old_setpoint_locks_the_vehicle_as_soon_as_motors_run_and_they_run_on() -> None:
    bench = Bench(CrazyflieTruth(firmware="stock"))
    bench.say(3, 0, SETPOINT)
    bench.wait(10.0)
    assert word(bench) == 0x20E  # nothing shows this in advance
    bench.drive(RUNNING)
    bench.wait(0.2)
    assert word(bench) == 0x244
    assert bench.motors == RUNNING


# Limits


def test_time_limits_are_parameters() -> None:
    bench = Bench(load_app=load_core)
    bench.set("supervisor.prefltTimeout", 500)
    away = [state(bench)]
    for _ in range(100):
        bench.wait(0.02)
        away.append(state(bench))
    assert away.count(SupervisorState.READY) < len(away) - 6
    bench.set("supervisor.prefltTimeout", 30000)
    bench.set("supervisor.landedTimeout", 200)
    run(bench, for_s=0.3)
    bench.wait(2.1)
    assert state(bench) is SupervisorState.LANDED
    bench.wait(0.28)
    assert state(bench) is not SupervisorState.LANDED


def test_the_spin_up_has_its_limit_too_and_slow_rotors_miss_it() -> None:
    bench = Bench(BRUSHLESS)
    bench.set("supervisor.spinupTimeout", 100)
    bench.say(9, 1, ARM)
    bench.wait(0.4)
    assert state(bench) is SupervisorState.PASSED


def test_on_its_side_it_tumbles_after_a_second_and_unseen_where_that_is_not_checked() -> None:
    for checked in (1, 0):
        bench = Bench(faults=CrazyflieFaults(tumble_after_s=0.0, tumble_for_s=3.0, tumble_deg=90))
        bench.set("supervisor.tmblChckEn", checked)
        bench.wait(0.9)
        assert word(bench) == 0x20E
        bench.wait(0.3)
        assert word(bench) == (0x224 if checked else 0x20E)
        bench.wait(2.2)
        assert word(bench) == 0x20E


def test_brushed_motors_have_no_idle_thrust_whatever_the_parameter_says() -> None:
    bench = Bench(load_app=load_core)
    bench.set("powerDist.idleThrust", 7000)
    run(bench, for_s=0.2)
    bench.wait(0.1)
    assert bench.motors == STILL


def test_at_rest_a_vehicle_goes_through_the_same_states_however_seldom_one_looks() -> None:
    seldom, often = Bench(), Bench()
    for bench, step_s in ((seldom, 95.0), (often, 0.5)):
        for _ in range(round(95.0 / step_s)):
            bench.wait(step_s)
    assert vars(seldom.vehicle.supervisor).keys() == vars(often.vehicle.supervisor).keys()
    assert (state(seldom), word(seldom)) == (state(often), word(often))


def test_a_memory_that_is_not_there_ends_the_vehicle_until_it_is_switched_on_again() -> None:
    bench = Bench()
    bench.drive(RUNNING)
    bench.wait(0.1)
    assert bench.ask(4, 0, b"\2\1")[:3] == b"\2\1\x15"
    assert bench.ask(4, 1, b"\1\x10\0\0\0\4") == b"\1\x10\0\0\0\0\x10\x11\x12\x13"
    assert bench.say(4, 0, b"\2\2") == []
    assert bench.motors == STILL
    bench.wait(1.0)
    assert bench.say(15, 0, b"there?") == []
    bench.vehicle.restart(1000.0 + bench.now_s)
    bench.wait(1.2)
    assert bench.ask(15, 0, b"there?") == b"there?"


# Faults at a stop


def test_a_stop_can_be_answered_and_ignored() -> None:
    bench = Bench(load_app=load_core, faults=CrazyflieFaults(stop_ignored=True))
    run(bench, for_s=0.3)
    (answer,) = bench.say(PORTS.ping, PingChannel.STOP, encode_alive(77))
    found = decode_state(answer[1:])
    assert found is not None
    assert (found.number, found.commands) == (77, RUNNING)
    bench.wait(0.2)
    assert bench.motors == RUNNING


def test_so_can_the_end_of_motor_power_set() -> None:
    bench = Bench(CrazyflieTruth(firmware="stock"), faults=CrazyflieFaults(stop_ignored=True))
    bench.drive(RUNNING)
    bench.set("motorPowerSet.enable", 0)
    bench.wait(0.1)
    assert bench.motors == RUNNING
    assert bench.ask(2, 1, b"\0\0") == b"\0\0\0\1"


def test_a_stop_can_be_answered_late_while_other_answers_are_not() -> None:
    bench = Bench(load_app=load_core, faults=CrazyflieFaults(stop_late_s=0.3))
    assert bench.say(PORTS.ping, PingChannel.STOP, encode_alive(5)) == []
    assert bench.say(15, 0, b"there?")
    ((came_s, answer),) = bench.wait(1.0)
    assert came_s == pytest.approx(0.3)
    assert answer[1:5] == encode_alive(5)


def test_a_stop_can_be_answered_with_another_number() -> None:
    bench = Bench(load_app=load_core, faults=CrazyflieFaults(stop_misnumbered=True))
    assert bench.ask(PORTS.ping, PingChannel.STOP, encode_alive(5))[:4] == encode_alive(6)
    assert bench.ask(PORTS.ping, PingChannel.ALIVE, encode_alive(7))[:4] == encode_alive(7)

"""The simulated vehicle's supervisor: clients that misbehave, limits that no trace shows, and faults at a stop."""

import struct

import pytest

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import CrazyflieTruth
from cfid.sim.propulsion import STILL
from cfid.sim.supervisor import SupervisorState
from cfid.wire.app import (
    ALL_MOTORS_THRUST,
    AppPorts,
    PingChannel,
    ThrustChannel,
    ThrustRequest,
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


# Limits


# Faults at a stop

"""The simulated Crazyflie on a clock that is set by hand: recorded setpoints, any bytes, and any pace of looks."""

import struct
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import USUAL_PORTS, Crazyflie, CrazyflieTruth, Leaving
from cfid.sim.crazyflie_services import parameters
from cfid.sim.faults import SOUND_CRAZYFLIE, CrazyflieFaults
from cfid.sim.link import Radio, RadioTruth, VehicleLink
from cfid.sim.propulsion import STILL, BatteryTruth, Four, Propulsion, RotorTruth
from cfid.wire.crtp import Packet, encode_packet

OPENED_S = 1000.0
CLIENT, OTHER_CLIENT = ("127.0.0.1", 1000), ("127.0.0.1", 1001)
LOCKED = b"\x44\2"
# A block of voltage and command of motor 1 each 3 ms, and motorPowerSet of motor 1 at 30000.
REQUESTS = (
    b"\x5d\x06\x01\x77\x00\x00\x22\x11\x00",
    b"\x5d\x08\x01\x03\x00",
    b"\x2f\x00motorPowerSet\x00m1\x00\x09\x30\x75",
    b"\x2f\x00motorPowerSet\x00enable\x00\x08\x01",
)


class Bench:
    """A vehicle, its client and a clock; times are seconds since the vehicle was opened."""

    def __init__(
        self,
        firmware: Literal["app", "stock"] = "stock",
        *,
        radio: RadioTruth | None = None,
        battery: BatteryTruth | None = None,
        faults: CrazyflieFaults = SOUND_CRAZYFLIE,
    ) -> None:
        rotor_rng, radio_rng = np.random.default_rng(5).spawn(2)
        self.now_s = 0.0
        self.changes: list[Four] = []
        propulsion = Propulsion(RotorTruth(), battery or BatteryTruth(), rng=rotor_rng, begin_s=OPENED_S)
        self.vehicle = Crazyflie(
            CrazyflieTruth(firmware=firmware),
            propulsion,
            load_app=load_core,
            opened_s=OPENED_S,
            ports=USUAL_PORTS,
            on_motors=lambda _, motors: self.changes.append(motors),
        )
        waves = Radio(radio or RadioTruth(latency_s=0.0, jitter_s=0.0), radio_rng)
        self.link = VehicleLink(self.vehicle, propulsion, waves, faults, ping_port=USUAL_PORTS.ping, opened_s=OPENED_S)

    def say(self, port: int, channel: int, payload: bytes, *, client: tuple[str, int] = CLIENT) -> list[bytes]:
        """Send a packet now, and return the packets that come back at once."""
        self.link.received(encode_packet(Packet(port, channel, payload)), client, OPENED_S + self.now_s)
        return [packet for packet, _ in self.link.due(OPENED_S + self.now_s)]

    def wait(self, for_s: float) -> None:
        """Let time pass as a server would."""
        end_s = self.now_s + for_s
        while self.now_s < end_s:
            next_s = self.link.next_s(OPENED_S + self.now_s)
            self.now_s = end_s if next_s is None else min(next_s - OPENED_S, end_s)
            self.link.due(OPENED_S + self.now_s)

    def set(self, name: str, value: int) -> None:
        """Set a parameter."""
        names = [parameter.name for parameter in parameters(rpm_deck=False)]
        kind = parameters(rpm_deck=False)[names.index(name)].kind
        self.say(2, 2, struct.pack("<H" + kind, names.index(name), value))


@pytest.mark.parametrize(("firmware", "command"), [("stock", 29678), ("app", 25000)])  # recorded from the firmware
def test_a_clients_setpoints_drive_the_motors_while_nothing_overrides_them(
    firmware: Literal["stock", "app"], command: int
) -> None:
    bench = Bench(firmware, battery=BatteryTruth(volts=4.0))
    for thrust in (25000, 0, 25000):  # the first one counts for nothing: no setpoint without thrust came before it
        bench.say(3, 0, struct.pack("<fffH", 0, 0, 0, thrust), client=OTHER_CLIENT)
        bench.wait(0.1)
    assert bench.changes == [pytest.approx((command,) * 4, abs=256)]
    bench.set("motorPowerSet.m1", 22000)
    bench.set("motorPowerSet.enable", 1)
    bench.wait(0.1)
    assert bench.changes[-1] == (22000, 0, 0, 0)
    bench.set("motorPowerSet.enable", 0)
    bench.wait(0.1)
    assert bench.changes[-1] == pytest.approx((command,) * 4, abs=256)
    bench.wait(2.5)
    assert bench.changes[-1] == STILL
    assert bench.say(9, 0, b"\x0c")[0][2:] == LOCKED  # by its old setpoint


def test_catching_up_is_the_same_as_going_along() -> None:
    def heard(steps: list[float]) -> list[Leaving]:
        bench = Bench(battery=BatteryTruth(kind="lipo"))
        for request in REQUESTS:
            bench.vehicle.receive(request, OPENED_S)
        return [leaving for step_s in steps for leaving in bench.vehicle.advance(OPENED_S + step_s)]

    assert len(heard([1.5])) == 500
    assert heard([1.5]) == heard([k / 1700 for k in range(1, 2551)])


@settings(max_examples=15)
@given(
    steps_s=st.lists(st.floats(0, 0.05), min_size=1, max_size=30),
    faults=st.builds(
        CrazyflieFaults,
        drop_every=st.integers(0, 3),
        tumble_after_s=st.none() | st.floats(0, 0.5),
        reboot_after_s=st.none() | st.floats(0, 0.5),
        silent_after_s=st.none() | st.floats(0, 0.5),
    ),
)
@example(steps_s=[0.046875], faults=CrazyflieFaults(reboot_after_s=0.03260903043399844))
def test_how_often_the_server_looks_changes_nothing(steps_s: list[float], faults: CrazyflieFaults) -> None:
    def heard(looks_s: list[float]) -> list[bytes]:
        bench = Bench(faults=faults, radio=RadioTruth(latency_s=0.01, jitter_s=0.005))
        for request in REQUESTS:
            bench.link.received(request, CLIENT, OPENED_S)
        return [packet for look_s in [*looks_s, 2.0] for packet, _ in bench.link.due(OPENED_S + look_s)]

    assert heard([]) == heard(list(np.cumsum(steps_s)))


BYTES = st.binary(max_size=32)
BEGUN = st.tuples(st.sampled_from([0x2E, 0x5D, 0xAC, 0xBC]), st.binary(max_size=14))  # parameters, log, and the app


@given(datagrams=st.lists(st.tuples(st.integers(0, 255), BYTES) | BEGUN, max_size=20), app=st.booleans())
def test_no_datagram_whatever_its_bytes_upsets_it(datagrams: list[tuple[int, bytes]], app: bool) -> None:
    bench = Bench("app" if app else "stock")
    for header, payload in datagrams:
        for _, packet in bench.vehicle.receive(bytes([header]) + payload, OPENED_S + bench.now_s):
            assert 1 <= len(packet) <= 31
        bench.wait(0.003)
    assert all(0 <= command <= 65535 for motors in bench.changes for command in motors)

"""A simulated Crazyflie for tests, and a minimal app that runs on it."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from cfid.sim.app_core import PING, THRUST, App, Orders, Seen, Sent
from cfid.sim.crazyflie import USUAL_PORTS, Crazyflie, CrazyflieTruth
from cfid.sim.crazyflie_services import parameters
from cfid.sim.faults import SOUND_CRAZYFLIE, CrazyflieFaults
from cfid.sim.link import Radio, RadioTruth, VehicleLink
from cfid.sim.propulsion import BRUSHLESS, STILL, BatteryTruth, Four, Propulsion, RotorTruth
from cfid.wire.app import AppPorts, PingChannel, ThrustChannel
from cfid.wire.crtp import Packet, encode_packet

OPENED_S = 1000.0
AT_ONCE = RadioTruth(latency_s=0.0, jitter_s=0.0)
SUPPLY = BatteryTruth()
WITH_APP = CrazyflieTruth()
CLIENT, OTHER_CLIENT = ("127.0.0.1", 1000), ("127.0.0.1", 1001)


class LittleApp(App):
    """An app that obeys commands for all motors until 0.5 s after the last keep-alive, here any packet to ping."""

    def __init__(self) -> None:
        self.commands, self.kept_us, self.outbox = STILL, -1_000_000, list[Sent]()

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        command = int.from_bytes(payload[:2], "little") if len(payload) == 6 else None
        if service == PING:
            self.kept_us = now_us
        if service == THRUST and command is not None:
            self.commands = (command,) * 4
            self.outbox.append((THRUST, ThrustChannel.ANSWER, payload))

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        alive = self.alive(now_us=now_us)
        if not vehicle.can_fly or not alive:
            self.commands = STILL
        return Orders(commands=self.commands, holds=True, feeds=alive)

    def sent(self) -> list[Sent]:
        sent, self.outbox = self.outbox, []
        return sent

    def alive(self, *, now_us: int) -> bool:
        return now_us - self.kept_us < 500_000


class Bench:
    """A vehicle, its client and a clock that is set by hand; times are seconds since the vehicle was opened."""

    def __init__(
        self,
        truth: CrazyflieTruth = WITH_APP,
        *,
        radio: RadioTruth = AT_ONCE,
        battery: BatteryTruth = SUPPLY,
        faults: CrazyflieFaults = SOUND_CRAZYFLIE,
        ports: AppPorts = USUAL_PORTS,
        load_app: Callable[[], App] = LittleApp,
    ) -> None:
        rotor_rng, radio_rng = np.random.default_rng(5).spawn(2)
        self.now_s = 0.0
        self.changes: list[tuple[float, Four]] = []
        rotors = RotorTruth(**BRUSHLESS) if truth.brushless else RotorTruth()
        self.propulsion = Propulsion(rotors, battery, rng=rotor_rng, begin_s=OPENED_S)
        self.vehicle = Crazyflie(
            truth,
            self.propulsion,
            load_app=load_app,
            opened_s=OPENED_S,
            ports=ports,
            on_motors=lambda time_s, motors: self.changes.append((time_s - OPENED_S, motors)),
        )
        self.faulty = VehicleLink(
            self.vehicle,
            self.propulsion,
            Radio(radio, radio_rng),
            faults,
            ping_port=ports.ping,
            opened_s=OPENED_S,
        )

    @property
    def motors(self) -> Four:
        return self.faulty.motors

    def say(self, port: int, channel: int, payload: bytes, *, client: tuple[str, int] = CLIENT) -> list[bytes]:
        """Send a packet now and return the packets that come back at once."""
        return [packet for packet, _ in self.say_and_hear(port, channel, payload, client=client)]

    def say_and_hear(
        self, port: int, channel: int, payload: bytes, *, client: tuple[str, int] = CLIENT
    ) -> list[tuple[bytes, tuple[str, int]]]:
        self.faulty.received(encode_packet(Packet(port, channel, payload)), client, OPENED_S + self.now_s)
        return self.faulty.due(OPENED_S + self.now_s)

    def ask(self, port: int, channel: int, payload: bytes) -> bytes:
        """Return the payload of the only answer."""
        (answer,) = self.say(port, channel, payload)
        assert (answer[0] >> 4, answer[0] & 3) == (port, channel)
        return answer[1:]

    def wait(self, for_s: float) -> list[tuple[float, bytes]]:
        """Let time pass as a server would; return the packets that came, and when."""
        end_s = self.now_s + for_s
        came = []
        while True:
            next_s = self.faulty.next_s(OPENED_S + self.now_s)
            self.now_s = end_s if next_s is None else min(next_s - OPENED_S, end_s)
            came += [(self.now_s, packet) for packet, _ in self.faulty.due(OPENED_S + self.now_s)]
            if self.now_s >= end_s:
                return came

    def set(self, name: str, value: float) -> None:
        """Set a parameter and check that the vehicle confirms the value."""
        names = [parameter.name for parameter in parameters(rpm_deck=False)]
        number = names.index(name)
        payload = struct.pack("<H" + parameters(rpm_deck=False)[number].kind, number, value)
        assert self.ask(2, 2, payload) == payload

    def drive(self, commands: Four, *, enable: int = 1) -> None:
        """Drive the motors with motorPowerSet."""
        for motor, command in enumerate(commands, 1):
            self.set(f"motorPowerSet.m{motor}", command)
        self.set("motorPowerSet.enable", enable)

    def log(self, *names: str, period_ms: int, block: int = 7, kinds: str | None = None) -> list[bytes]:
        """Create a block of variables and start it; return both answers."""
        codes = {kind: code for code, kind in enumerate("BHIbhife", 1)}
        entries = b"".join(
            struct.pack("<BH", codes[kind], self.table()[name][0])
            for name, kind in zip(names, kinds or [self.table()[name][1] for name in names], strict=True)
        )
        created = self.ask(5, 1, bytes([6, block]) + entries)
        return [created, self.ask(5, 1, struct.pack("<BBH", 8, block, period_ms))]

    def table(self) -> dict[str, tuple[int, str]]:
        """Read the table of log variables over the link: number and kind by name."""
        count = struct.unpack("<H", self.ask(5, 0, b"\3")[1:3])[0]
        found = {}
        for number in range(count):
            answer = self.ask(5, 0, struct.pack("<BH", 2, number))
            group, name, _ = answer[4:].split(b"\0")
            found[f"{group.decode()}.{name.decode()}"] = (number, "BHIbhife"[answer[3] - 1])
        return found

    def keep_alive(self) -> None:
        self.say(USUAL_PORTS.ping, PingChannel.ALIVE, b"\0\0\0\0")


def rows_of(
    packets: list[tuple[float, bytes]], layout: str, *, block: int = 7
) -> list[tuple[float, int, tuple[Any, ...]]]:
    """Return time, stamp in milliseconds and values of the rows of a log block."""
    return [
        (time_s, int.from_bytes(packet[2:5], "little"), struct.unpack("<" + layout, packet[5:]))
        for time_s, packet in packets
        if packet[:2] == bytes([0x52, block])
    ]

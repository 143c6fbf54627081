"""Traces of the firmware's behaviour, and their replay: a simulated vehicle receives the same packets in virtual time.

The traces' README describes how they were made. Times here are milliseconds of the recording computer's clock, which
also timed the recorded stabilizer's loop. The ticks of the operating system lagged behind this clock where the computer
was busy. The simulated vehicle counts the same ticks: those that a trace lists, and a straight line between them.
"""

import json
import math
import struct
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import Crazyflie, CrazyflieTruth, Leaving, variables
from cfid.sim.crazyflie_services import parameters
from cfid.sim.propulsion import BRUSHLESS, STILL, BatteryTruth, Propulsion, RotorTruth
from cfid.sim.supervisor import UPDATE_STEPS
from cfid.wire.app import AppPorts
from cfid.wire.crtp import Packet, decode_packet, encode_packet

Line = dict[str, Any]
Change = tuple[float, Any]  # a time, and the value from then on

ON_S = 1000.0  # the first power-on, on the simulation's clock
POLL_MS = 20
LATE_MS = 100  # how long a replay continues after the last line, for changes that show one update and one poll later
APP_MS = 1.0  # how long packets for the app wait in its queue
RAW = ("link source",)  # the note on the first raw request
POLL = Packet(9, 0, b"\x0c")
WORD, LOG_CONTROL, ROW, ALIVE = (9, 0), (5, 1), (5, 2), (12, 2)
CREATE, APPEND = 6, 7  # a log block

# The recorded vehicle's numbers for the parameters that the traces name.
NUMBERS = {
    0x00: "system.selftestPassed",
    0x03: "motorPowerSet.enable",
    0x04: "motorPowerSet.m1",
    0x6D: "powerDist.idleThrust",
    0x74: "supervisor.prefltTimeout",
    0x76: "supervisor.tmblChckEn",
    0x79: "stabilizer.stop",
}
OWN = [parameter.name for parameter in parameters(rpm_deck=False)]
# Its numbers for the log variables.
VARIABLES = {0: "pm.vbat", 2: "motor.m1", 3: "motor.m2"}
NUMBER_AT = {(2, 0): 1, (2, 1): 0, (2, 2): 0, (2, 3): 1}  # position of the number in a payload about a parameter


@dataclass
class Behaviour:
    """What a vehicle did: states, words on port 9, motor ratios, answers by port and channel."""

    states: list[Change] = field(default_factory=list)
    words: list[Change] = field(default_factory=list)
    motors: list[Change] = field(default_factory=list)
    answers: dict[tuple[int, int], list[bytes]] = field(default_factory=dict)

    def answer(self, packet: Packet) -> None:
        """Keep an answer; keep one to a keep-alive only where more than number and time differ from the last."""
        messages = self.answers.setdefault(packet[:2], [])
        if packet[:2] != ALIVE or not messages or messages[-1][4:-4] != packet.payload[4:-4]:
            messages.append(packet.payload)


def keep(changes: list[Change], time_ms: float, value: Any) -> None:
    if not changes or changes[-1][1] != value:
        changes.append((time_ms, value))


class Start(NamedTuple):
    """A power-on: its time, the start of its stabilizer's loop, and the operating system's ticks at later times."""

    on_ms: float
    loop_ms: float
    times_ms: list[float]
    ticks_ms: list[float]

    def tick(self, time_ms: float) -> float:
        """Return the tick count at a time, interpolated linearly between the listed ones."""
        after = bisect_right(self.times_ms, time_ms)
        if after in (0, len(self.times_ms)):
            nearest = min(after, len(self.times_ms) - 1)
            return self.ticks_ms[nearest] + time_ms - self.times_ms[nearest]
        (begin, end), (from_ms, to_ms) = self.times_ms[after - 1 : after + 1], self.ticks_ms[after - 1 : after + 1]
        return from_ms + (to_ms - from_ms) * (time_ms - begin) / (end - begin)


class Trace:
    """A recorded trace: what was done to the vehicle, when, and what it did."""

    def __init__(self, path: Path) -> None:
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        self.lines = [line for line in lines if line.get("what") != "scenario"]
        self.end_ms = self.lines[-1]["t_ms"]
        self.vehicle = str(lines[0]["vehicle"])
        ons = [number for number, line in enumerate(self.lines) if line.get("what") == "power_on"]
        self.starts = [_start(self.lines[on:end]) for on, end in pairwise([*ons, len(self.lines)])]

    def start_conditions(self) -> dict[str, float]:
        """Return the conditions at power-on that differ from the usual ones."""
        conditions = next(line.get("start_conditions", {}) for line in self.lines if line.get("what") == "power_on")
        return {name: float(value) for name, value in conditions.items()}

    def judged_ms(self, time_ms: float) -> float:
        """Return the time by which an event is judged: the ticks since its power-on, added to the start of the loop."""
        start = self.start(time_ms)
        return start.loop_ms + start.tick(time_ms)

    def start(self, time_ms: float) -> Start:
        """Return the last power-on up to a time, or the first one if none came before."""
        return [start for start in self.starts if start.on_ms <= time_ms or start is self.starts[0]][-1]

    def behaviour(self) -> Behaviour:
        """Return the recorded behaviour."""
        found = Behaviour()
        for line in self.lines:
            time_ms = line["t_ms"]
            if line.get("what") == "state":
                keep(found.states, time_ms, line["state"])
            elif line.get("what") == "power_off":
                keep(found.motors, time_ms, STILL)
            elif line["event"] == "supervisor":
                keep(found.words, time_ms, line["payload"])
            elif line["event"] == "motors":
                keep(found.motors, time_ms, tuple(line["ratios"]))
            elif line["event"] == "recv":
                found.answer(packet_of(line))
        return found

    def happenings(self) -> list[tuple[float, Packet | Line]]:
        """Return all packets sent, with keep-alives and polls filled in, and all other actions on the vehicle."""
        found: list[tuple[float, Packet | Line]] = []
        begun: Line | None = None
        for line in self.lines:
            if line["event"] == "send" and "last keep-alive" in line.get("note", ""):
                assert begun is not None
                found += _series(begun, line)
            elif line["event"] == "send":
                packet = packet_of(line)
                found.append((line["t_ms"] + (APP_MS if packet.port in AppPorts() else 0.0), packet))
                begun = line if "keep-alive; repeated" in line.get("note", "") else begun
            elif line.get("what") in ("acc_z", "power_off"):
                found.append((line["t_ms"], line))
        found += [(start.loop_ms, {"what": "power_on"}) for start in self.starts[1:]]
        found += [(poll_ms, POLL) for poll_ms in self._polls_ms()]
        return sorted(found, key=lambda happening: happening[0])

    def _polls_ms(self) -> list[float]:
        """Return when the supervisor was polled: from its first word on, but no longer once raw requests begin."""
        words = [line["t_ms"] for line in self.lines if line["event"] == "supervisor"]
        raw = [line["t_ms"] for line in self.lines if line["event"] == "send" and line.get("note") in RAW]
        end_ms = raw[0] if raw else self.end_ms + LATE_MS
        return list(np.arange(words[0], end_ms, POLL_MS)) if words else []


def _start(lines: list[Line]) -> Start:
    dated = [(line["t_ms"], line["tick_ms"]) for line in lines if line.get("what") == "state"]
    looked_ms = next(line["t_ms"] for line in lines if line.get("state") == "preflight_not_passed")
    times_ms, ticks_ms = zip(*dict(dated).items(), strict=True)
    return Start(lines[0]["t_ms"], looked_ms - UPDATE_STEPS, list(times_ms), list(ticks_ms))


def _series(first: Line, last: Line) -> list[tuple[float, Packet | Line]]:
    """Return the keep-alives of a series after the first, up to and including the last."""
    (begin,), (end,) = (struct.unpack("<I", bytes.fromhex(line["payload"])) for line in (first, last))
    every_ms = (last["t_ms"] - first["t_ms"]) / max(end - begin, 1)
    return [
        (math.ceil(first["t_ms"] + (number - begin) * every_ms) + APP_MS, Packet(*ALIVE, struct.pack("<I", number)))
        for number in range(begin + 1, end + 1)
    ]


def replay(trace: Trace) -> Behaviour:
    """Repeat the actions of a trace on a simulated vehicle, and return the vehicle's behaviour."""
    return _Replay(trace).behaviour


class _Replay:
    def __init__(self, trace: Trace) -> None:
        self.behaviour = Behaviour(motors=[(0.0, STILL)])
        self._start = trace.starts[0]
        given, (platform, firmware) = trace.start_conditions(), trace.vehicle.split("_")
        rotors = RotorTruth(**BRUSHLESS) if platform == "cf21bl" else RotorTruth()
        on_s = ON_S + self._start.loop_ms / 1000
        propulsion = Propulsion(
            rotors.model_copy(update={"time_constant_s": given.get("RPM_TAU", rotors.time_constant_s)}),
            BatteryTruth(),
            rng=np.random.default_rng(1),
            begin_s=on_s,
        )
        truth = {"platform": platform, "firmware": firmware, "clock_skew": -1 / 85, "powered_for_s": 0}
        self._vehicle = Crazyflie(
            CrazyflieTruth.model_validate({**truth, "stall_rpm": given.get("RPM_STALL", 60)}),
            propulsion,
            load_app=load_core,
            opened_s=on_s,
            on_motors=self._see_motors,
            rtos_ms=lambda step: int(self._start.tick(self._start.loop_ms + step)),
        )
        self._vehicle.turn(given.get("ACCZ", 1.0))
        now_ms = self._start.loop_ms
        self._see_state(now_ms)
        for time_ms, happening in trace.happenings():
            self._go_on(now_ms, time_ms)
            if happening == {"what": "power_on"}:
                self._start = next(start for start in trace.starts if start.loop_ms == time_ms)
            self._do(happening, time_ms)
            now_ms = max(now_ms, time_ms)
        self._go_on(now_ms, trace.end_ms + LATE_MS)

    def _go_on(self, begin_ms: float, end_ms: float) -> None:
        """Let time pass, and record the state after each update of the supervisor."""
        first = math.floor((begin_ms - self._start.loop_ms) / UPDATE_STEPS) + 1
        looks_ms = self._start.loop_ms + np.arange(first, first + (end_ms - begin_ms) / UPDATE_STEPS + 1) * UPDATE_STEPS
        for time_ms in [*looks_ms[looks_ms < end_ms].tolist(), end_ms]:
            self._hear(self._vehicle.advance(ON_S + time_ms / 1000))
            self._see_state(time_ms)

    def _do(self, happening: Packet | Line, time_ms: float) -> None:
        at_s = ON_S + time_ms / 1000
        if isinstance(happening, Packet):
            request = self._with_own_variables(_renumbered(happening, own=True))
            answers = self._vehicle.receive(encode_packet(request), at_s)
            self._hear(answers, polled=happening is POLL)
        elif happening["what"] == "acc_z":
            self._vehicle.turn(happening["g"])
        elif happening["what"] == "power_off":
            self._vehicle.power_off(at_s)
        else:
            self._vehicle.restart(at_s, boot_s=0.0)
            self._see_state(time_ms)

    def _hear(self, leaving: list[Leaving], *, polled: bool = False) -> None:
        for time_s, datagram in leaving:
            packet = decode_packet(datagram)
            assert packet is not None
            if polled and packet[:2] == WORD:
                keep(self.behaviour.words, 1000 * (time_s - ON_S), packet.payload.hex())
            else:
                self.behaviour.answer(_renumbered(packet, own=False))

    def _with_own_variables(self, packet: Packet) -> Packet:
        """Return a request about a log block with the simulated vehicle's numbers for the variables."""
        if packet[:2] != LOG_CONTROL or packet.payload[0] not in (CREATE, APPEND):
            return packet
        own = [variable.name for variable in variables(self._vehicle, rpm_deck=False, brushless=False)]
        entries = struct.iter_unpack("<BH", packet.payload[2:])
        mine = [(kind, own.index(VARIABLES[number]) if number in VARIABLES else number) for kind, number in entries]
        return Packet(*LOG_CONTROL, packet.payload[:2] + b"".join(struct.pack("<BH", *entry) for entry in mine))

    def _see_state(self, time_ms: float) -> None:
        keep(self.behaviour.states, time_ms, self._vehicle.supervisor.state.value)

    def _see_motors(self, time_s: float, motors: tuple[int, int, int, int]) -> None:
        keep(self.behaviour.motors, 1000 * (time_s - ON_S), motors)


def packet_of(line: Line) -> Packet:
    return Packet(line["port"], line["channel"], bytes.fromhex(line["payload"]))


def _renumbered(packet: Packet, *, own: bool) -> Packet:
    """Return a packet whose parameter number is the simulated vehicle's (`own`), or again the recorded vehicle's."""
    at, payload = NUMBER_AT.get(packet[:2]), packet.payload
    if at is None or len(payload) < at + 2 or (packet.channel == 3 and payload[0] == 0):
        return packet
    numbers = {number: OWN.index(name) for number, name in NUMBERS.items()}
    numbers = numbers if own else {mine: theirs for theirs, mine in numbers.items()}
    number = int.from_bytes(payload[at : at + 2], "little")
    new = numbers.get(number, number).to_bytes(2, "little")
    return Packet(packet.port, packet.channel, payload[:at] + new + payload[at + 2 :])

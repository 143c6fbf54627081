"""Injects faults into the simulated devices, between each device and its port; no port and no clock.

Without them a rig is sound. `cfid rig sim --fault` and tests state them by device and name.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from cfid.errors import ConfigError
from cfid.records.files import first_fault
from cfid.sim.crazyflie import PROTOCOL, Crazyflie, LeavingPacket
from cfid.sim.e201 import E201Device, Reply
from cfid.sim.link import Radio, SentPing, VehicleLink
from cfid.sim.netft import Address, Datagram, NetFTBox
from cfid.sim.propulsion import Propulsion
from cfid.wire import e201
from cfid.wire.app import AppState, Flags, PingChannel, encode_state
from cfid.wire.crtp import PARAMETER_PORT, WRITE_CHANNEL, decode_packet
from cfid.wire.rdt import RECORD_BYTES, Command, Request, decode_request, encode_request

Count = Annotated[int, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0)]


def _read_word(value: object) -> object:
    """Read text as a decimal number or, with 0x before it, as a hexadecimal one."""
    try:
        return int(value, 0) if isinstance(value, str) else value
    except ValueError:
        raise ValueError("should be a whole number") from None


class _Faults(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LoadCellFaults(_Faults):
    """Faults of the box and its network; times are seconds since it was opened, 0 for a count means never.

    Every n-th datagram is dropped, duplicated, swapped with the next, or corrupted (cut short or one bit flipped, in
    turn). `silent`: no UDP. `restart`: the box loses power. `second_client`: another client takes the stream. `slow_s`
    delays HTTP and TCP. `udp_blocked`: a firewall passes requests but no record. `status` is shown from
    `status_after_s` on; 0x41 resets its latch. `refuse_settings`: comm.cgi answers without changing anything, and a
    bias has no effect. `saturate`: Fz is loaded beyond its range.
    """

    drop_every: Count = 0
    duplicate_every: Count = 0
    reorder_every: Count = 0
    corrupt_every: Count = 0
    silent_after_s: Seconds | None = None
    silent_for_s: Seconds | None = None
    restart_after_s: Seconds | None = None
    restart_for_s: Seconds = 1.0
    second_client_after_s: Seconds | None = None
    slow_s: Seconds = 0.0
    udp_blocked: bool = False
    status_after_s: Seconds | None = None
    status: Annotated[int, Field(ge=0, le=0xFFFFFFFF), BeforeValidator(_read_word)] = 0x80010000
    refuse_settings: bool = False
    saturate_after_s: Seconds | None = None


class EncoderFaults(_Faults):
    """Faults of the encoder's interface and its cable; times are seconds since it was opened.

    Every n-th reply is dropped, or corrupted (bytes lost, its end lost, or junk put before it, in turn). `split`:
    replies come in two pieces. `silent`: no replies. `unplug`: the port goes away. `slow_s` delays each reply.
    `wrong_width`: words have this many bits, whatever was set. `not_an_e201`: another device answers.
    """

    drop_every: Count = 0
    corrupt_every: Count = 0
    split: bool = False
    silent_after_s: Seconds | None = None
    silent_for_s: Seconds | None = None
    unplug_after_s: Seconds | None = None
    unplug_for_s: Seconds = 1.0
    slow_s: Seconds = 0.0
    wrong_width: Annotated[int, Field(ge=0, le=32)] | None = None
    not_an_e201: bool = False


class CrazyflieFaults(_Faults):
    """Faults of the vehicle and its link; times are seconds since it was opened.

    Every n-th packet from the vehicle, or to it, is dropped. `silent`: no packet passes either way. `closed`: the port
    is closed, while the vehicle goes on. `busy`: while one client is active, others are ignored. `tumble`: the vehicle
    turns by `tumble_deg`, 180 upside down, 90 on its side. `emergency`: an emergency stop. `low_battery`: the voltage
    falls to 2.9 V. `reboot`: the vehicle loses power for a moment. `protocol`: it speaks this version,
    and `app_protocol`: its app speaks this one; 0 for their own.

    A stop is the app's, or zero written to motorPowerSet.enable. `stop_ignored`: it is acknowledged, and the motors go
    on. `stop_late_s` delays its answer. `stop_misnumbered`: its answer has another number.
    """

    silent_after_s: Seconds | None = None
    silent_for_s: Seconds | None = None
    closed_after_s: Seconds | None = None
    drop_every: Count = 0
    drop_to_vehicle_every: Count = 0
    tumble_after_s: Seconds | None = None
    tumble_for_s: Seconds | None = None
    tumble_deg: Annotated[float, Field(ge=0, le=180)] = 180.0
    emergency_after_s: Seconds | None = None
    low_battery_after_s: Seconds | None = None
    busy: bool = False
    protocol: Count = 0
    app_protocol: Annotated[int, Field(ge=0, le=255)] = 0
    reboot_after_s: Seconds | None = None
    stop_ignored: bool = False
    stop_late_s: Seconds = 0.0
    stop_misnumbered: bool = False


SOUND_LOADCELL = LoadCellFaults()
SOUND_ENCODER = EncoderFaults()
SOUND_CRAZYFLIE = CrazyflieFaults()


class _RigFaults(_Faults):
    encoder: EncoderFaults
    loadcell: LoadCellFaults
    crazyflie: CrazyflieFaults


_KNOWN = [
    f"{device}.{fault}"
    for device, kind in (("encoder", EncoderFaults), ("loadcell", LoadCellFaults), ("crazyflie", CrazyflieFaults))
    for fault in kind.model_fields
]


def parse_faults(arguments: Sequence[str]) -> tuple[EncoderFaults, LoadCellFaults, CrazyflieFaults]:
    """Read arguments such as `loadcell.drop_every=100` or `encoder.split=true`, or several separated by commas.

    Raises ConfigError naming an unknown fault, with the known ones, or an invalid value.
    """
    values: dict[str, dict[str, str]] = {"encoder": {}, "loadcell": {}, "crazyflie": {}}
    for argument in ",".join(arguments).split(",") if arguments else ():
        name, _, value = argument.partition("=")
        if name not in _KNOWN:
            raise ConfigError(f"{argument}: there is no fault '{name}'. Known faults: {', '.join(_KNOWN)}.")
        device, _, fault = name.partition(".")
        values[device][fault] = value
    try:
        faults = _RigFaults.model_validate(values)
    except ValidationError as error:
        raise ConfigError(first_fault(error, values)) from None
    return faults.encoder, faults.loadcell, faults.crazyflie


def _within(elapsed_s: float, after_s: float | None, for_s: float | None = None) -> bool:
    """Return whether a fault that begins at `after_s` and lasts `for_s` (None: without end) is present now."""
    return after_s is not None and after_s <= elapsed_s < (math.inf if for_s is None else after_s + for_s)


def _is_turn(number: int, every: int) -> bool:
    return every > 0 and number % every == 0


# The encoder

_PIECES_APART_S = 3e-3
_JUNK = b"\x00\xfe#"
_STRANGER = b"Virtual ComPort V2.0\r"


@dataclass
class ReplyMishaps:
    """Counts of replies by fault."""

    dropped: int = 0
    silenced: int = 0
    garbled: int = 0
    split: int = 0


class SerialDevice(Protocol):
    """A device at a serial port."""

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to bytes."""

    def due(self, now_s: float) -> list[Reply]:
        """Return what the device sends unprompted up to now."""


class FaultyE201:
    """The interface, or another device at a serial port, with its faults."""

    def __init__(self, device: SerialDevice, faults: EncoderFaults, *, opened_s: float) -> None:
        """Count the faults' times from `opened_s`."""
        self.faults = faults
        self.mishaps = ReplyMishaps()
        self._device = device
        if isinstance(device, E201Device):
            device.stuck_at_bits = faults.wrong_width
        self._opened_s = opened_s
        self._replies = 0

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""
        return self._device.continuous

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to `data`, each with its delay."""
        if self.faults.not_an_e201:
            return [(0.0, _STRANGER)] if e201.VERSION in data else []
        return self._pass(self._device.received(data, now_s), now_s)

    def due(self, now_s: float) -> list[Reply]:
        """Return the replies of the continuous output up to now."""
        return self._pass(self._device.due(now_s), now_s)

    def _pass(self, replies: list[Reply], now_s: float) -> list[Reply]:
        if _within(now_s - self._opened_s, self.faults.silent_after_s, self.faults.silent_for_s):
            self.mishaps.silenced += len(replies)
            return []
        return [piece for reply in replies for piece in self._pieces(*reply)]

    def _pieces(self, delay_s: float, reply: bytes) -> list[Reply]:
        faults = self.faults
        self._replies += 1
        if _is_turn(self._replies, faults.drop_every):
            self.mishaps.dropped += 1
            return []
        if _is_turn(self._replies, faults.corrupt_every):
            kinds = (reply[:1] + reply[3:], reply[:-1], _JUNK + reply)  # without its end it joins the next reply
            reply = kinds[self.mishaps.garbled % len(kinds)]
            self.mishaps.garbled += 1
        delay_s += faults.slow_s
        if not faults.split or len(reply) < 2:
            return [(delay_s, reply)]
        self.mishaps.split += 1
        middle = len(reply) // 2
        return [(delay_s, reply[:middle]), (delay_s + _PIECES_APART_S, reply[middle:])]


# The load cell

_BIAS = Request(Command.BIAS)
_OTHER_CLIENT: Address = ("192.0.2.1", 49152)  # in the network reserved for examples


@dataclass
class NetftMishaps:
    """Counts of faults, in records where a client misses records or gets them twice."""

    dropped_records: int = 0
    silenced_records: int = 0
    duplicated_records: int = 0
    reordered_datagrams: int = 0
    cut_datagrams: int = 0
    flipped_bits: int = 0


class FaultyNetFT:
    """The box with its faults. While it is not `alive`, it takes and sends nothing."""

    def __init__(self, box: NetFTBox, faults: LoadCellFaults, *, opened_s: float, rng: np.random.Generator) -> None:
        """Count the faults' times from `opened_s`."""
        self.box = box
        self.faults = faults
        self.mishaps = NetftMishaps()
        self._opened_s = opened_s
        self._rng = rng
        self._sent = 0
        self._held: Datagram | None = None
        begins = (
            (faults.restart_after_s, self._restart),
            (faults.second_client_after_s, self._lose_stream),
            (faults.status_after_s, self._show_status),
            (faults.saturate_after_s, self._saturate),
        )
        dated = [(after_s, begin) for after_s, begin in begins if after_s is not None]
        self._to_come = sorted(dated, key=lambda event: event[0])

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""
        return self.box.streaming

    @property
    def slow_s(self) -> float:
        """How late it answers over HTTP and TCP."""
        return self.faults.slow_s

    def alive(self, now_s: float) -> bool:
        """Return whether the box has power and answers at all."""
        while self._to_come and self._to_come[0][0] <= now_s - self._opened_s:
            after_s, begin = self._to_come.pop(0)
            begin(self._opened_s + after_s)
        return not _within(now_s - self._opened_s, self.faults.restart_after_s, self.faults.restart_for_s)

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take an RDT request."""
        refused = self.faults.refuse_settings and decode_request(datagram) == _BIAS
        if self.alive(now_s) and not refused:
            self._held = None
            self.box.request(datagram, client, now_s)

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams that leave for the client now."""
        if not self.alive(now_s):
            return []
        datagrams = [datagram for datagram in self.box.due(now_s) if datagram[1] != _OTHER_CLIENT]
        elapsed_s = now_s - self._opened_s
        if self.faults.udp_blocked or _within(elapsed_s, self.faults.silent_after_s, self.faults.silent_for_s):
            self.mishaps.silenced_records += _records(datagrams)
            return []
        return [passed for datagram in datagrams for passed in self._pass(datagram)]

    def page(self, index: int | None = None) -> str:
        """Return netftapi2.xml."""
        return self.box.page(index)

    def apply(self, path_and_query: str) -> bool:
        """Apply a setting, or only acknowledge it; return whether its page exists."""
        if self.faults.refuse_settings and path_and_query.startswith("/comm.cgi"):
            return True
        return self.box.apply(path_and_query)

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command over TCP."""
        return self.box.answer(command, now_s)

    def _pass(self, datagram: Datagram) -> Iterable[Datagram]:
        """Return what is sent for one datagram, and for one held back before it."""
        faults = self.faults
        self._sent += 1
        held, self._held = self._held, None
        passed = [] if held is None else [held]
        if _is_turn(self._sent, faults.drop_every):
            self.mishaps.dropped_records += _records([datagram])
            return passed
        if _is_turn(self._sent, faults.corrupt_every):
            datagram = self._corrupted(datagram)
        if held is None and _is_turn(self._sent, faults.reorder_every) and self.streaming:
            self._held = datagram
            self.mishaps.reordered_datagrams += 1
            return []
        if _is_turn(self._sent, faults.duplicate_every):
            self.mishaps.duplicated_records += _records([datagram])
            return [datagram, datagram, *passed]
        return [datagram, *passed]

    def _corrupted(self, datagram: Datagram) -> Datagram:
        data, client = datagram
        if self.mishaps.cut_datagrams == self.mishaps.flipped_bits:
            self.mishaps.cut_datagrams += 1
            return data[: int(self._rng.integers(1, RECORD_BYTES))], client
        self.mishaps.flipped_bits += 1
        flipped = bytearray(data)
        flipped[self._rng.integers(len(data))] ^= 1 << self._rng.integers(8)
        return bytes(flipped), client

    def _restart(self, at_s: float) -> None:
        self.box.restart(at_s + self.faults.restart_for_s)

    def _lose_stream(self, at_s: float) -> None:
        self.box.request(encode_request(Request(Command.REAL_TIME)), _OTHER_CLIENT, at_s)

    def _show_status(self, _at_s: float) -> None:
        self.box.status |= self.faults.status

    def _saturate(self, _at_s: float) -> None:
        self.box.load_cell.overload()


def _records(datagrams: Iterable[Datagram]) -> int:
    return sum(len(data) for data, _ in datagrams) // RECORD_BYTES


# The vehicle

_ENABLE = "motorPowerSet.enable"
_NUMBER_BYTES = 4
_HELLO = b"cfid"  # in the app's answer to a hello, before its version
_LOW_V = 2.9
_ACTIVE_S = 1.0  # since its last packet, a client counts as active
_ROUNDING_S = 1e-9


@dataclass
class CrazyflieMishaps:
    """Counts of packets that did not pass, apart from those that the radio lost."""

    dropped: int = 0
    dropped_to_vehicle: int = 0
    silenced: int = 0
    refused: int = 0


class FaultyCrazyflie(VehicleLink):
    """The vehicle behind its radio, with the faults of both."""

    def __init__(
        self,
        vehicle: Crazyflie,
        propulsion: Propulsion,
        radio: Radio,
        faults: CrazyflieFaults,
        *,
        ping_port: int,
        opened_s: float,
    ) -> None:
        """Count the faults' times from `opened_s`."""
        super().__init__(vehicle, radio, ping_port=ping_port)
        self.faults = faults
        self.mishaps = CrazyflieMishaps()
        self._propulsion = propulsion
        self._ping_port = ping_port
        self._opened_s = self._looked_s = self._received_s = opened_s
        self._heard = self._sent = 0
        self._rebooted = self._tumbled = self._stopped = False

    def next_s(self, now_s: float) -> float | None:
        """Return when the next event is due, None while there is none."""
        next_s = super().next_s(now_s)
        if self.faults is SOUND_CRAZYFLIE:
            return next_s
        times = self._turns(now_s, math.inf) + ([] if next_s is None else [next_s])
        return min(times, default=None)

    def closed(self, now_s: float) -> bool:
        """Return whether the port is closed."""
        return _within(now_s - self._opened_s, self.faults.closed_after_s)

    def received(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take a client's datagram, unless another one is active on a busy link."""
        before = self._client
        if self.faults.busy and before and client != before and now_s - self._received_s < _ACTIVE_S:
            self.mishaps.refused += 1
            return
        super().received(datagram, client, now_s)

    def _take_answers(self, client: Address, now_s: float) -> None:
        super()._take_answers(client, now_s)
        self._received_s = now_s

    def _passes_to_vehicle(self, now_s: float) -> bool:
        self._heard += 1
        if self._silent(now_s):
            self.mishaps.silenced += 1
            return False
        if _is_turn(self._heard, self.faults.drop_to_vehicle_every):
            self.mishaps.dropped_to_vehicle += 1
            return False
        return True

    def _deliver(self, datagram: bytes, ping: SentPing | None, at_s: float) -> None:
        faults = self.faults
        if not self._is_stop(datagram):
            super()._deliver(datagram, ping, at_s)
            return
        answers = self._ignored(datagram, at_s) if faults.stop_ignored else self.vehicle.receive(datagram, at_s)
        if faults.stop_misnumbered:
            answers = [_misnumbered(answer) for answer in answers]
        self._send(answers, late_s=faults.stop_late_s)

    def _advance_vehicle(self, now_s: float) -> None:
        if self.faults is SOUND_CRAZYFLIE and self._looked_s > self._opened_s:
            super()._advance_vehicle(now_s)
            return
        for turn_s in (*self._turns(self._looked_s, now_s), now_s):
            super()._advance_vehicle(turn_s)
            self._apply_faults(turn_s)
        self._looked_s = now_s

    def _send(self, leaving: list[LeavingPacket], ping: SentPing | None = None, *, late_s: float = 0.0) -> None:
        version = self.faults.app_protocol
        passing = []
        for time_s, packet in leaving:
            self._sent += 1
            if self._silent(time_s):
                self.mishaps.silenced += 1
            elif _is_turn(self._sent, self.faults.drop_every):
                self.mishaps.dropped += 1
            elif version and packet[1:5] == _HELLO:
                passing.append(LeavingPacket(time_s, packet[:5] + bytes([version]) + packet[6:]))
            else:
                passing.append(LeavingPacket(time_s, packet))
        super()._send(passing, ping, late_s=late_s)

    def _silent(self, now_s: float) -> bool:
        return _within(now_s - self._opened_s, self.faults.silent_after_s, self.faults.silent_for_s)

    def _turns(self, after_s: float, until_s: float) -> list[float]:
        """Return the times between the two at which a fault of the vehicle begins or ends, or its port closes."""
        faults = self.faults
        tumble_s, for_s = faults.tumble_after_s, faults.tumble_for_s
        begins = (
            faults.closed_after_s,
            tumble_s,
            None if tumble_s is None or for_s is None else tumble_s + for_s,
            faults.emergency_after_s,
            faults.low_battery_after_s,
            faults.reboot_after_s,
        )
        times = (self._opened_s + begin_s for begin_s in begins if begin_s is not None)
        return sorted(time_s for time_s in times if after_s < time_s <= until_s)

    def _apply_faults(self, now_s: float) -> None:
        elapsed_s = now_s - self._opened_s + _ROUNDING_S  # so that rounding does not put a fault after its own time
        faults, vehicle = self.faults, self.vehicle
        if _within(elapsed_s, faults.reboot_after_s) and not self._rebooted:
            self._rebooted = True
            vehicle.restart(now_s)
        vehicle.protocol = faults.protocol or PROTOCOL
        tumbled = _within(elapsed_s, faults.tumble_after_s, faults.tumble_for_s)
        if tumbled != self._tumbled:
            self._tumbled = tumbled
            vehicle.turn(math.cos(math.radians(faults.tumble_deg)) if tumbled else 1.0)
        if _within(elapsed_s, faults.emergency_after_s) and not self._stopped:
            self._stopped = True
            vehicle.supervisor.stopped = True
        low = _within(elapsed_s, faults.low_battery_after_s)
        self._propulsion.battery.at_most_v = _LOW_V if low else math.inf

    def _is_stop(self, datagram: bytes) -> bool:
        """Return whether a datagram is the app's stop, or zero for motorPowerSet.enable."""
        packet = decode_packet(datagram)
        if packet is None:
            return False
        zero = self.vehicle.parameter_number(_ENABLE).to_bytes(2, "little") + b"\0"
        return packet[:2] == (self._ping_port, PingChannel.STOP) or packet == (PARAMETER_PORT, WRITE_CHANNEL, zero)

    def _ignored(self, datagram: bytes, at_s: float) -> list[LeavingPacket]:
        """Return the answer of a vehicle that ignores a stop: the value as if set, or the commands still in force."""
        header, payload = datagram[0], datagram[1:]
        if header >> 4 == PARAMETER_PORT:
            return [LeavingPacket(at_s, datagram)]
        number = int.from_bytes(payload[:_NUMBER_BYTES], "little")
        flags = Flags.MOTORS_ALLOWED | Flags.KEEP_ALIVE_FRESH
        state = AppState(number, flags, self.vehicle.motors, int(at_s * 1e6) % (1 << 32))
        return [LeavingPacket(at_s, bytes([header]) + encode_state(state))]


def _misnumbered(answer: LeavingPacket) -> LeavingPacket:
    """Return an answer renumbered to the next request, or the next parameter."""
    header, number, rest = answer.packet[:1], answer.packet[1 : 1 + _NUMBER_BYTES], answer.packet[1 + _NUMBER_BYTES :]
    following = (int.from_bytes(number, "little") + 1) % (1 << 8 * len(number))
    return LeavingPacket(answer.time_s, header + following.to_bytes(len(number), "little") + rest)

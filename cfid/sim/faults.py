"""Injects faults into the simulated devices, between each device and its port; no port and no clock.

Without them a rig is sound. `cfid rig sim --fault` and tests state them by device and name. Those of the vehicle and
its link take effect in `cfid.sim.link`.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Generic, Protocol, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError

from cfid.errors import ConfigError
from cfid.records.files import first_fault
from cfid.records.rig_file import RigTable
from cfid.sim.e201 import E201Device, Reply
from cfid.sim.netft import DONE, Address, Datagram, NetFTBox
from cfid.wire import e201
from cfid.wire.rdt import RECORD_BYTES, Command, Request, decode_request, encode_request

Count = Annotated[int, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0)]


def _read_word(value: object) -> object:
    """Read text as a decimal number or, with 0x before it, as a hexadecimal one."""
    try:
        return int(value, 0) if isinstance(value, str) else value
    except ValueError:
        raise ValueError("should be a whole number") from None


class LoadCellFaults(RigTable):
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


class EncoderFaults(RigTable):
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


class CrazyflieFaults(RigTable):
    """Faults of the vehicle and its link; times are seconds since it was opened.

    Every n-th packet from the vehicle is dropped. `silent`: no packet passes either way. `closed`: the port
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

Settings = TypeVar("Settings", EncoderFaults, LoadCellFaults, CrazyflieFaults)


def parse_faults(arguments: Sequence[str]) -> tuple[EncoderFaults, LoadCellFaults, CrazyflieFaults]:
    """Read arguments such as `loadcell.drop_every=100` or `encoder.split=true`, or several separated by commas.

    Raises ConfigError naming an unknown fault, with the known ones, or an invalid value.
    """
    kinds: dict[str, type[RigTable]] = {
        "encoder": EncoderFaults,
        "loadcell": LoadCellFaults,
        "crazyflie": CrazyflieFaults,
    }
    known = [f"{device}.{fault}" for device, kind in kinds.items() for fault in kind.model_fields]
    values: dict[str, dict[str, str]] = {device: {} for device in kinds}
    for argument in ",".join(arguments).split(",") if arguments else ():
        name, _, value = argument.partition("=")
        if name not in known:
            raise ConfigError(f"{argument}: there is no fault '{name}'. Known faults: {', '.join(known)}.")
        device, _, fault = name.partition(".")
        values[device][fault] = value
    return (
        _read(EncoderFaults, "encoder", values),
        _read(LoadCellFaults, "loadcell", values),
        _read(CrazyflieFaults, "crazyflie", values),
    )


def _read(kind: type[Settings], device: str, values: dict[str, dict[str, str]]) -> Settings:
    try:
        return kind.model_validate(values[device])
    except ValidationError as error:
        raise ConfigError(f"{device}.{first_fault(error, values[device])}") from None


class Faulty(Generic[Settings]):
    """A device with its faults, whose times count from `opened_s`; others may be set at any time.

    A fault F begins at `F_after_s` and lasts for `F_for_s` where it has that setting, else without end. `mishaps`
    counts what every-n-th rules hit, by their names: for the box in records, else in messages.
    """

    def __init__(self, faults: Settings, *, opened_s: float) -> None:
        """Begin without mishaps."""
        self.faults: Settings = faults
        self.mishaps: Counter[str] = Counter()
        self._opened_s = opened_s
        self._begun: set[tuple[str, float]] = set()

    def present(self, fault: str, now_s: float) -> bool:
        """Return whether a dated fault is present now."""
        begin_s = getattr(self.faults, f"{fault}_after_s")
        if begin_s is None or now_s - self._opened_s < begin_s:
            return False
        for_s = getattr(self.faults, f"{fault}_for_s", None)
        return for_s is None or now_s - self._opened_s < begin_s + for_s

    def begins(self, fault: str, now_s: float) -> bool:
        """Return whether a dated fault is present now, and was not at the calls before."""
        begin = fault, getattr(self.faults, f"{fault}_after_s")
        if begin in self._begun or not self.present(fault, now_s):
            return False
        self._begun.add(begin)
        return True

    def turns(self, after_s: float, until_s: float) -> list[float]:
        """Return the times between the two at which a dated fault begins or ends, in order."""
        turns = []
        for setting, begin_s in self.faults:
            if setting.endswith("_after_s") and begin_s is not None:
                for_s = getattr(self.faults, setting.replace("_after_s", "_for_s"), None)
                turns += [begin_s] if for_s is None else [begin_s, begin_s + for_s]
        return sorted(turn for turn in (self._opened_s + turn_s for turn_s in turns) if after_s < turn <= until_s)

    def strikes(self, rule: str, number: int, amount: int = 1) -> bool:
        """Return whether an every-n-th rule hits the message with this number, and if so count `amount` mishaps."""
        every = getattr(self.faults, rule)
        if not every or number % every:
            return False
        self.mishaps[rule] += amount
        return True


# The encoder

_PIECES_APART_S = 3e-3
_JUNK = b"\x00\xfe#"


class SerialDevice(Protocol):
    """A device at a serial port."""

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to bytes."""

    def due(self, now_s: float) -> list[Reply]:
        """Return what the device sends unprompted up to now."""


class FaultySerial(Faulty[EncoderFaults]):
    """The interface, or another device at a serial port, with its faults."""

    def __init__(self, device: SerialDevice, faults: EncoderFaults, *, opened_s: float) -> None:
        """Put the faults between the device and its port."""
        super().__init__(faults, opened_s=opened_s)
        self._device = device
        if isinstance(device, E201Device):
            device.stuck_at_bits = faults.wrong_width
        self._replies = 0

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""
        return self._device.continuous

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to `data`, each with its delay."""
        if self.faults.not_an_e201:
            return [(0.0, b"Virtual ComPort V2.0\r")] if e201.VERSION in data else []
        return self._pass(self._device.received(data, now_s), now_s)

    def due(self, now_s: float) -> list[Reply]:
        """Return the replies of the continuous output up to now."""
        return self._pass(self._device.due(now_s), now_s)

    def _pass(self, replies: list[Reply], now_s: float) -> list[Reply]:
        if self.present("silent", now_s):
            return []
        return [piece for reply in replies for piece in self._pieces(*reply)]

    def _pieces(self, delay_s: float, reply: bytes) -> list[Reply]:
        self._replies += 1
        if self.strikes("drop_every", self._replies):
            return []
        if self.strikes("corrupt_every", self._replies):
            kinds = (_JUNK + reply, reply[:1] + reply[3:], reply[:-1])  # without its end it joins the next reply
            reply = kinds[self.mishaps["corrupt_every"] % len(kinds)]
        delay_s += self.faults.slow_s
        if not self.faults.split or len(reply) < 2:
            return [(delay_s, reply)]
        middle = len(reply) // 2
        return [(delay_s, reply[:middle]), (delay_s + _PIECES_APART_S, reply[middle:])]


# The load cell

_OTHER_CLIENT: Address = ("192.0.2.1", 49152)  # in the network reserved for examples


class FaultyNetFT(Faulty[LoadCellFaults]):
    """The box with its faults. While it is not `alive`, it takes and sends nothing."""

    def __init__(self, box: NetFTBox, faults: LoadCellFaults, *, opened_s: float, rng: np.random.Generator) -> None:
        """Put the faults between the box and its ports."""
        super().__init__(faults, opened_s=opened_s)
        self.box = box
        self._rng = rng
        self._sent = 0
        self._held: Datagram | None = None

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""
        return self.box.streaming

    def alive(self, now_s: float) -> bool:
        """Return whether the box has power and answers at all."""
        faults = self.faults
        if self.begins("restart", now_s):
            self.box.restart(self._opened_s + (faults.restart_after_s or 0.0) + faults.restart_for_s)
        if self.begins("second_client", now_s):
            self.box.request(encode_request(Request(Command.REAL_TIME)), _OTHER_CLIENT, now_s)
        if self.begins("status", now_s):
            self.box.status |= faults.status
        if self.begins("saturate", now_s):
            self.box.load_cell.overload()
        return not self.present("restart", now_s)

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take an RDT request."""
        refused = self.faults.refuse_settings and decode_request(datagram) == Request(Command.BIAS)
        if self.alive(now_s) and not refused:
            self._held = None
            self.box.request(datagram, client, now_s)

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams that leave for the client now."""
        if not self.alive(now_s):
            return []
        datagrams = self.box.due(now_s)
        if self.faults.udp_blocked or self.present("silent", now_s):
            return []
        return [passed for sent in datagrams if sent[1] != _OTHER_CLIENT for passed in self._pass(sent)]

    def get(self, path_and_query: str) -> str | None:
        """Return the box' page, or only acknowledge its setting."""
        if self.faults.refuse_settings and path_and_query.startswith("/comm.cgi"):
            return DONE
        return self.box.get(path_and_query)

    def _pass(self, datagram: Datagram) -> list[Datagram]:
        """Return what is sent for one datagram, and for one held back before it."""
        self._sent += 1
        number, records = self._sent, len(datagram[0]) // RECORD_BYTES
        held, self._held = self._held, None
        passed = [] if held is None else [held]
        if self.strikes("drop_every", number, records):
            return passed
        if self.strikes("corrupt_every", number):
            datagram = self._corrupted(*datagram)
        if held is None and self.streaming and self.strikes("reorder_every", number):
            self._held = datagram
            return []
        if self.strikes("duplicate_every", number, records):
            return [datagram, datagram, *passed]
        return [datagram, *passed]

    def _corrupted(self, data: bytes, client: Address) -> Datagram:
        if self.mishaps["corrupt_every"] % 2:
            return data[: int(self._rng.integers(1, RECORD_BYTES))], client
        flipped = bytearray(data)
        flipped[self._rng.integers(len(data))] ^= 1 << self._rng.integers(8)
        return bytes(flipped), client

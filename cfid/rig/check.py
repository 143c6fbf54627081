"""Checks each device's identity and settings, and reports what is wrong and what to do; changes no setting."""

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.quantities.registry import Platform
from cfid.records.rig_file import (
    CrazyflieLink,
    EncoderLines,
    EncoderPort,
    LineDevice,
    LineValue,
    LoadCellBox,
    LoadCellLines,
)
from cfid.rig.encoder import find_encoder, ports_to_ask, word_bits
from cfid.rig.hardware import Hardware
from cfid.rig.loadcell import RECEIVE_BUFFER_BYTES, Inbox, read_once, read_settings, resolved
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.motor_log import foreign_motion
from cfid.rig.motors import Firmware, firmware_of
from cfid.rig.ready_vehicle import ReadyVehicle, state_and_idle
from cfid.rig.supervisor import present_state
from cfid.rig.tables import connect
from cfid.rig.vehicle import BATTERY, Vehicle, asked, logged
from cfid.wire import rdt
from cfid.wire.app import AppPorts
from cfid.wire.crtp import Packet
from cfid.wire.lines import printable
from cfid.wire.netft import Settings
from cfid.wire.rdt_status import read_status
from cfid.wire.rls import RLS_13BIT_IN_22, decode_words
from cfid.wire.supervisor import DEVICE, PLATFORM_PORT, RELEASE, VERSION_CHANNEL, Bits, VehicleState

_STREAM_S = 0.3
_WAIT_S = 1.0
_LOOK_EVERY_S = 0.02

_FIRST_S = 4.0  # until the first line: a board that restarts when its port is opened takes two seconds
_OFF = 0.1  # tolerance, as a fraction of the rate that rig.toml states

_NEWEST_PROTOCOL = 12  # of release 2026.08, with which cfid was tried
_NAMES: dict[Platform, tuple[str, ...]] = {
    "cf2": ("Crazyflie 2.0", "Crazyflie 2.1"),
    "cf21": ("Crazyflie 2.1",),
    "cf21bl": ("Crazyflie 2.1 Brushless",),
}

State = Literal["ok", "warning", "fault"]


class DeviceAnswer(NamedTuple):
    """A question to a device, its answer, what to do where the answer is not as it should be, and any limit."""

    asked: str
    state: State
    answer: str
    advice: str = ""
    limit: str = ""


def check_encoder(
    setting: EncoderPort | EncoderLines, hardware: Hardware, *, counts_per_turn: float | str
) -> list[DeviceAnswer]:
    """Check the identity of the encoder's interface, its word's width and a position.

    An interface that a recording holds is left alone: replies could go to either of the two.
    """
    if isinstance(setting, EncoderLines):
        return check_lines("encoder", setting, hardware)
    try:
        for port in ports_to_ask(hardware, setting.port):
            if holder := holder_of(port):
                held = f"{port} is held by {holder}"
                return [DeviceAnswer("port", "ok", held, "skipped: the check would take replies from it")]
        found = hardware.run(
            lambda _: find_encoder(hardware, setting.port, counts_per_turn=counts_per_turn, configure=False)
        )
    except DeviceError as error:
        return [DeviceAnswer("port", "fault", str(error), "plug it in, or set devices.encoder.port in rig.toml")]
    named = DeviceAnswer("port", "ok", f"{found.port}: {found.version}, serial number {found.serial_number}")
    expected_bits = word_bits(counts_per_turn)
    bits = f"{found.word_bits} bits"
    if expected_bits not in (None, found.word_bits):
        advice = f"rig.toml's counts_per_turn needs {expected_bits} bits: `cfid log encoder` sets them"
        return [named, DeviceAnswer("word", "warning", bits, advice)]
    stamped = "with the device's own stamps" if found.stamped else "without stamps"
    # A word of another kind may pass by chance, and a noisy line may spoil a valid one.
    if counts_per_turn == RLS_13BIT_IN_22 and not decode_words(np.array(found.positions)).valid.mean() > 0.5:
        advice = "no 13-bit position in 22 bits: set encoder.counts_per_turn in rig.toml to its counts per turn"
        return [named, DeviceAnswer("word", "fault", f"{bits}, position {found.positions[0]}", advice)]
    return [named, DeviceAnswer("word", "ok", f"{bits}, position {found.positions[0]}, {stamped}")]


def check_loadcell(setting: LoadCellBox | LoadCellLines, hardware: Hardware) -> list[DeviceAnswer]:
    """Check the load cell's box over HTTP, TCP and UDP.

    While a recording holds it, UDP is left alone: the box answers one client only, and a second one takes
    the stream from the first.
    """
    if isinstance(setting, LoadCellLines):
        return check_lines("loadcell", setting, hardware)
    try:
        setting = resolved(setting, hardware)
    except DeviceError as error:
        return [DeviceAnswer("address", "fault", str(error))]
    settings, over_http = _http(setting, hardware)
    over_tcp = _tcp(setting, hardware, settings)
    found = [over_http, over_tcp]
    where = f"{setting.address}:{setting.rdt_port}"
    try:
        if holder := holder_of(where):
            held = DeviceAnswer(
                "RDT, UDP", "ok", f"held by {holder}", "skipped: the check would take the stream from it"
            )
            return [*found, held]
        is_off = over_tcp.state == "fault" if settings is None else not settings.rdt_enabled
        if is_off:
            return found
        with DeviceLock(where):
            return [*found, *_udp(setting, hardware, settings, alive=over_tcp.state != "fault")]
    except DeviceError as error:  # another program took its lock just now
        return [*found, DeviceAnswer("RDT, UDP", "fault", str(error), "check again when nothing else uses the box")]


def _http(setting: LoadCellBox, hardware: Hardware) -> tuple[Settings | None, DeviceAnswer]:
    try:
        settings = read_settings(setting, hardware)
    except DeviceError as error:
        return None, DeviceAnswer(
            "settings, HTTP", "fault", str(error), "power, cable, devices.loadcell.address in rig.toml"
        )
    shown = (
        f"{settings.product}, firmware {settings.firmware}, calibration {settings.calibration_serial} "
        f"({settings.configuration}), {settings.counts_per_force:g} counts/{settings.force_unit}, "
        f"{settings.counts_per_torque:g} counts/{settings.torque_unit}, {settings.rate_hz} Hz, "
        f"{counted(settings.buffer_size, 'record')} a datagram"
    )
    if not settings.rdt_enabled:
        return settings, DeviceAnswer(
            "settings, HTTP", "warning", shown, "RDT is off: `cfid log loadcell` switches it on"
        )
    if settings.rate_hz != setting.rate_hz:
        advice = f"rig.toml states {setting.rate_hz} Hz: `cfid log loadcell` sets them"
        return settings, DeviceAnswer("settings, HTTP", "warning", shown, advice)
    return settings, DeviceAnswer("settings, HTTP", "ok", shown)


def _tcp(setting: LoadCellBox, hardware: Hardware, settings: Settings | None) -> DeviceAnswer:
    try:
        reading = read_once(setting, hardware)
    except DeviceError as error:
        return DeviceAnswer(
            "reading, TCP", "fault", str(error), "check power, cable, and devices.loadcell.address in rig.toml"
        )
    status = read_status(reading.status << 16, settings.family if settings else "netft")
    if status.faults:
        return DeviceAnswer(
            "reading, TCP", "fault", ", ".join(status.faults), "take the load off; switch the box off and on"
        )
    if status.warnings:
        return DeviceAnswer("reading, TCP", "warning", ", ".join(status.warnings), "not a fault: recordings go on")
    return DeviceAnswer("reading, TCP", "ok", "healthy")


def _udp(setting: LoadCellBox, hardware: Hardware, settings: Settings | None, *, alive: bool) -> list[DeviceAnswer]:
    """Request records for a moment, and judge how many came, and the receive buffer that the system granted."""
    rate_hz = settings.rate_hz if settings else rdt.INTERNAL_HZ
    expected = max(int(rate_hz * _STREAM_S), 2)
    inbox = Inbox((setting.address, setting.rdt_port))

    async def streamed(_: object) -> int:
        port = hardware.datagrams((setting.address, setting.rdt_port), inbox.add)
        try:
            port.send(rdt.encode_request(rdt.Request(rdt.Command.BUFFERED, expected)))
            end_s = hardware.seconds() + _STREAM_S + _WAIT_S
            while len(inbox.data) < expected * rdt.RECORD_BYTES and hardware.seconds() < end_s:
                await hardware.sleep(_LOOK_EVERY_S)
                port.drain()
            port.send(rdt.encode_request(rdt.Request(rdt.Command.STOP)))
            return port.buffer_bytes
        finally:
            port.close()

    granted = hardware.run(streamed)
    others = f", {inbox.foreign} datagrams from other addresses" if inbox.foreign else ""
    records = len(inbox.data) // rdt.RECORD_BYTES
    return [_stream(records, expected, others, alive=alive), judge_buffer(granted)]


def judge_buffer(granted_bytes: int) -> DeviceAnswer:
    """Judge the receive buffer that the system granted."""
    shown = f"{granted_bytes >> 10} KiB"
    if granted_bytes >= RECEIVE_BUFFER_BYTES:
        return DeviceAnswer("receive buffer", "ok", shown)
    advice = f"the system caps it: `sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}`"
    return DeviceAnswer("receive buffer", "warning", shown, advice)


def _stream(got: int, expected: int, others: str, *, alive: bool) -> DeviceAnswer:
    answer = f"{got} of {expected} records{others}"
    if got >= expected:
        return DeviceAnswer("RDT, UDP", "ok", answer)
    if not got and alive:
        advice = "the box answers TCP, but its datagrams do not arrive: open UDP in this computer's firewall"
    elif not got:
        advice = "no answer over TCP or UDP: check power, cable and address"
    else:
        advice = "the stream broke off: another client uses the same box, or the network drops datagrams"
    return DeviceAnswer("RDT, UDP", "fault", answer, advice)


def check_lines(name: str, setting: LineDevice, hardware: Hardware) -> list[DeviceAnswer]:
    """Listen to a device for a second or more; skip one that a recording holds, as the recording would lose lines."""
    port = setting.port
    try:
        if holder := holder_of(port):
            return [DeviceAnswer("port", "ok", f"{port} is held by {holder}", "skipped: the check would take lines")]
        with DeviceLock(port):
            return _listened(name, setting, hardware)
    except DeviceError as error:
        return [DeviceAnswer("port", "fault", str(error), f"plug it in, or set devices.{name}.port in rig.toml")]


def _listened(name: str, setting: LineDevice, hardware: Hardware) -> list[DeviceAnswer]:
    listener = _Listener(setting)
    for_s = hardware.run(lambda _: listener.listen(hardware))
    reader, readings, received = listener.reader, listener.readings, listener.received_bytes
    opened = DeviceAnswer("port", "ok", f"{setting.port}, {setting.baud} baud")
    if not readings and not received:
        advice = "check its power, and that its program runs"
        return [opened, DeviceAnswer("lines", "fault", f"nothing came in {_FIRST_S:g} s", advice)]
    if not readings:
        last = printable(reader.last_rejected)
        shown = f"{received} bytes, but no line that matches{f': {last!r}' if last else ''}"
        return [opened, DeviceAnswer("lines", "fault", shown, setting.unmatched(name))]
    rate = _rate(setting, len(readings), reader.rejected, for_s)
    columns = dict(zip((value.name for value in setting.in_order()), np.array(readings).T, strict=True))
    measured = [_resolution(setting, value, columns[value.name]) for value in setting.measured]
    clock = [] if setting.stamp is None else [_clock(setting, setting.stamp, columns[setting.stamp.name], for_s)]
    return [opened, rate, *clock, *measured]


def _rate(setting: LineDevice, count: int, rejected: int, for_s: float) -> DeviceAnswer:
    rate_hz, stated_hz = count / for_s, setting.rate_hz
    shown = f"{rate_hz:.4g} a second of {stated_hz:g}, {rejected} of {count + rejected} do not match"
    if rejected > max(0.01 * count, 1):
        return DeviceAnswer("lines", "warning", shown, "shorten the cable, lower the rate, or correct the pattern")
    missing, few = stated_hz * for_s - count, max(_OFF * stated_hz * for_s, 2)
    if missing < -few:
        advice = f"rig.toml states {stated_hz:g} Hz: set the rate that the device's program sets; losses are unknown"
        return DeviceAnswer("lines", "warning", shown, advice)
    if missing > few:
        advice = (
            "see to cable, baud and other programs, and compare rate_hz with the rate that the device's program sets"
        )
        shown = f"{shown}, {missing:.0f} of the {stated_hz * for_s:.0f} expected are missing"
        return DeviceAnswer("lines", "warning", shown, advice)
    return DeviceAnswer("lines", "ok", shown)


def _clock(setting: LineDevice, stamp: LineValue, ticks: npt.NDArray[np.float64], for_s: float) -> DeviceAnswer:
    """Judge the rate of the device's own clock."""
    gone_s = 1e-6 * setting.factor(stamp) * float(np.sum(np.diff(ticks) % (1 << 32)))
    shown = f"went {gone_s:.3g} s in {for_s:.3g} s"
    if abs(gone_s - for_s) > _OFF * for_s + 2 / setting.rate_hz:
        advice = "it counts another unit, stands, or is no clock: are there commas in numbers?"
        return DeviceAnswer(stamp.name, "warning", shown, advice)
    return DeviceAnswer(stamp.name, "ok", shown)


def _resolution(setting: LineDevice, value: LineValue, numbers: npt.NDArray[np.float64]) -> DeviceAnswer:
    """Return the latest value, the smallest step between two different ones, and the scatter."""
    shown = setting.factor(value) * numbers
    steps = np.diff(np.unique(shown))
    now = f"{shown[-1]:.6g} {setting.column_unit(value)}"
    if not len(steps):
        return DeviceAnswer(
            value.name, "ok", f"{now}, no change in {counted(len(shown), 'line')}", "touch it: it has to change"
        )
    return DeviceAnswer(value.name, "ok", f"{now}, steps of {steps.min():.2g}, scatter {shown.std():.2g}")


class _Listener:
    """Collects the readings of the lines after the first."""

    def __init__(self, setting: LineDevice) -> None:
        self.reader = setting.reader()
        self.readings: list[tuple[float, ...]] = []
        self.received_bytes = 0
        self._setting = setting

    def received(self, data: bytes) -> None:
        self.received_bytes += len(data)
        self.readings += self.reader.feed(data)

    def disconnected(self) -> None:
        """Note nothing: no line comes any more."""

    async def listen(self, hardware: Hardware) -> float:
        """Listen to the device; return for how many seconds after its first line."""
        look_s = min(max(1.0, 10 / self._setting.rate_hz), 5.0)
        port = hardware.serial(self._setting.port, self, baud=self._setting.baud)
        try:
            end_s = hardware.seconds() + _FIRST_S
            while not self.readings and hardware.seconds() < end_s:
                await hardware.sleep(_LOOK_EVERY_S)
            if not self.readings:
                return _FIRST_S
            begun_s, self.readings, self.reader.rejected = hardware.seconds(), [], 0
            await hardware.sleep(look_s)
            return hardware.seconds() - begun_s
        finally:
            port.close()


def check_vehicle(setting: CrazyflieLink, platform: Platform, hardware: Hardware) -> list[DeviceAnswer]:
    """Connect to the vehicle and check it; one that another cfid holds is left alone. `platform` is that of rig.toml.

    It is not a fault if rig.toml names no vehicle and none is found: not every experiment needs one.
    """
    if setting.uri and (holder := holder_of(setting.uri)):
        return [DeviceAnswer("link", "ok", f"held by {holder}", "skipped: a vehicle has one client")]
    try:
        uri = setting.uri or hardware.find_vehicle()
    except DeviceError as error:
        return [DeviceAnswer("link", "warning", str(error))]
    try:
        with DeviceLock(uri):
            return _vehicle_answers(connect(uri, hardware), setting, platform)
    except DeviceError as error:
        return [DeviceAnswer("link", "fault", str(error))]


def _vehicle_answers(vehicle: Vehicle, setting: CrazyflieLink, platform: Platform) -> list[DeviceAnswer]:
    async def answers(vehicle: Vehicle) -> list[DeviceAnswer]:
        state, idle_thrust = await state_and_idle(vehicle)
        cause = await foreign_motion(vehicle, idle_thrust=idle_thrust)
        if not cause and state is not None and Bits.FLYING in state.bits:
            # After the last motor stopped, a vehicle counts as flying for 2 s.
            await vehicle.hardware.sleep(2.5)
            state = await present_state(vehicle)
        volts = (await logged(vehicle, [BATTERY]))[0] if vehicle.link.variable(BATTERY) is not None else None
        return [
            *await _identity(vehicle, platform),
            await _motors(vehicle, setting, state, idle_thrust),
            _state(state, cause),
            _battery(volts, setting.stop_below_v),
        ]

    try:
        return asked(vehicle, answers)
    finally:
        vehicle.link.close()


async def _identity(vehicle: Vehicle, platform: Platform) -> list[DeviceAnswer]:
    """Return the versions of the firmware, and whether rig.toml names the vehicle that answers."""
    protocol, release, name = (
        vehicle.link.firmware_protocol,
        await _stated(vehicle, RELEASE),
        await _stated(vehicle, DEVICE),
    )
    versions = f"{vehicle.uri}, protocol {protocol}" + (f", firmware {release}" if release else "")
    advice = f"this cfid was tried with protocols up to {_NEWEST_PROTOCOL}: look for a newer cfid"
    is_new = protocol > _NEWEST_PROTOCOL
    answers = [DeviceAnswer("link", "warning" if is_new else "ok", versions, advice if is_new else "")]
    if name and name not in _NAMES.get(platform, (name,)):
        right = next((known for known, names in _NAMES.items() if name in names), "other")
        advice = f'rig.toml states platform = "{platform}" under [vehicle]: write "{right}", or connect that vehicle'
        answers.append(DeviceAnswer("vehicle", "warning", name, advice))
    elif name:
        answers.append(DeviceAnswer("vehicle", "ok", name))
    return answers


async def _stated(vehicle: Vehicle, question: bytes) -> str:
    """Return what the vehicle states about itself, "" where its firmware does not know the question."""

    def text(payload: bytes) -> str | None:
        if not payload.startswith(question):
            return None
        return payload.removeprefix(question).decode("ascii", "replace").strip("\0 ")

    return await vehicle.ask(Packet(PLATFORM_PORT, VERSION_CHANNEL, question), text) or ""


async def _motors(
    vehicle: Vehicle, setting: CrazyflieLink, state: VehicleState | None, idle_thrust: int
) -> DeviceAnswer:
    """Return how the motors are driven, and whether commands that turn them would be refused, apart from its state."""
    try:
        firmware = await firmware_of(vehicle, AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port))
        if state is None or not state.remedy:
            ReadyVehicle(vehicle, firmware, setting, state, idle_thrust).refuse_unfit()
        return _firmware(firmware)
    except DeviceError as error:
        return DeviceAnswer("motors", "fault", str(error).removeprefix(f"{vehicle.uri}: "))


def _firmware(firmware: Firmware) -> DeviceAnswer:
    if firmware.kind != "app":
        what = "stock firmware: thrust by parameters, ping by echo, no sine"
        advice = "a lost link does not stop these motors; firmware_patches/README.md explains how to flash the app"
        return DeviceAnswer("motors", "warning", what, advice)
    what = "cfid's app: thrust, sine, ping, and motors that stop when the link is lost"
    if firmware.knows_owners:
        return DeviceAnswer("motors", "ok", what)
    advice = "another program's keep-alives prolong this one's commands: flash the app that came with this cfid"
    return DeviceAnswer("motors", "warning", f"{what}; an older version", advice)


def _state(state: VehicleState | None, cause: str) -> DeviceAnswer:
    """Return the answer about the supervisor; `cause` is what drives motors although no cfid does."""
    if cause:
        return DeviceAnswer("supervisor", "fault", state.name if state else "no state reported", cause)
    if state is None:
        return DeviceAnswer(
            "supervisor", "warning", "this firmware reports no state", "update it: 2023.02 or later does"
        )
    if state.remedy:
        return DeviceAnswer("supervisor", "fault", state.name, state.remedy)
    if Bits.FLYING in state.bits:
        return DeviceAnswer(
            "supervisor", "fault", state.name, "its motors are at zero, yet it does not land: restart it"
        )
    return DeviceAnswer("supervisor", "ok", state.name)


def _battery(volts: float | None, stop_below_v: float | None) -> DeviceAnswer:
    if volts is None:
        return DeviceAnswer("battery", "warning", "the vehicle reports no voltage", "no run ends on a low battery")
    if stop_below_v is not None and volts < stop_below_v:
        return DeviceAnswer(
            "battery", "fault", f"{volts:.2f} V", f"charge it: rig.toml stops a run below {stop_below_v:g} V"
        )
    return DeviceAnswer("battery", "ok", f"{volts:.2f} V")

"""Checks each device's identity and settings, and reports what is wrong and what to do; changes no setting."""

import socket
import time
from typing import Literal, NamedTuple

import numpy as np

from cfid.counted import counted
from cfid.errors import DeviceError
from cfid.records.rig_file import EncoderPort, LoadCellBox
from cfid.rig import box as loadcell_box
from cfid.rig.e201_port import find_encoder, lock_name, ports_to_ask, word_bits
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.rdt_port import RECEIVE_BUFFER_BYTES, enlarge
from cfid.wire import rdt
from cfid.wire.netft import Settings
from cfid.wire.rdt_status import read_status
from cfid.wire.rls import RLS_13BIT_IN_22, decode_words

_STREAM_S = 0.3
_WAIT_S = 1.0
_MOST_PASS = 0.5  # fraction of words; more pass where the width is right
_REACH = "check power, cable, and devices.loadcell.address in rig.toml"

State = Literal["ok", "warning", "fault"]


class DeviceAnswer(NamedTuple):
    """A question to a device, its answer, what to do where the answer is not as it should be, and any limit."""

    asked: str
    state: State
    answer: str
    advice: str = ""
    limit: str = ""


def check_encoder(setting: EncoderPort, *, counts_per_turn: float | str) -> list[DeviceAnswer]:
    """Check the identity of the encoder's interface, its word's width and a position.

    An interface that a recording holds is left alone: replies could go to either of the two.
    """
    try:
        for port in ports_to_ask(setting.port):
            if holder := holder_of(lock_name(port)):
                held = f"{port} is held by {holder}"
                return [DeviceAnswer("port", "ok", held, "skipped: the check would take replies from it")]
        found = find_encoder(setting.port, counts_per_turn=counts_per_turn, configure=False)
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
    if counts_per_turn == RLS_13BIT_IN_22 and not decode_words(np.array(found.positions)).valid.mean() > _MOST_PASS:
        advice = "no 13-bit position in 22 bits: set encoder.counts_per_turn in rig.toml to its counts per turn"
        return [named, DeviceAnswer("word", "fault", f"{bits}, position {found.positions[0]}", advice)]
    return [named, DeviceAnswer("word", "ok", f"{bits}, position {found.positions[0]}, {stamped}")]


def check_loadcell(setting: LoadCellBox) -> list[DeviceAnswer]:
    """Check the load cell's box over HTTP, TCP and UDP.

    While a recording holds it, UDP is left alone: the box answers one client only, and a second one takes
    the stream from the first.
    """
    try:
        setting = loadcell_box.resolved(setting)
    except DeviceError as error:
        return [DeviceAnswer("address", "fault", str(error))]
    settings, over_http = _http(setting)
    over_tcp = _tcp(setting, settings)
    found = [over_http, over_tcp]
    where = f"{setting.address}:{setting.rdt_port}"
    try:
        if holder := holder_of(where):
            held = DeviceAnswer(
                "RDT, UDP", "ok", f"held by {holder}", "skipped: the check would take the stream from it"
            )
            return [*found, held]
        if over_tcp.state == "fault" if settings is None else not settings.rdt_enabled:
            return found
        with DeviceLock.take(where):
            return [*found, *_udp(setting, settings, alive=over_tcp.state != "fault")]
    except DeviceError as error:  # another program took its lock just now
        return [*found, DeviceAnswer("RDT, UDP", "fault", str(error), "check again when nothing else uses the box")]


def _http(setting: LoadCellBox) -> tuple[Settings | None, DeviceAnswer]:
    try:
        settings = loadcell_box.read_settings(setting)
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


def _tcp(setting: LoadCellBox, settings: Settings | None) -> DeviceAnswer:
    try:
        reading = loadcell_box.read_once(setting)
    except DeviceError as error:
        return DeviceAnswer("reading, TCP", "fault", str(error), _REACH)
    status = read_status(reading.status << 16, settings.family if settings else "netft")
    if status.faults:
        return DeviceAnswer(
            "reading, TCP", "fault", ", ".join(status.faults), "take the load off; switch the box off and on"
        )
    if status.warnings:
        return DeviceAnswer("reading, TCP", "warning", ", ".join(status.warnings), "not a fault: recordings go on")
    return DeviceAnswer("reading, TCP", "ok", "healthy")


def _udp(setting: LoadCellBox, settings: Settings | None, *, alive: bool) -> list[DeviceAnswer]:
    rate_hz = settings.rate_hz if settings else rdt.INTERNAL_HZ
    expected = max(int(rate_hz * _STREAM_S), 2)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        granted = enlarge(line)
        got, foreign = _streamed(line, (setting.address, setting.rdt_port), expected)
    others = f", {foreign} datagrams from other addresses" if foreign else ""
    return [_stream(got, expected, others, alive=alive), judge_buffer(granted)]


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


def _streamed(line: socket.socket, box: tuple[str, int], records: int) -> tuple[int, int]:
    """Request records; return how many came, and how many datagrams came from other addresses."""
    got = foreign = 0
    try:
        line.sendto(rdt.encode_request(rdt.Request(rdt.Command.BUFFERED, records)), box)
        end_s = time.monotonic() + _STREAM_S + _WAIT_S
        while got < records and (left_s := end_s - time.monotonic()) > 0:
            line.settimeout(left_s)
            datagram, source = line.recvfrom(2048)
            if source == box and rdt.is_block(len(datagram)):
                got += len(datagram) // rdt.RECORD_BYTES
            else:
                foreign += source != box
    except OSError:  # the time is over, or the network has no route to the box
        pass
    finally:
        _stop(line, box)
    return got, foreign


def _stop(line: socket.socket, box: tuple[str, int]) -> None:
    try:
        line.sendto(rdt.encode_request(rdt.Request(rdt.Command.STOP)), box)
    except OSError:  # then the request for records was not sent either
        return

"""Connects to a vehicle: its protocol, and its tables of log variables and parameters, which a cache keeps."""

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from platformdirs import user_cache_path

from cfid.errors import ConfigError, DeviceError
from cfid.records.files import write_whole
from cfid.rig.hardware import Hardware
from cfid.rig.link import Link
from cfid.rig.vehicle import Vehicle, asked
from cfid.wire import crtp
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_PORT, PARAMETER_PORT, TABLE_CHANNEL, Packet, TableInfo, Variable
from cfid.wire.supervisor import PLATFORM_PORT, VERSION_CHANNEL

OLDEST_PROTOCOL = 4  # from 2018 on: the first with 16-bit tables

_PROTOCOL = b"\0"  # a question about versions
_ANSWER_S, _TRIES = 0.1, 20
_CONNECT_S = 30.0  # tables of a real vehicle come in a second


def connect(uri: str, hardware: Hardware) -> Vehicle:
    """Open a link and read the vehicle's tables; log blocks of earlier connections are deleted.

    Raises DeviceError naming how far that got: no such address, no radio, no answer, not a Crazyflie, too old, a link
    that loses packets.
    """
    link = hardware.link(uri)
    try:
        vehicle = Vehicle(link, hardware)
        asked(vehicle, partial(_read, link))
    except BaseException:
        link.close()
        raise
    return vehicle


async def _read(link: Link, vehicle: Vehicle) -> None:
    link.firmware_protocol = await _protocol(link, vehicle)
    if link.firmware_protocol < OLDEST_PROTOCOL:
        raise DeviceError(
            f"{link.uri}: the vehicle speaks version {link.firmware_protocol} of its protocol, cfid needs "
            f"{OLDEST_PROTOCOL} or newer: update its firmware."
        )
    end_s = vehicle.hardware.seconds() + _CONNECT_S
    reset = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.RESET_LOG)

    def is_reset(payload: bytes) -> bool | None:
        answer = crtp.decode_log_answer(payload)
        return True if answer is not None and answer.command == crtp.RESET_LOG[0] else None

    if await vehicle.ask(reset, is_reset, within_s=_ANSWER_S, tries=_TRIES) is None:
        raise _incomplete(link)
    link.variables = await _table(link, vehicle, LOG_PORT, end_s)
    link.parameters = await _table(link, vehicle, PARAMETER_PORT, end_s)


async def _protocol(link: Link, vehicle: Vehicle) -> int:
    """Return the version of the protocol. Raises DeviceError where nothing answers, or no Crazyflie does."""

    def version(payload: bytes) -> int | None:
        return payload[1] if payload[:1] == _PROTOCOL and len(payload) > 1 else None

    request = Packet(PLATFORM_PORT, VERSION_CHANNEL, _PROTOCOL)
    protocol = await vehicle.ask(request, version, within_s=_ANSWER_S, tries=_TRIES)
    if protocol is not None:
        return protocol
    if link.received_s:
        raise DeviceError(
            f"{link.uri}: the device that answers is no Crazyflie, or its link loses most packets: asked {_TRIES} "
            "times, it stated no version of its protocol."
        )
    raise DeviceError(
        f"{link.uri}: no answer within {_TRIES * _ANSWER_S:g} s. Is the vehicle on, and does this URI state its "
        "channel, data rate and address?"
    )


async def _table(link: Link, vehicle: Vehicle, port: int, end_s: float) -> Mapping[str, Variable]:
    """Return a table by name, from the cache where its size and checksum are known."""
    request = Packet(port, TABLE_CHANNEL, crtp.TABLE_INFO)
    info = await vehicle.ask(request, crtp.decode_table_info, within_s=_ANSWER_S, tries=_TRIES)
    if info is None:
        raise _incomplete(link)
    file = user_cache_path("cfid") / "crazyflie-tables" / f"{port}-{info.size}-{info.checksum:08x}.json"
    table = _cached(file)
    if table is None:
        table = await _entries(link, vehicle, port, info, end_s)
        _cache(file, table)
    return table


async def _entries(link: Link, vehicle: Vehicle, port: int, info: TableInfo, end_s: float) -> Mapping[str, Variable]:
    """Read all entries, several at once, and those again whose request or answer was lost."""
    entries: dict[int, tuple[str, Variable]] = {}
    # A radio link holds some more requests than these.
    while missing := [number for number in range(info.size) if number not in entries][:8]:

        def came(payload: bytes, missing: list[int] = missing) -> bool | None:
            entry = crtp.decode_table_entry(port, payload)
            if entry is not None:
                entries[entry[1].number] = entry
            return True if entries.keys() >= set(missing) else None

        if vehicle.hardware.seconds() > end_s:
            raise _incomplete(link)
        for number in missing:
            vehicle.send(port, TABLE_CHANNEL, crtp.encode_table_entry(number))
        await vehicle.next((port, TABLE_CHANNEL), came, within_s=_ANSWER_S)
    return {name: variable for name, variable in entries.values() if variable.kind}


def _incomplete(link: Link) -> DeviceError:
    return DeviceError(
        f"{link.uri}: the vehicle answers, but no connection was completed within {_CONNECT_S:g} s: the link loses "
        "packets. Bring the vehicle closer, change the channel, or quieten the network."
    )


def _cached(file: Path) -> Mapping[str, Variable] | None:
    """Return a table that was read before, None where there is none, or no whole one."""
    try:
        return {
            name: Variable(int(number), str(kind)) for name, (number, kind) in json.loads(file.read_bytes()).items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        return None


def _cache(file: Path, table: Mapping[str, Variable]) -> None:
    """Keep a table for the next connection; without a folder for it, the table is read each time."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, json.dumps(table).encode())
    except (OSError, ConfigError):
        return

"""Reads a vehicle's state, a log variable or a parameter over an open link, before a loop runs."""

import time
from typing import TypeVar

from cfid.errors import DeviceError
from cfid.rig.crazyflie import Link
from cfid.units import MOTORS
from cfid.wire import crtp
from cfid.wire.crtp import (
    LOG_CONTROL_CHANNEL,
    LOG_DATA_CHANNEL,
    LOG_PORT,
    PARAMETER_PORT,
    READ_CHANNEL,
    Packet,
    decode_read_parameter,
    encode_read_parameter,
)
from cfid.wire.supervisor import (
    ASK_STATE,
    INFO_CHANNEL,
    INFO_VARIABLE,
    PORT_SINCE,
    SUPERVISOR_PORT,
    VehicleState,
    decode_state,
)

Answer = TypeVar("Answer")

APPLIED = tuple(f"motor.m{motor}" for motor in MOTORS)  # the commands that finally reach the motors

_BLOCK = 199
_PERIOD_MS = 20
_ROW_S = 0.3
_TRIES = 5


def state_of(link: Link) -> VehicleState | None:
    """Return the supervisor's state, None where the firmware reports none. Raises DeviceError when the link is gone."""
    if link.firmware_protocol >= PORT_SINCE:

        def answered(packet: Packet) -> VehicleState | None:
            return decode_state(packet.payload) if packet[:2] == (SUPERVISOR_PORT, INFO_CHANNEL) else None

        return _answered(link, link.ask(ASK_STATE, answered, tries=_TRIES), "its state")
    word = logged(link, INFO_VARIABLE)
    return None if word is None else VehicleState.of(int(word))


def logged(link: Link, name: str) -> float | None:
    """Return a log variable's value, None where it does not exist. Raises DeviceError when the link is gone."""
    variable = link.variable(name)
    if variable is None:
        return None

    def answered(packet: Packet) -> bool | None:
        return True if packet[:2] == (LOG_PORT, LOG_CONTROL_CHANNEL) else None

    def row(packet: Packet) -> float | None:
        if packet[:2] != (LOG_PORT, LOG_DATA_CHANNEL):
            return None
        read = crtp.decode_log_row(_BLOCK, [variable], packet.payload)
        return None if read is None else read[1][0]

    link.ask(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_create_log(_BLOCK, [variable])), answered)
    start = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_start_log(_BLOCK, _PERIOD_MS))
    value = link.ask(start, row, within_s=_ROW_S)
    for end in (crtp.encode_stop_log(_BLOCK), crtp.encode_delete_log(_BLOCK)):
        link.send(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, end))
    time.sleep(0.02)  # closing the link does not wait until these have left
    return value


def parameter_of(link: Link, name: str) -> float | None:
    """Return a parameter's value, None where it does not exist. Raises DeviceError when the link is gone."""
    parameter = link.parameter(name)
    if parameter is None:
        return None

    def value(packet: Packet) -> float | None:
        if packet[:2] != (PARAMETER_PORT, READ_CHANNEL):
            return None
        return decode_read_parameter(parameter, packet.payload)

    found = link.ask(Packet(PARAMETER_PORT, READ_CHANNEL, encode_read_parameter(parameter)), value, tries=_TRIES)
    return _answered(link, found, name)


def _answered(link: Link, answer: Answer | None, what: str) -> Answer:
    if answer is None:
        raise DeviceError(f"{link.uri}: the vehicle did not report {what}: the link loses packets.")
    return answer

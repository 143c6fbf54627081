"""The packets of a stop, repeated until the vehicle acknowledges them.

They need none of the vehicle's tables and are obeyed from any client: firmware sets a parameter by its name (at least
from 2019 on), and cfid's app takes a stop from anyone.
"""

import contextlib
import errno
import time
from collections.abc import Iterator
from typing import Literal, NamedTuple

from cfid.errors import DeviceError
from cfid.rig.hardware import Hardware
from cfid.rig.link import Link
from cfid.units import MOTORS
from cfid.wire import app
from cfid.wire.app import AppPorts, PingChannel
from cfid.wire.crtp import BY_NAME_CHANNEL, PARAMETER_PORT, Packet, decode_set_by_name, encode_set_by_name
from cfid.wire.supervisor import VehicleState

Kind = Literal["app", "stock"]

MAY_BE_RUNNING = "THE MOTORS MAY STILL BE RUNNING. KEEP CLEAR AND PULL THE BATTERY"
OVERRIDES = {"motorPowerSet.enable": "B", **{f"motorPowerSet.m{motor}": "H" for motor in MOTORS}}
WITHIN_S = 0.1
TRIES = 20  # so that the stop gets through a link that is disturbed for two seconds

_TURN_S = 0.04  # longer than an answer takes over most radios, and short where one of a few packets was lost
_TURNS = 50
_TURNS_FOR_THE_APP = 8  # an app answers at least one of them
_SILENT_TURNS = 13  # without any answer: connecting in full then finds the reason


class Acknowledged(NamedTuple):
    """What a vehicle acknowledged of a stop: zero commands of the app, and zero in the motorPowerSet parameters.

    `after_s` counts from the first packet to the last of these answers.
    """

    by_app: bool
    by_parameters: bool
    after_s: float


class Stopped(NamedTuple):
    """A stop that the vehicle confirmed: its firmware, the time since the first packet in s, and its state."""

    kind: Kind
    after_s: float
    state: VehicleState | None


def stop_over(link: Link, ports: AppPorts, hardware: Hardware) -> Acknowledged:
    """Send every kind of stop until the vehicle has acknowledged those that it knows."""
    began_s = last_s = hardware.seconds()
    number = 1 << 31 | time.time_ns() & (1 << 31) - 1  # no process that counts from zero uses this number
    stop = Packet(ports.ping, PingChannel.STOP, app.encode_alive(number))
    unanswered = dict(OVERRIDES)
    by_app = answered = False
    for turn in range(_TURNS):
        with contextlib.suppress(DeviceError):  # no program listens there, or a driver takes nothing, at the moment
            for packet in [*([] if by_app else [stop]), *(_clear(name, kind) for name, kind in unanswered.items())]:
                link.send(packet)
        for packet in arriving(link, hardware, within_s=_TURN_S):
            answered = True
            cleared = [name for name in unanswered if _is_cleared(name, packet)]
            if cleared:
                del unanswered[cleared[0]]
            elif _is_stopped(packet, stop, number):
                by_app = True
            else:
                continue
            last_s = hardware.seconds()
            if by_app and not unanswered:
                return Acknowledged(True, True, last_s - began_s)
        if (not unanswered and turn + 1 >= _TURNS_FOR_THE_APP) or (not answered and turn + 1 >= _SILENT_TURNS):
            break
    return Acknowledged(by_app, not unanswered, last_s - began_s)


def arriving(link: Link, hardware: Hardware, *, within_s: float) -> Iterator[Packet]:
    """Yield the packets that arrive within a time."""
    end_s = hardware.seconds() + within_s
    while (left_s := end_s - hardware.seconds()) > 0:
        packet = link.receive(left_s)
        if packet is not None:
            yield packet


def _clear(name: str, kind: str) -> Packet:
    return Packet(PARAMETER_PORT, BY_NAME_CHANNEL, encode_set_by_name(name, kind, 0))


def _is_cleared(name: str, packet: Packet) -> bool:
    """Return whether a packet confirms that a parameter is zero, or that the firmware does not have it."""
    if packet[:2] != (PARAMETER_PORT, BY_NAME_CHANNEL):
        return False
    return decode_set_by_name(name, packet.payload) in (0, errno.ENOENT)


def _is_stopped(packet: Packet, stop: Packet, number: int) -> bool:
    """Return whether the app answers the stop of this number, with all four commands at zero."""
    state = app.decode_state(packet.payload) if packet[:2] == stop[:2] else None
    return state is not None and state.number == number and not any(state.commands)

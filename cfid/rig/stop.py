"""Stops a vehicle's motors, whatever program drives them, without waiting for that program; recovers one that crashed.

The packets of a stop need none of the vehicle's tables and are obeyed from any client: firmware sets a parameter by its
name (at least from 2019 on), and cfid's app takes a stop from anyone.
"""

import contextlib
import errno
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

from cfid.errors import DeviceError, StopError
from cfid.rig.hardware import Hardware
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock, Holder, find_holder
from cfid.units import MOTORS
from cfid.wire import app
from cfid.wire.app import AppPorts, PingChannel
from cfid.wire.crtp import BY_NAME_CHANNEL, PARAMETER_PORT, Packet, decode_set_by_name, encode_set_by_name
from cfid.wire.supervisor import PORT_SINCE, Bits, VehicleState, decode_recovery, encode_recovery

Say = Callable[[str], None]
Kind = Literal["app", "stock"]

MAY_BE_RUNNING = "THE MOTORS MAY STILL BE RUNNING. KEEP CLEAR AND PULL THE BATTERY"
OVERRIDES = {"motorPowerSet.enable": "B", **{f"motorPowerSet.m{motor}": "H" for motor in MOTORS}}
WITHIN_S = 0.1
TRIES = 20  # so that the stop gets through a link that is disturbed for two seconds

_TURN_S = 0.04  # longer than an answer takes over most radios, and short where one of a few packets was lost
_TURNS = 50
_TURNS_FOR_THE_APP = 8  # an app answers at least one of them
_SILENT_TURNS = 13  # without any answer: connecting in full then finds the reason

_RELEASE_S = 0.3
_RADIO_RELEASE_S = 3.0  # a holder releases a radio up to 2.5 s after the motors stopped
_RESUME_S = 0.5
_KILL_S = 1.0
_OPENS_S, _AGAIN_S = 0.5, 0.02
_WRITES_S = 10.0  # a recorder that is requested to end closes its run within 2 s, even on a busy computer

_ANSWERS_S, _RECOVERY_TRIES = 0.2, 5
_SETTLES_S = 0.3  # a recovered vehicle passes its checks, and may arm itself, within 0.2 s


class Stopped(NamedTuple):
    """A stop that the vehicle confirmed: its firmware, the time since the first packet in s, and its state."""

    kind: Kind
    after_s: float
    state: VehicleState | None = None


class Acknowledged(NamedTuple):
    """What a vehicle acknowledged of a stop: zero commands of the app, and zero in the motorPowerSet parameters.

    `after_s` counts from the first packet to the last of these answers.
    """

    by_app: bool
    by_parameters: bool
    after_s: float


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
        for packet in _arriving(link, hardware, within_s=_TURN_S):
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


def _arriving(link: Link, hardware: Hardware, *, within_s: float) -> Iterator[Packet]:
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


def stop_vehicle(uri: str, ports: AppPorts, hardware: Hardware, *, say: Say) -> Stopped:
    """Stop a vehicle's motors, whatever drives them, and read back that they stopped.

    Raises DeviceError for a vehicle that cannot be reached, StopError when motors may still be running.
    """
    holder = find_holder(uri)
    if holder is not None and holder.process == os.getpid():
        holder = None
    link, acknowledged = _second_link(holder, uri, hardware, say), None
    if link is not None:
        with contextlib.closing(link):
            acknowledged = stop_over(link, ports, hardware)
            if holder is not None:
                holder = None if _ends(holder) else holder
                acknowledged = stop_over(
                    link, ports, hardware
                )  # until it ended, the holder may have sent another command
    with contextlib.ExitStack() as held:
        with contextlib.suppress(DeviceError):  # another holder is no reason to let motors run
            held.enter_context(DeviceLock.take(uri))
        from cfid.rig.read_back import confirm_stop  # imports Twisted, which the motors need not wait for

        try:
            kind, acknowledged, state = confirm_stop(uri, ports, hardware, acknowledged)
        except StopError:
            raise
        except DeviceError as error:
            raise _not_read_back(error, acknowledged, driven=holder is not None) from None
        remaining = find_holder(uri)
    if remaining is not None and remaining.process != os.getpid():
        say(_what_remains(remaining, kind))
    return Stopped(kind, acknowledged.after_s, state)


def _ends(holder: Holder) -> bool:
    """Signal the process that holds the vehicle to end; return whether it gives the vehicle up at once."""
    if holder.is_ours and not holder.holds:  # it had to give up a radio already
        return True
    return holder.send(signal.SIGTERM) and not holder.is_suspended and holder.wait_for_release(_RELEASE_S)


def _second_link(holder: Holder | None, uri: str, hardware: Hardware, say: Say) -> Link | None:
    """Open a second link besides the holder's. A radio or a cable has one user: the holder has to give it up.

    Return None where no link can be opened although nothing holds the vehicle; connecting in full then reports why.
    """
    try:
        return hardware.link(uri)
    except DeviceError as error:
        if holder is None:
            return None
        if not _freed(holder, say):
            raise StopError(
                f"{MAY_BE_RUNNING}: {holder} keeps the link to {uri}, and this user cannot end it. ({error})"
            ) from None
    end_s = hardware.seconds() + _OPENS_S
    while hardware.seconds() < end_s:
        with contextlib.suppress(DeviceError):  # a process that ends releases its lock and its radio one by one
            return hardware.link(uri)
        hardware.pause(_AGAIN_S)
    return hardware.link(uri)


def _freed(holder: Holder, say: Say) -> bool:
    """Return whether a holder gave up its radio, after a signal or because it was killed."""
    patience_s = _RESUME_S if holder.is_suspended else _RADIO_RELEASE_S
    holder.send(signal.SIGTERM, signal.SIGCONT)  # one that is suspended gets the first when it continues
    if holder.wait_for_release(patience_s):
        return True
    if not holder.is_ours:
        return False
    say(f"{holder} does not end and keeps the link to itself: it is killed.")
    return not holder.send(signal.SIGKILL) or holder.wait_for_release(_KILL_S)


def _not_read_back(error: DeviceError, acknowledged: Acknowledged | None, *, driven: bool) -> DeviceError:
    """Return the error for a vehicle that could not be read back."""
    if acknowledged is not None and (acknowledged.by_app or acknowledged.by_parameters):
        return StopError(
            f"the vehicle acknowledged after {1e3 * acknowledged.after_s:.0f} ms that its motors stopped, but the stop "
            f"could not be read back: look before you touch. ({error})"
        )
    return StopError(f"{MAY_BE_RUNNING}: {error}") if driven else error


def _what_remains(holder: Holder, kind: Kind) -> str:
    if not holder.is_ours:
        return f"{holder} still drives the vehicle, and may start its motors again. This user cannot end it."
    if holder.is_suspended:
        return (
            f"{holder} is suspended and still holds the vehicle. It ends once it continues: kill -CONT {holder.process}"
        )
    again = "" if kind == "app" else " One that hangs may start the motors again."
    return (
        f"{holder} still holds the vehicle: it may be writing its run.{again} "
        f"If it has not ended in {_WRITES_S:.0f} s, end it: kill -KILL {holder.process}"
    )


def recover_vehicle(uri: str, ports: AppPorts, hardware: Hardware, *, say: Say) -> VehicleState | None:
    """Recover a crashed vehicle; return its state, also where it had not crashed, None where it reports none.

    What still drives its motors would turn them as soon as it may fly again, so that a stop comes first. Raises
    DeviceError for a vehicle that lies on its side, or that a recovery does not help, StopError when motors may run.
    """
    with DeviceLock.take(uri):
        state = stop_vehicle(uri, ports, hardware, say=say).state
        if state is not None and Bits.CRASHED in state.bits:
            if Bits.TUMBLED in state.bits:
                raise DeviceError(f"{uri}: the vehicle is crashed and lies on its side or its back: {state.remedy}.")
            with contextlib.closing(hardware.link(uri)) as link:
                if not any(_is_granted(link, hardware, protocol) for protocol in (PORT_SINCE, PORT_SINCE - 1)):
                    raise DeviceError(f"{uri}: the vehicle did not grant the recovery: turn it off and on.")
            hardware.pause(_SETTLES_S)
            state = stop_vehicle(uri, ports, hardware, say=say).state
    if state is not None and state.remedy:
        raise DeviceError(f"{uri}: the vehicle is {state.name}: {state.remedy}.")
    return state


def _is_granted(link: Link, hardware: Hardware, protocol: int) -> bool:
    """Request the recovery in a version of the protocol until it is answered; return whether it was granted."""
    request = encode_recovery(protocol=protocol)
    for _ in range(_RECOVERY_TRIES):
        link.send(request)
        for packet in _arriving(link, hardware, within_s=_ANSWERS_S):
            if packet[:2] == request[:2]:
                granted = decode_recovery(packet.payload, protocol=protocol)
                if granted is not None:
                    return granted
    return False

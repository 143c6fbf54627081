"""Stops a vehicle's motors, whatever program drives them, without waiting for it; recovers a vehicle that crashed."""

import contextlib
import os
import signal
from collections.abc import Callable, Sequence

from cfid.errors import DeviceError, StopError
from cfid.rig.hardware import Hardware
from cfid.rig.link import Link
from cfid.rig.lock import BUTTON_SIGNALS, END_SIGNALS, DeviceLock, Holder, find_holder
from cfid.rig.stop import MAY_BE_RUNNING, Acknowledged, Kind, Stopped, arriving, stop_over
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import PORT_SINCE, Bits, VehicleState, decode_recovery, encode_recovery

Say = Callable[[str], None]

_WRITES_S = 10.0  # a recorder that is requested to end closes its run within 2 s, even on a busy computer


def stop_vehicle(uri: str, ports: AppPorts, hardware: Hardware, *, say: Say, by_button: bool = False) -> Stopped:
    """Stop a vehicle's motors, whatever drives them, and read back that they stopped.

    `by_button` means that a page's button was pressed, which the run of a program that drives them then states. Raises
    DeviceError for a vehicle that cannot be reached, StopError when motors may still be running.
    """
    holder = find_holder(uri)
    if holder is not None and holder.process == os.getpid():
        holder = None
    signals = BUTTON_SIGNALS if by_button else END_SIGNALS
    link, acknowledged = _second_link(holder, uri, hardware, signals, say), None
    if link is not None:
        with contextlib.closing(link):
            acknowledged = stop_over(link, ports, hardware)
            if holder is not None:
                holder = None if _ends(holder, signals) else holder
                acknowledged = stop_over(
                    link, ports, hardware
                )  # until it ended, the holder may have sent another command
    with contextlib.ExitStack() as held:
        with contextlib.suppress(DeviceError):  # another holder is no reason to let motors run
            held.enter_context(DeviceLock(uri))
        from cfid.rig.read_back import confirm_stop  # imports Twisted, which the motors need not wait for

        try:
            stopped = confirm_stop(uri, ports, hardware, acknowledged)
        except StopError:
            raise
        except DeviceError as error:
            raise _not_read_back(error, acknowledged, driven=holder is not None) from None
        remaining = find_holder(uri)
    if remaining is not None and remaining.process != os.getpid():
        say(_what_remains(remaining, stopped.kind))
    return stopped


def _ends(holder: Holder, signals: Sequence[signal.Signals]) -> bool:
    """Signal the process that holds the vehicle to end; return whether it gives the vehicle up at once."""
    if holder.is_ours and not holder.holds:  # it had to give up a radio already
        return True
    return holder.send(*signals) and not holder.is_suspended and holder.wait_for_release(0.3)


def _second_link(
    holder: Holder | None, uri: str, hardware: Hardware, signals: Sequence[signal.Signals], say: Say
) -> Link | None:
    """Open a second link besides the holder's. A radio or a cable has one user: the holder has to give it up.

    Return None where no link can be opened although nothing holds the vehicle; connecting in full then reports why.
    """
    try:
        return hardware.link(uri)
    except DeviceError as error:
        if holder is None:
            return None
        if not _freed(holder, signals, say):
            raise StopError(
                f"{MAY_BE_RUNNING}: {holder} keeps the link to {uri}, and this user cannot end it. ({error})"
            ) from None
    end_s = hardware.seconds() + 0.5
    while hardware.seconds() < end_s:
        with contextlib.suppress(DeviceError):  # a process that ends releases its lock and its radio one by one
            return hardware.link(uri)
        hardware.pause(0.02)
    return hardware.link(uri)


def _freed(holder: Holder, signals: Sequence[signal.Signals], say: Say) -> bool:
    """Return whether a holder gave up its radio, after a signal or because it was killed."""
    # A holder releases a radio up to 2.5 s after the motors stopped.
    patience_s = 0.5 if holder.is_suspended else 3.0
    holder.send(*signals, signal.SIGCONT)  # one that is suspended gets the first ones when it continues
    if holder.wait_for_release(patience_s):
        return True
    if not holder.is_ours:
        return False
    say(f"{holder} does not end and keeps the link to itself: it is killed.")
    return not holder.send(signal.SIGKILL) or holder.wait_for_release(1.0)


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
    with DeviceLock(uri):
        state = stop_vehicle(uri, ports, hardware, say=say).state
        if state is not None and Bits.CRASHED in state.bits:
            if Bits.TUMBLED in state.bits:
                raise DeviceError(f"{uri}: the vehicle is crashed and lies on its side or its back: {state.remedy}.")
            with contextlib.closing(hardware.link(uri)) as link:
                if not any(_is_granted(link, hardware, protocol) for protocol in (PORT_SINCE, PORT_SINCE - 1)):
                    raise DeviceError(f"{uri}: the vehicle did not grant the recovery: turn it off and on.")
            # A recovered vehicle passes its checks, and may arm itself, within 0.2 s.
            hardware.pause(0.3)
            state = stop_vehicle(uri, ports, hardware, say=say).state
    if state is not None and state.remedy:
        raise DeviceError(f"{uri}: the vehicle is {state.name}: {state.remedy}.")
    return state


def _is_granted(link: Link, hardware: Hardware, protocol: int) -> bool:
    """Request the recovery in a version of the protocol until it is answered; return whether it was granted."""
    request = encode_recovery(protocol=protocol)
    for _ in range(5):
        link.send(request)
        for packet in arriving(link, hardware, within_s=0.2):
            if packet[:2] == request[:2]:
                granted = decode_recovery(packet.payload, protocol=protocol)
                if granted is not None:
                    return granted
    return False

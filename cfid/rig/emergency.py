"""Stops a vehicle's motors, whatever program drives them, without waiting for that program."""

import contextlib
import os
import signal
import time
from collections.abc import Callable
from typing import NamedTuple

from cfid.errors import DeviceError, StopError
from cfid.rig.holder import Holder
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock, find_holder
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.rig.stop_packets import Acknowledged, Kind, stop_over
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import VehicleState

Say = Callable[[str], None]
Open = Callable[[str], Link]

_LETS_GO_S = 0.3
_CLOSES_S = 3.0  # a radio: a holder releases it up to 2.5 s after the motors stopped
_WAKES_S = 0.5
_DIES_S = 1.0
_OPENS_S, _AGAIN_S = 0.5, 0.02
_WRITES_S = 10.0  # a recorder that is requested to end closes its run within 2 s, even on a busy computer


class Stopped(NamedTuple):
    """A stop that the vehicle confirmed: its firmware, the time since the first packet in s, and its state."""

    kind: Kind
    after_s: float
    state: VehicleState | None = None


def stop_vehicle(uri: str, ports: AppPorts, *, say: Say, opened: Open = Link) -> Stopped:
    """Stop a vehicle's motors, whatever drives them, and read back that they stopped.

    Raises DeviceError for a vehicle that cannot be reached, StopError when motors may still be running.
    """
    holder = find_holder(uri)
    if holder is not None and holder.process == os.getpid():
        holder = None
    line, acknowledged = _second_line(holder, uri, opened, say), None
    if line is not None:
        with contextlib.closing(line):
            acknowledged = stop_over(line, ports)
            if holder is not None:
                holder = None if _ends(holder) else holder
                acknowledged = stop_over(line, ports)  # until it ended, the holder may have sent another command
    with contextlib.ExitStack() as held:
        with contextlib.suppress(DeviceError):  # another holder is no reason to let motors run
            held.enter_context(DeviceLock.take(uri))
        from cfid.rig.read_back import confirm_stop  # imports Twisted, which the motors need not wait for

        try:
            kind, acknowledged, state = confirm_stop(uri, ports, acknowledged)
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
    return holder.send(signal.SIGTERM) and not holder.is_suspended and holder.wait_until_it_lets_go(_LETS_GO_S)


def _second_line(holder: Holder | None, uri: str, opened: Open, say: Say) -> Link | None:
    """Open a second link besides the holder's. A radio or a cable has one user: the holder has to give it up.

    Return None where no link can be opened although nothing holds the vehicle; connecting in full then reports why.
    """
    try:
        return opened(uri)
    except DeviceError as error:
        if holder is None:
            return None
        if not _freed(holder, say):
            raise StopError(
                f"{MAY_BE_RUNNING}: {holder} keeps the link to {uri}, and this user cannot end it. ({error})"
            ) from None
    end_s = time.monotonic() + _OPENS_S
    while time.monotonic() < end_s:
        with contextlib.suppress(DeviceError):  # a process that ends releases its lock and its radio one by one
            return opened(uri)
        time.sleep(_AGAIN_S)
    return opened(uri)


def _freed(holder: Holder, say: Say) -> bool:
    """Return whether a holder gave up its radio, after a signal or because it was killed."""
    patience_s = _WAKES_S if holder.is_suspended else _CLOSES_S
    holder.send(signal.SIGTERM, signal.SIGCONT)  # one that is suspended gets the first when it continues
    if holder.wait_until_it_lets_go(patience_s):
        return True
    if not holder.is_ours:
        return False
    say(f"{holder} does not end and keeps the link to itself: it is killed.")
    return not holder.send(signal.SIGKILL) or holder.wait_until_it_lets_go(_DIES_S)


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

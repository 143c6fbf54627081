"""A stop that needs nobody's help: the process that drives the vehicle is asked to end, and then not waited for."""

import contextlib
import os
import signal
from collections.abc import Callable
from typing import NamedTuple

from cfid.errors import DeviceError, StopError
from cfid.rig.holder import Holder
from cfid.rig.line import Line, open_line
from cfid.rig.lock import DeviceLock, find_holder
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.rig.stop_packets import Acknowledged, Kind, stop_over
from cfid.wire.app import Ports
from cfid.wire.supervisor import VehicleState

Say = Callable[[str], None]
Open = Callable[[str], Line]

_LETS_GO_S = 0.3
_CLOSES_S = 3.0  # a radio: it is given back up to 2.5 s after the motors stopped
_WAKES_S = 0.5
_DIES_S = 1.0


class Stopped(NamedTuple):
    """Motors that the vehicle reports stopped, how long after the first packet, what runs on it, and its state."""

    kind: Kind
    after_s: float
    state: VehicleState | None = None


def stop_vehicle(uri: str, ports: Ports, *, say: Say, opened: Open = open_line) -> Stopped:
    """Stop a vehicle's motors, whoever drives it, and read back that they stopped.

    Raises DeviceError for a vehicle that cannot be reached, StopError when motors may still be running.
    """
    holder = _end_holder(uri)
    line = _beside(holder, uri, opened, say)
    with contextlib.ExitStack() as held:
        with contextlib.suppress(DeviceError):  # whoever has it now is no reason to let motors run
            held.enter_context(DeviceLock.take(uri))
        acknowledged = None
        if line is not None:
            with contextlib.closing(line):
                acknowledged = stop_over(line, ports)
        from cfid.rig.read_back import read_back  # imports cflib, which the motors need not wait for

        try:
            kind, acknowledged, state = read_back(uri, ports, acknowledged)
        except StopError:
            raise
        except DeviceError as error:
            raise _not_read_back(error, acknowledged, driven=holder is not None) from None
        remaining = find_holder(uri)
    if remaining is not None and remaining.process != os.getpid():
        say(_what_remains(remaining, kind))
    return Stopped(kind, acknowledged.after_s, state)


def _end_holder(uri: str) -> Holder | None:
    """Ask the process that holds the vehicle to end; return it when it goes on holding it, or cannot be asked."""
    holder = find_holder(uri)
    if holder is None or holder.process == os.getpid():
        return None
    if not holder.send(signal.SIGTERM) or holder.is_suspended:
        return holder
    return None if holder.wait_until_it_lets_go(_LETS_GO_S) else holder


def _beside(holder: Holder | None, uri: str, opened: Open, say: Say) -> Line | None:
    """Open a link beside the holder's. A radio or a cable has one user: it has to be taken from the holder.

    Return None where no holder is the reason that none can be opened; connecting in full will say what is.
    """
    try:
        return opened(uri)
    except DeviceError as error:
        if holder is None:
            return None
        if not _freed(holder, say):
            raise StopError(
                f"{MAY_BE_RUNNING}: {holder} keeps the link to {uri}, and cannot be ended from here. ({error})"
            ) from None
    return opened(uri)


def _freed(holder: Holder, say: Say) -> bool:
    """Have a holder give back its radio: by itself, or killed."""
    patience_s = _WAKES_S if holder.is_suspended else _CLOSES_S
    holder.send(signal.SIGCONT)  # one that was suspended has a SIGTERM waiting
    if holder.wait_until_it_lets_go(patience_s):
        return True
    if not holder.is_ours:
        return False
    say(f"{holder} does not end and keeps the link to itself: it is killed.")
    return not holder.send(signal.SIGKILL) or holder.wait_until_it_lets_go(_DIES_S)


def _not_read_back(error: DeviceError, acknowledged: Acknowledged | None, *, driven: bool) -> DeviceError:
    """Return what to say of a vehicle that could not be asked again."""
    if acknowledged is not None and (acknowledged.by_app or acknowledged.by_parameters):
        return StopError(
            f"the motors were stopped, which the vehicle acknowledged after {1e3 * acknowledged.after_s:.0f} ms, but "
            f"not confirmed when it was asked again: look before you touch. ({error})"
        )
    return StopError(f"{MAY_BE_RUNNING}: {error}") if driven else error


def _what_remains(holder: Holder, kind: Kind) -> str:
    if not holder.is_ours:
        return f"{holder} still drives the vehicle, and may start its motors again. It cannot be ended from here."
    if holder.is_suspended:
        return (
            f"{holder} is suspended and still holds the vehicle. It ends once it goes on: kill -CONT {holder.process}"
        )
    again = "" if kind == "app" else " It may start the motors again."
    return f"{holder} does not end and holds the vehicle still.{again} End it: kill -KILL {holder.process}"

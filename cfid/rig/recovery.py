"""Recovers a vehicle that crashed, once it is upright: its motors are stopped before, and checked afterwards."""

import contextlib
import time

from cfid.errors import DeviceError
from cfid.rig.emergency import Say, stop_vehicle
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import PORT_SINCE, Bits, VehicleState, decode_recovery, encode_recovery

_ANSWERS_S, _TRIES = 0.2, 5
_SETTLES_S = 0.3  # a recovered vehicle passes its checks, and may arm itself, within 0.2 s


def recover_vehicle(uri: str, ports: AppPorts, *, say: Say) -> VehicleState | None:
    """Recover a crashed vehicle; return its state, also where it had not crashed, None where it reports none.

    What still drives its motors would turn them as soon as it may fly again, so that a stop comes first. Raises
    DeviceError for a vehicle that lies on its side, or that a recovery does not help, StopError when motors may run.
    """
    with DeviceLock.take(uri):
        state = stop_vehicle(uri, ports, say=say).state
        if state is not None and Bits.CRASHED in state.bits:
            if Bits.TUMBLED in state.bits:
                raise DeviceError(f"{uri}: the vehicle is crashed and lies on its side or its back: {state.remedy}.")
            with contextlib.closing(Link(uri)) as link:
                if not any(_granted(link, protocol) for protocol in (PORT_SINCE, PORT_SINCE - 1)):
                    raise DeviceError(f"{uri}: the vehicle did not grant the recovery: turn it off and on.")
            time.sleep(_SETTLES_S)
            state = stop_vehicle(uri, ports, say=say).state
    if state is not None and state.remedy:
        raise DeviceError(f"{uri}: the vehicle is {state.name}: {state.remedy}.")
    return state


def _granted(link: Link, protocol: int) -> bool:
    """Request the recovery in a version of the protocol until it is answered; return whether it was granted."""
    request = encode_recovery(protocol=protocol)
    for _ in range(_TRIES):
        link.send(request)
        end_s = time.monotonic() + _ANSWERS_S
        while (left_s := end_s - time.monotonic()) > 0:
            packet = link.receive(left_s)
            if packet is not None and packet[:2] == request[:2]:
                granted = decode_recovery(packet.payload, protocol=protocol)
                if granted is not None:
                    return granted
    return False

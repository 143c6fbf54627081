"""Confirms a stop over a full link with the vehicle's tables: every command is zero, and no rotor idles."""

import time
from typing import NamedTuple

from cfid.errors import DeviceError, StopError
from cfid.rig.asking import APPLIED, logged, state_of
from cfid.rig.crazyflie import Link
from cfid.rig.motors import MAY_BE_RUNNING, firmware_of
from cfid.rig.stop_packets import OVERRIDES, TRIES, WITHIN_S, Acknowledged, Kind, stop_over
from cfid.wire.app import AppPorts
from cfid.wire.crtp import (
    PARAMETER_PORT,
    READ_CHANNEL,
    WRITE_CHANNEL,
    Packet,
    Variable,
    decode_read_parameter,
    decode_write_parameter,
    encode_read_parameter,
    encode_write_parameter,
)
from cfid.wire.supervisor import VehicleState, encode_arming

_DISARMED_S = 1.0
_LOOK_S = 0.05  # a little longer than the supervisor takes to update


class ReadBack(NamedTuple):
    """A vehicle's firmware, what acknowledged the stop, and the state of its supervisor."""

    kind: Kind
    acknowledged: Acknowledged
    state: VehicleState | None


def confirm_stop(uri: str, ports: AppPorts, acknowledged: Acknowledged | None) -> ReadBack:
    """Read back that nothing drives the motors, and disarm a vehicle whose rotors idle.

    If no stop has been acknowledged yet, one is sent over this link. Raises DeviceError for a vehicle that cannot be
    reached, StopError when something still drives its motors.
    """
    link = Link.connect(uri)
    try:
        if acknowledged is None or not (acknowledged.by_app or acknowledged.by_parameters):
            acknowledged = stop_over(_FullLink(link), ports)
        kind: Kind = "app" if acknowledged.by_app else firmware_of(link, ports).kind
        if kind == "app" and not acknowledged.by_app:
            acknowledged = stop_over(_FullLink(link), ports)
            if not acknowledged.by_app:
                raise StopError(f"{MAY_BE_RUNNING}: {uri}: the app did not confirm that the motors stopped.")
        for name in OVERRIDES:
            parameter = link.parameter(name)
            if parameter is not None and not _is_zero(link, parameter):
                raise StopError(f"{MAY_BE_RUNNING}: {uri}: {name} was not seen at zero.")
        state = _disarmed(link)
        _refuse_driven(link)
        return ReadBack(kind, acknowledged, state)
    finally:
        link.close()


class _FullLink:
    """Adapts a full link to `stop_over`."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._came: list[Packet] = []

    def send(self, packet: Packet) -> None:
        self._link.send(packet)

    def receive(self, within_s: float) -> Packet | None:
        end_s = time.monotonic() + within_s
        while not self._came and time.monotonic() < end_s:
            self._came += [packet for packet, _ in self._link.arrived()]
            if not self._came:
                time.sleep(0.005)
        return self._came.pop(0) if self._came else None

    def close(self) -> None:
        """Do nothing: the code that opened the link closes it."""


def _disarmed(link: Link) -> VehicleState | None:
    """Return the vehicle's state, after disarming it where its rotors would idle otherwise."""
    end_s = time.monotonic() + _DISARMED_S
    while (state := state_of(link)) is not None and state.armed and not state.arms_itself:
        if time.monotonic() > end_s:
            raise StopError(f"{MAY_BE_RUNNING}: {link.uri}: the vehicle was not seen disarmed: its rotors may idle.")
        link.send(encode_arming(arm=False, protocol=link.firmware_protocol))
        time.sleep(_LOOK_S)
    return state


def _refuse_driven(link: Link) -> None:
    """Raise StopError when the vehicle's log shows a motor that still runs: an app on other ports drives it.

    Disarming, which is tried first, stops such a motor too; a brushed vehicle is ready again in a moment.
    """
    if not any(logged(link, name) for name in APPLIED):
        return
    link.send(encode_arming(arm=False, protocol=link.firmware_protocol))
    time.sleep(_LOOK_S)
    driven = next((int(command) for name in APPLIED if (command := logged(link, name))), 0)
    if driven:
        raise StopError(
            f"{MAY_BE_RUNNING}: {link.uri}: its log shows a motor at {driven}. Another program may drive it, or an app "
            "on other ports than devices.crazyflie in rig.toml has"
        )


def _is_zero(link: Link, parameter: Variable) -> bool:
    """Return whether a parameter reads zero; one that does not is first written by its number and read again."""
    if _read(link, parameter) == 0:
        return True

    def written(packet: Packet) -> float | None:
        return decode_write_parameter(parameter, packet.payload) if packet[:2] == write[:2] else None

    write = Packet(PARAMETER_PORT, WRITE_CHANNEL, encode_write_parameter(parameter, 0))
    link.ask(write, written, within_s=WITHIN_S, tries=TRIES)
    return _read(link, parameter) == 0


def _read(link: Link, parameter: Variable) -> float | None:
    def value(packet: Packet) -> float | None:
        return decode_read_parameter(parameter, packet.payload) if packet[:2] == ask[:2] else None

    ask = Packet(PARAMETER_PORT, READ_CHANNEL, encode_read_parameter(parameter))
    found = link.ask(ask, value, within_s=WITHIN_S, tries=TRIES)
    if found is None:
        raise DeviceError(f"{link.uri}: the vehicle no longer answers: the link is lost.")
    return found

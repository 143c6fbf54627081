"""Confirms a stop over a full link with the vehicle's tables: every command is zero, and no rotor idles."""

from cfid.errors import DeviceError, StopError
from cfid.rig.hardware import Hardware
from cfid.rig.motor_log import PowerSet, confirm_still
from cfid.rig.motors import firmware_of
from cfid.rig.stop import MAY_BE_RUNNING, OVERRIDES, Acknowledged, Kind, Stopped, stop_over
from cfid.rig.supervisor import present_state
from cfid.rig.tables import connect
from cfid.rig.vehicle import Vehicle, asked
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import VehicleState, encode_arming


def confirm_stop(uri: str, ports: AppPorts, hardware: Hardware, acknowledged: Acknowledged | None) -> Stopped:
    """Read back that nothing drives the motors, and disarm a vehicle whose rotors idle.

    If no stop has been acknowledged yet, one is sent over this link. Raises DeviceError for a vehicle that cannot be
    reached, StopError when something still drives its motors.
    """
    vehicle = connect(uri, hardware)
    try:
        if acknowledged is None or not (acknowledged.by_app or acknowledged.by_parameters):
            acknowledged = stop_over(vehicle.link, ports, hardware)
        kind: Kind = "app" if acknowledged.by_app else asked(vehicle, lambda vehicle: firmware_of(vehicle, ports)).kind
        if kind == "app" and not acknowledged.by_app:
            acknowledged = stop_over(vehicle.link, ports, hardware)
            if not acknowledged.by_app:
                raise StopError(f"{MAY_BE_RUNNING}: {uri}: the app did not confirm that the motors stopped.")
        return Stopped(kind, acknowledged.after_s, asked(vehicle, lambda vehicle: _confirmed(vehicle, kind)))
    finally:
        vehicle.link.close()


async def _confirmed(vehicle: Vehicle, kind: Kind) -> VehicleState | None:
    """Return the vehicle's state once nothing drives its motors. Raises StopError when something still does."""
    if any(vehicle.link.parameter(name) is not None for name in OVERRIDES):
        try:
            await PowerSet(vehicle).clear()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: the parameters motorPowerSet were not seen at zero. ({error})"
            ) from None
    state = await _disarmed(vehicle)
    await confirm_still(vehicle, app_feeds=kind == "app" and (state is None or state.arms_itself))
    return state


async def _disarmed(vehicle: Vehicle) -> VehicleState | None:
    """Return the vehicle's state, after disarming it where its rotors would idle otherwise."""
    end_s = vehicle.hardware.seconds() + 1.0
    while (state := await present_state(vehicle)) is not None and state.armed and not state.arms_itself:
        if vehicle.hardware.seconds() > end_s:
            raise StopError(f"{MAY_BE_RUNNING}: {vehicle.uri}: the vehicle was not seen disarmed: its rotors may idle.")
        vehicle.link.send(encode_arming(arm=False, protocol=vehicle.link.firmware_protocol))
        # This is a little longer than the supervisor takes to update.
        await vehicle.hardware.sleep(0.05)
    return state

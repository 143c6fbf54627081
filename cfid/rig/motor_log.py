"""Reads what the motors do from the vehicle's log: the commands that finally reach them, whatever program sent them."""

from cfid.errors import DeviceError, StopError
from cfid.rig.log_block import logged
from cfid.rig.motors import MAY_BE_RUNNING, Four
from cfid.rig.recorder import sleep
from cfid.rig.vehicle import Vehicle
from cfid.units import MOTORS
from cfid.wire.supervisor import encode_arming

APPLIED = tuple(f"motor.m{motor}" for motor in MOTORS)

_READY_S = 0.3  # in which a disarmed brushed vehicle is ready again, and another program may go on


async def applied_commands(vehicle: Vehicle) -> Four:
    """Return the commands that the four motors obey, all of one moment. Raises DeviceError when they are not logged."""
    m1, m2, m3, m4 = (int(command) for command in await logged(vehicle, APPLIED))
    return m1, m2, m3, m4


async def confirm_still(vehicle: Vehicle) -> None:
    """Raise StopError unless the vehicle's log shows all four motors at zero.

    A vehicle with a motor that still runs is disarmed first, which stops it, unless the parameters motorPowerSet drive
    it; a brushed vehicle is ready again in a moment.
    """
    try:
        if not any(await applied_commands(vehicle)):
            return
        vehicle.wire.send(encode_arming(arm=False, protocol=vehicle.wire.firmware_protocol))
        await sleep(vehicle.loop, _READY_S)
        commands = await applied_commands(vehicle)
    except DeviceError as error:
        raise StopError(f"{MAY_BE_RUNNING}: the log could not confirm that the motors stopped. ({error})") from None
    if any(commands):
        raise StopError(
            f"{MAY_BE_RUNNING}: {vehicle.uri}: its log shows the motors at {', '.join(map(str, commands))}. Another "
            "program may drive them, or an app on other ports than devices.crazyflie in rig.toml has"
        )

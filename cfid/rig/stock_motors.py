"""Drives motors of stock firmware through its parameters motorPowerSet, which override everything on the vehicle.

Only cfid ends these commands: disarming, tumble check and emergency stop do not, and a lost link leaves the motors
running. The supervisor still sees them turn, and would lock the vehicle where an old setpoint is in force: so cfid
relaxes the setpoint first.
"""

from cfid.errors import DeviceError, StopError
from cfid.rig.motor_log import confirm_still
from cfid.rig.motors import MAY_BE_RUNNING, STILL, STOPPED, Four, Limits
from cfid.rig.power_set import PowerSet
from cfid.rig.vehicle import Vehicle
from cfid.wire.crtp import Variable
from cfid.wire.supervisor import RELAX_SETPOINT

_EACH = 1  # value of motorPowerSet.enable
_RELAXED = 3  # times, since the vehicle does not answer this packet


class StockMotors:
    """The four motors behind the parameters motorPowerSet."""

    def __init__(self, vehicle: Vehicle, limits: Limits) -> None:
        """Take a vehicle that has the parameters. Raises DeviceError for one that lacks any."""
        self._vehicle, self._limits = vehicle, limits
        self._parameters = PowerSet(vehicle)
        self._commands: Four | None = None  # None: not known
        self._stopped = False

    def start(self) -> None:
        """Begin to monitor the link: these parameters report nothing by themselves."""
        self._vehicle.stalls.begin()

    async def set(self, commands: Four) -> float:
        """Write the commands that differ, and enable them. To stop all motors, disable them first, in one write."""
        self._limits.check_four(commands)
        before, self._commands = self._commands, None
        self._vehicle.expected = None
        began_s: float = self._vehicle.loop.seconds()
        if commands == STILL:
            await self._write(self._parameters.enable, 0)
        for place, parameter in enumerate(self._parameters.each):
            if before is None or commands[place] != before[place]:
                await self._write(parameter, commands[place])
        if commands != STILL and (before is None or before == STILL):
            for _ in range(_RELAXED):
                self._vehicle.wire.send(RELAX_SETPOINT)
            await self._write(self._parameters.enable, _EACH)
        self._commands = commands
        self._vehicle.expected = (commands, commands)
        return began_s

    def check(self) -> None:
        """Raise DeviceError when the link is lost."""
        self._vehicle.check()

    async def stop(self) -> float:
        """Disable the parameters, set them to zero, and read them and what the motors do back."""
        self._stopped, self._vehicle.expected = True, None
        began_s = self._vehicle.loop.seconds()
        try:
            await self._parameters.clear()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: stock firmware keeps motors running without a link, and did not confirm the stop. "
                f"({error})"
            ) from None
        await confirm_still(self._vehicle)
        return float(self._vehicle.loop.seconds() - began_s)

    async def _write(self, parameter: Variable, value: int) -> None:
        if self._stopped:
            raise DeviceError(STOPPED)
        await self._vehicle.write_parameter(parameter, value, tries=4)

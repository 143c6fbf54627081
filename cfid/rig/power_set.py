"""Reads and clears the parameters motorPowerSet, which override everything else on the vehicle, cfid's app included."""

from cfid.errors import DeviceError
from cfid.rig.stop_packets import TRIES, WITHIN_S
from cfid.rig.vehicle import Vehicle
from cfid.units import MOTORS
from cfid.wire.crtp import Variable


class PowerSet:
    """The five parameters of a vehicle; with `enable` at 1 each motor runs at its own parameter's command."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Take a vehicle that has them. Raises DeviceError for one that lacks any."""
        self._vehicle = vehicle
        self.enable = self._parameter("enable")
        self.each = [self._parameter(f"m{motor}") for motor in MOTORS]

    async def clear(self) -> None:
        """Disable the parameters, set all to zero and read them back. Raises DeviceError when that is not confirmed."""
        for parameter in (self.enable, *self.each):
            await self._vehicle.write_parameter(parameter, 0, within_s=WITHIN_S, tries=TRIES)
        for parameter in (self.enable, *self.each):
            if await self._vehicle.read_parameter(parameter, within_s=WITHIN_S, tries=TRIES) != 0:
                raise DeviceError(f"{self._vehicle.uri}: a parameter of motorPowerSet was set to 0 and is not.")

    def _parameter(self, name: str) -> Variable:
        found = self._vehicle.wire.parameter(f"motorPowerSet.{name}")
        if found is None:
            raise DeviceError(f"{self._vehicle.uri}: the firmware has no parameter motorPowerSet.{name}.")
        return found


async def is_overridden(vehicle: Vehicle) -> bool:
    """Return whether these parameters drive the motors. Raises DeviceError without an answer."""
    enable = vehicle.wire.parameter("motorPowerSet.enable")
    value = 0 if enable is None else await vehicle.read_parameter(enable, within_s=WITHIN_S, tries=TRIES)
    if value is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle does not report motorPowerSet.enable.")
    return value != 0

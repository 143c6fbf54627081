"""Motors of stock firmware, by its parameters motorPowerSet: they override everything, and nothing ends them but us.

Disarming, tumble check and emergency stop do not reach these motors, and they go on when the link is lost.
"""

from cfid.errors import DeviceError
from cfid.rig.motors import MAY_BE_RUNNING, MOTORS, STILL, Four, Limits
from cfid.rig.vehicle import Vehicle
from cfid.wire.crtp import (
    PARAMETER_PORT,
    READ_CHANNEL,
    Packet,
    Variable,
    decode_read_parameter,
    encode_read_parameter,
)

_EACH = 1  # as motorPowerSet.enable: m1 to m4 each as its own parameter says
_STOP_S = 0.1
_STOPS = 20  # a link that is disturbed for two seconds gets the stop through all the same


class StockMotors:
    """The four motors behind the parameters motorPowerSet."""

    def __init__(self, vehicle: Vehicle, limits: Limits) -> None:
        """Take a vehicle that has the parameters. Raises DeviceError for one that lacks any."""
        self._vehicle, self._limits = vehicle, limits
        self._enable = self._parameter("enable")
        self._each = [self._parameter(f"m{motor}") for motor in MOTORS]
        self._commands: Four | None = None

    def start(self) -> None:
        """Do nothing: the link itself is all that can be watched."""

    async def set(self, commands: Four) -> int | None:
        """Write the commands that differ, and let them count; stock firmware tells no time."""
        self._limits.check(max(commands), min(commands))
        for place, parameter in enumerate(self._each):
            if self._commands is None or commands[place] != self._commands[place]:
                await self._vehicle.write_parameter(parameter, commands[place])
        if self._commands is None:
            await self._vehicle.write_parameter(self._enable, _EACH)
        self._commands = commands
        return None

    def check(self) -> None:
        """Raise DeviceError when the link is lost."""
        self._vehicle.check()

    async def stop(self) -> None:
        """Let the parameters count no more, set them to zero, and read all of them back."""
        self._commands = None
        try:
            for parameter, wanted in [(self._enable, 0), *zip(self._each, STILL, strict=True)]:
                await self._vehicle.write_parameter(parameter, wanted, within_s=_STOP_S, tries=_STOPS)
            for parameter in (self._enable, *self._each):
                await self._see_zero(parameter)
        except DeviceError as error:
            raise DeviceError(
                f"{MAY_BE_RUNNING}: stock firmware goes on without a link, and did not confirm the stop. ({error})"
            ) from None

    async def _see_zero(self, parameter: Variable) -> None:
        def read(payload: bytes) -> bool | None:
            value = decode_read_parameter(parameter, payload)
            return None if value is None else value == 0

        request = Packet(PARAMETER_PORT, READ_CHANNEL, encode_read_parameter(parameter))
        if not await self._vehicle.ask(request, read, within_s=_STOP_S, tries=_STOPS):
            raise DeviceError(f"{self._vehicle.uri}: a parameter of motorPowerSet is not zero")

    def _parameter(self, name: str) -> Variable:
        found = self._vehicle.wire.parameter(f"motorPowerSet.{name}")
        if found is None:
            raise DeviceError(f"{self._vehicle.uri}: the firmware has no parameter motorPowerSet.{name}.")
        return found

"""Records motor commands and their times; whatever ends the recording stops the motors first.

Motors of stock firmware are driven through its parameters motorPowerSet, which override everything on the vehicle.
Only cfid ends these commands: disarming, tumble check and emergency stop do not, and a lost link leaves the motors
running. The supervisor still sees them turn, and would lock the vehicle where an old setpoint is in force: so cfid
relaxes the setpoint first.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError, StopError
from cfid.records.run import DeviceRecord
from cfid.rig.app_motors import AppMotors
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument
from cfid.rig.motor_log import PowerSet, confirm_still
from cfid.rig.motors import STILL, STOPPED, Four, Limits
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.rig.vehicle import Vehicle
from cfid.units import MOTORS
from cfid.wire.crtp import Variable
from cfid.wire.supervisor import RELAX_SETPOINT


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
        self._vehicle.begin()

    async def set(self, commands: Four) -> float:
        """Write the commands that differ, and enable them. To stop all motors, disable them first, in one write."""
        self._limits.check_four(commands)
        before, self._commands = self._commands, None
        self._vehicle.expected = None
        began_s: float = self._vehicle.hardware.seconds()
        if commands == STILL:
            await self._write(self._parameters.enable, 0)
        for place, parameter in enumerate(self._parameters.each):
            if before is None or commands[place] != before[place]:
                await self._write(parameter, commands[place])
        if commands != STILL and (before is None or before == STILL):
            # The vehicle does not answer this packet.
            for _ in range(3):
                self._vehicle.link.send(RELAX_SETPOINT)
            await self._write(self._parameters.enable, 1)
        self._commands = commands
        self._vehicle.expected = (commands, commands)
        return began_s

    def check(self) -> None:
        """Raise DeviceError when the link is lost."""
        self._vehicle.check()

    async def stop(self) -> float:
        """Disable the parameters, set them to zero, and read them and what the motors do back."""
        self._stopped, self._vehicle.expected = True, None
        self._vehicle.link.persists = True  # these motors run on without a link, which may be back in a moment
        began_s = self._vehicle.hardware.seconds()
        try:
            await self._parameters.clear()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: stock firmware keeps motors running without a link, and did not confirm the stop. "
                f"({error})"
            ) from None
        await confirm_still(self._vehicle)
        return float(self._vehicle.hardware.seconds() - began_s)

    async def _write(self, parameter: Variable, value: int) -> None:
        if self._stopped:
            raise DeviceError(STOPPED)
        await self._vehicle.write_parameter(parameter, value, tries=4)


class MotorCommands(Instrument):
    """Commands of all four motors, a row for each change, with the time at which the accepted request was sent."""

    name = "commands"
    columns = ("t", "m1", "m2", "m3", "m4")
    eventful = True

    def __init__(self, motors: AppMotors | StockMotors, record: DeviceRecord) -> None:
        """Take motors that stand still."""
        self.record = record
        self._motors = motors
        self._rows: list[tuple[float, ...]] = []
        self._commands: Four | None = None  # the last that were set; None: unknown
        self._running = False
        self._stopped_in_s: float | None = None

    def start(self, hardware: Hardware) -> None:
        """Begin to monitor the motors."""
        self._hardware = hardware
        self._running = True
        self._motors.start()
        self._note(self._hardware.seconds(), STILL)

    async def set(self, commands: Four) -> None:
        """Set the motors' commands. Raises ConfigError or DeviceError."""
        if not self._running:
            raise DeviceError(STOPPED)
        self._commands = None
        self._note(await self._motors.set(commands), commands)

    def take(self) -> Block:
        """Return the changes. Raises DeviceError when the motors can no longer be commanded."""
        if self._running:
            self._motors.check()
        rows, self._rows = self._rows, []
        return self.block(rows)

    async def stop(self) -> None:
        """Stop the motors. Raises DeviceError when it is not certain that they stopped."""
        if self._running:
            self._running = False
            if self._commands != STILL:
                self._note(self._hardware.seconds(), STILL)
            self._stopped_in_s = await self._motors.stop()

    def facts(self) -> Mapping[str, Any]:
        """Return how long the motors' stop took to be confirmed."""
        return {} if self._stopped_in_s is None else {"stopped_in_s": round(self._stopped_in_s, 4)}

    def _note(self, sent_s: float, commands: Four) -> None:
        self._commands = commands
        self._rows.append((sent_s, *commands))


def four(command: int, motors: Sequence[int]) -> Four:
    """Return the four commands: `command` for some of the motors 1 to 4, zero for the others."""
    m1, m2, m3, m4 = (command if motor in motors else 0 for motor in MOTORS)
    return m1, m2, m3, m4


async def hold(
    commands: MotorCommands, command: int, motors: Sequence[int], *, for_s: float | None, hardware: Hardware
) -> None:
    """Hold one command for `for_s` seconds, or until the procedure is cancelled."""
    await commands.set(four(command, motors))
    await (Deferred[None]() if for_s is None else hardware.sleep(for_s))

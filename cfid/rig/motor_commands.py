"""Records motor commands and their times; whatever ends the recording stops the motors first."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from twisted.internet.defer import Deferred

from cfid.errors import DeviceError
from cfid.rig.app_motors import AppMotors
from cfid.rig.clock import HostClock
from cfid.rig.motors import STILL, STOPPED, Four
from cfid.rig.recorder import Block, no_rows, sleep
from cfid.rig.stock_motors import StockMotors
from cfid.rig.vehicle import OnALink
from cfid.units import MOTORS


class MotorCommands(OnALink):
    """Commands of all four motors, a row for each change, with the time at which the accepted request was sent.

    `whole` is set once all requested commands have been held, and the run may end.
    """

    name = "commands"
    columns = ("t", "m1", "m2", "m3", "m4")

    def __init__(self, motors: AppMotors | StockMotors, *, loop: Any, clock: HostClock) -> None:
        """Take motors that stand still."""
        self._motors, self._loop, self._clock = motors, loop, clock
        self._rows: list[tuple[float, Four]] = []
        self._commands: Four | None = None  # the last that were set; None: unknown
        self._running = False
        self._stopped_in_s: float | None = None
        self.whole = False

    def start(self) -> None:
        """Begin to monitor the motors."""
        self._running = True
        self._motors.start()
        self._note(self._loop.seconds(), STILL)

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
        if not rows:
            return Block(no_rows(len(self.columns)))
        times_s = self._clock.unix_s(np.array([time_s for time_s, _ in rows]))
        return Block((times_s, *np.array([commands for _, commands in rows]).T))

    async def stop(self) -> None:
        """Stop the motors. Raises DeviceError when it is not certain that they stopped."""
        if self._running:
            self._running = False
            if self._commands != STILL:
                self._note(self._loop.seconds(), STILL)
            self._stopped_in_s = await self._motors.stop()

    def facts(self) -> Mapping[str, Any]:
        """Return how long the motors' stop took to be confirmed."""
        return {} if self._stopped_in_s is None else {"stopped_in_s": round(self._stopped_in_s, 4)}

    def _note(self, sent_s: float, commands: Four) -> None:
        self._commands = commands
        self._rows.append((sent_s, commands))


def four(command: int, motors: Sequence[int]) -> Four:
    """Return the four commands: `command` for some of the motors 1 to 4, zero for the others."""
    m1, m2, m3, m4 = (command if motor in motors else 0 for motor in MOTORS)
    return m1, m2, m3, m4


async def hold(commands: MotorCommands, command: int, motors: Sequence[int], *, for_s: float | None, loop: Any) -> None:
    """Hold one command for `for_s` seconds, or until the procedure is cancelled."""
    await commands.set(four(command, motors))
    await (Deferred[None]() if for_s is None else sleep(loop, for_s))

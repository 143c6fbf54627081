"""Runs `cfid motors stop` in a process of its own: it needs neither the recorder nor this one."""

import asyncio
import sys
from pathlib import Path
from typing import NamedTuple

from cfid.rig.motors import MAY_BE_RUNNING

_LONGEST_S = 30.0  # a holder of a radio is given some seconds, a vehicle that does not answer some more


class StopReport(NamedTuple):
    """Whether the stop was confirmed, and what the command printed."""

    stopped: bool
    text: str


class MotorStop:
    """The stop of a campaign's vehicle. Presses of a button while one runs get its result."""

    def __init__(self, campaign: Path) -> None:
        """Take the campaign's folder, whose rig.toml names the vehicle."""
        self._campaign = campaign
        self._running: asyncio.Task[StopReport] | None = None

    async def press(self) -> StopReport:
        """Stop all motors; return whether the vehicle confirmed it."""
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._stopped())
        return await asyncio.shield(self._running)

    async def _stopped(self) -> StopReport:
        command = [sys.executable, "-m", "cfid.cli.main", "motors", "stop", "--campaign", str(self._campaign)]
        try:
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C of the page's server does not end a stop
            )
        except OSError as error:
            return StopReport(False, f"{MAY_BE_RUNNING}: cfid motors stop cannot be started: {error.strerror}.")
        try:
            printed, _ = await asyncio.wait_for(process.communicate(), _LONGEST_S)
        except TimeoutError:
            process.kill()
            return StopReport(False, f"{MAY_BE_RUNNING}: no confirmation within {_LONGEST_S:.0f} s.")
        return StopReport(process.returncode == 0, printed.decode("utf-8", "replace").strip())

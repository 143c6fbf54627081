"""Runs `cfid motors stop` in a process of its own: it needs neither the recorder nor this one."""

import asyncio
import sys
from pathlib import Path
from typing import NamedTuple

from cfid.records.rig_file import RIG_FILE
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.watch.live_run import LiveRun

_LONGEST_S = 30.0  # a holder of a radio is given some seconds, a vehicle that does not answer some more


class StopReport(NamedTuple):
    """Whether the stop was confirmed, and what the command printed."""

    stopped: bool
    text: str


class MotorStop:
    """The stop of the vehicle that a page is about. Presses of a button while one runs get its result."""

    def __init__(self, campaign: Path | None) -> None:
        """Take the folder of the page's campaign, None where there is none."""
        self._campaign = campaign
        self._running: asyncio.Task[StopReport] | None = None

    async def press(self, run: LiveRun | None) -> StopReport:
        """Stop all motors of the vehicle that a shown run drives, else of its campaign's or the page's vehicle.

        Returns whether the vehicle confirmed it.
        """
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._stopped(run))
        return await asyncio.shield(self._running)

    async def _stopped(self, run: LiveRun | None) -> StopReport:
        driven = None if run is None else run.driven
        campaign = self._campaign if run is None else _campaign_of(run) or self._campaign
        words = [] if driven is None else [f"--uri={driven}"]
        words += [] if campaign is None else ["--campaign", str(campaign)]
        failed = "NOT STOPPED" if driven is None else MAY_BE_RUNNING
        try:
            process = await asyncio.create_subprocess_exec(
                *[sys.executable, "-m", "cfid.cli.main", "motors", "stop", *words],
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
        text = printed.decode("utf-8", "replace").strip()
        if process.returncode == 0 or MAY_BE_RUNNING in text:
            return StopReport(process.returncode == 0, text)
        return StopReport(False, f"{failed}: {text}")


def _campaign_of(run: LiveRun) -> Path | None:
    """Return the folder of a run's campaign, whose rig.toml need not be valid; None for a run that lies elsewhere."""
    folder = run.folder.resolve().parent.parent
    return folder if (folder / RIG_FILE).is_file() else None

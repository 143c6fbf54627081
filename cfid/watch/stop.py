"""Runs `cfid motors stop` in its own process, which needs neither the recorder nor this process."""

import asyncio
from pathlib import Path
from typing import NamedTuple

from cfid.console.processes import cfid_command
from cfid.records.rig_file import RIG_FILE
from cfid.rig.address import resolved
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.watch.live_run import LiveRun

_LONGEST_S = 30.0  # a holder of a radio is given some seconds, a vehicle that does not answer some more


class StopReport(NamedTuple):
    """Whether the stop was confirmed, and what the command printed."""

    stopped: bool
    text: str


class MotorStop:
    """The stop of the vehicles that a page is about. A press of the button while a stop runs gets its result."""

    def __init__(self, campaign: Path | None) -> None:
        """Take the folder of the page's campaign, None where there is none."""
        self._campaign = campaign
        self._running: asyncio.Task[StopReport] | None = None

    async def press(self, run: LiveRun | None) -> StopReport:
        """Stop all motors of every vehicle that a shown run and those recorded beside it drive, all at once.

        Where no run drives one, stop the vehicle of the run's campaign, or of the page's. Return whether every vehicle
        confirmed the stop.
        """
        if self._running is None or self._running.done():
            self._running = asyncio.create_task(self._stopped(run))
        return await asyncio.shield(self._running)

    async def _stopped(self, run: LiveRun | None) -> StopReport:
        driven = () if run is None else run.driven
        campaign = self._campaign if run is None else _campaign_of(run) or self._campaign
        where = [] if campaign is None else ["--campaign", str(campaign)]
        if not driven:
            return await _stop(where, failed="NOT STOPPED")
        reports = await asyncio.gather(*(_stop([f"--uri={uri}", *where], failed=MAY_BE_RUNNING) for uri in driven))
        lines = [line for report in reports for line in report.text.splitlines() if not _asks_for_one_of(line, driven)]
        return StopReport(all(report.stopped for report in reports), "\n".join(lines))


async def _stop(words: list[str], *, failed: str) -> StopReport:
    """Run `cfid motors stop` with these options; `failed` begins the text of a failure that states no danger itself."""
    try:
        process = await asyncio.create_subprocess_exec(
            *cfid_command("motors", "stop", *words),
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


def _asks_for_one_of(line: str, driven: tuple[str, ...]) -> bool:
    """Return whether a line advises stopping one of these vehicles, each of which has its own stopping process."""
    return any(line.endswith(f"cfid motors stop --uri {resolved(uri)}") for uri in driven)


def _campaign_of(run: LiveRun) -> Path | None:
    """Return the folder of a run's campaign, whose rig.toml need not be valid; None for a run that lies elsewhere."""
    folder = run.folder.resolve().parent.parent
    return folder if (folder / RIG_FILE).is_file() else None

"""Stops the vehicles that a page is about, by `cfid motors stop` in processes that need neither recorder nor server."""

import subprocess
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from cfid.console.processes import cfid_command
from cfid.errors import ConfigError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig
from cfid.rig.lock import resolved, vehicles_locked
from cfid.rig.sim_file import devices_in
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.watch.driven import vehicles_of
from cfid.watch.live_run import LiveRun
from cfid.watch.watched import Watched

_LONGEST_S = 30.0  # a holder of a radio is given some seconds, a vehicle that does not answer some more


class StopReport(NamedTuple):
    """Whether the stop was confirmed, and what the command printed."""

    stopped: bool
    text: str


class MotorStop:
    """The stop of the vehicles that a page is about. A press of the button while a stop runs gets its result."""

    def __init__(self, watched: Watched, campaign: Path | None) -> None:
        """Take what the page shows, and the folder of its campaign, None where there is none."""
        self._watched, self._campaign = watched, campaign
        self._pressed = threading.Lock()
        self._processes = ThreadPoolExecutor()
        self._running: Future[StopReport] | None = None

    def vehicles(self) -> tuple[str, ...]:
        """Return the addresses of the vehicles that the button stops, never those of other campaigns.

        They are the vehicles that the shown run and those recorded beside it drive. Where none is driven, they are the
        one that the shown run drove, and the one that its campaign's rig.toml names: it may run without a recording.
        """
        run = self._watched.run
        if run is not None and run.driven:
            return run.driven
        drove = () if run is None else vehicles_of(run.header)
        return tuple({resolved(uri): uri for uri in (*drove, *self._named(run))}.values())

    def press(self) -> StopReport:
        """Stop all motors of these vehicles, all at once; return whether every vehicle confirmed the stop.

        May be called from several threads.
        """
        with self._pressed:
            if self._running is None or self._running.done():
                self._watched.look_for_newer()  # nothing has looked where the plots were not loaded
                self._running = self._processes.submit(self._stopped)
        return self._running.result()

    def _stopped(self) -> StopReport:
        run, vehicles = self._watched.run, self.vehicles()
        failed = "NOT STOPPED" if run is None or not run.driven else MAY_BE_RUNNING
        campaign = self._campaign_of(run)
        where = [] if campaign is None else ["--campaign", str(campaign)]
        if not vehicles:
            if others := vehicles_locked():
                advice = ", or ".join(f"cfid motors stop --uri {uri}" for uri in others)
                return StopReport(False, f"{failed}: no run here has a vehicle. Programs hold others: {advice}.")
            return _stop(where, failed)
        reports = list(self._processes.map(lambda uri: _stop([f"--uri={uri}", *where], failed), vehicles))
        lines = [
            line for report in reports for line in report.text.splitlines() if not _asks_for_one_of(line, vehicles)
        ]
        return StopReport(all(report.stopped for report in reports), "\n".join(lines))

    def _named(self, run: LiveRun | None) -> tuple[str, ...]:
        """Return the vehicle that the campaign's rig.toml names; none where it names none, or is invalid."""
        campaign = self._campaign_of(run)
        try:
            rig = None if campaign is None else load_rig(campaign / RIG_FILE)
            uri = "" if campaign is None or rig is None else devices_in(campaign, rig)[0].crazyflie.uri
        except ConfigError:
            return ()
        return (uri,) if uri else ()

    def _campaign_of(self, run: LiveRun | None) -> Path | None:
        """Return the folder of a run's campaign, else the page's; its rig.toml need not be valid."""
        folder = None if run is None else run.folder.resolve().parent.parent
        return folder if folder is not None and (folder / RIG_FILE).is_file() else self._campaign


def _stop(words: list[str], failed: str) -> StopReport:
    """Run `cfid motors stop` with these options; `failed` begins the text of a failure that states no danger itself."""
    try:
        ended = subprocess.run(
            cfid_command("motors", "stop", *words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C of the page's server does not end a stop
            timeout=_LONGEST_S,
            check=False,
        )
    except OSError as error:
        return StopReport(False, f"{MAY_BE_RUNNING}: cfid motors stop cannot be started: {error.strerror}.")
    except subprocess.TimeoutExpired:
        return StopReport(False, f"{MAY_BE_RUNNING}: no confirmation within {_LONGEST_S:.0f} s.")
    text = ended.stdout.decode("utf-8", "replace").strip()
    if ended.returncode == 0 or MAY_BE_RUNNING in text:
        return StopReport(ended.returncode == 0, text)
    return StopReport(False, f"{failed}: {text}")


def _asks_for_one_of(line: str, vehicles: tuple[str, ...]) -> bool:
    """Return whether a line advises stopping one of these vehicles, each of which has its own stopping process."""
    return any(line.endswith(f"cfid motors stop --uri {resolved(uri)}") for uri in vehicles)

"""Stops the vehicles that a page is about, by `cfid motors stop` in processes that need neither recorder nor server."""

import subprocess
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from cfid.console.program import cfid_command
from cfid.errors import ConfigError, DataError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig
from cfid.records.run import RECORDER_FILE, RunHeader, read_run
from cfid.rig.lock import resolved, vehicles_locked
from cfid.rig.sim_file import devices_in
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.watch.live_run import LiveRun, ShownRun

_LONGEST_S = 30.0  # a holder of a radio is given some seconds, a vehicle that does not answer some more


class StopReport(NamedTuple):
    """Whether the stop was confirmed, and what the command printed."""

    stopped: bool
    text: str


class MotorStop:
    """The stop of the vehicles that a page is about. A press of the button while a stop runs gets its result."""

    def __init__(self, shown: ShownRun, campaign: Path | None) -> None:
        """Take what the page shows, and the folder of its campaign, None where there is none."""
        self._shown, self._campaign = shown, campaign
        self._pressed = threading.Lock()
        self._processes = ThreadPoolExecutor()
        self._running: Future[StopReport] | None = None

    def vehicles(self) -> tuple[str, ...]:
        """Return the addresses of the vehicles that the button stops, never those of other campaigns.

        They are the vehicles that the shown run and those recorded beside it drive. Where none is driven, they are the
        one that the shown run drove, and the one that its campaign's rig.toml names: it may run without a recording.
        """
        run = self._shown.run
        if driven := vehicles_driven(run):
            return driven
        stopped = [] if run is None else vehicles_of(run.header)
        if campaign := self._of_run():
            with suppress(ConfigError):  # an invalid rig.toml names none
                devices, _ = devices_in(campaign, load_rig(campaign / RIG_FILE))
                stopped += [devices.crazyflie.uri] if devices.crazyflie.uri else []
        return tuple({resolved(uri): uri for uri in stopped}.values())

    def press(self) -> StopReport:
        """Stop all motors of these vehicles, all at once; return whether every vehicle confirmed the stop.

        May be called from several threads.
        """
        with self._pressed:
            if self._running is None or self._running.done():
                self._shown.look()  # nothing has looked where the plots were not loaded
                self._running = self._processes.submit(self._stop)
        return self._running.result()

    def _stop(self) -> StopReport:
        vehicles, campaign = self.vehicles(), self._of_run()
        failed = MAY_BE_RUNNING if vehicles_driven(self._shown.run) else "NOT STOPPED"
        where = [] if campaign is None else ["--campaign", str(campaign)]
        if not vehicles:
            if others := vehicles_locked():
                advice = ", or ".join(f"cfid motors stop --uri {uri}" for uri in others)
                return StopReport(False, f"{failed}: no run here has a vehicle. Programs hold others: {advice}.")
            return _stopped_by([], where, failed)
        reports = list(self._processes.map(lambda uri: _stopped_by([f"--uri={uri}"], where, failed), vehicles))
        # Each of these vehicles is stopped by a process of its own, so that the advice to stop it is void.
        void = tuple(f"cfid motors stop --uri {resolved(uri)}" for uri in vehicles)
        lines = [line for report in reports for line in report.text.splitlines() if not line.endswith(void)]
        return StopReport(all(report.stopped for report in reports), "\n".join(lines))

    def _of_run(self) -> Path | None:
        """Return the campaign of the shown run, else the page's; its rig.toml need not be valid."""
        run = self._shown.run
        folder = None if run is None else run.folder.resolve().parent.parent
        return folder if folder is not None and (folder / RIG_FILE).is_file() else self._campaign


def vehicles_of(header: RunHeader) -> list[str]:
    """Return the addresses of the vehicles among a run's devices: each device that uses one states it."""
    stated = [(device.model_extra or {}).get("uri") for device in header.devices.values()]
    return list(dict.fromkeys(uri for uri in stated if isinstance(uri, str)))


def vehicles_driven(run: LiveRun | None) -> tuple[str, ...]:
    """Return the vehicles that a run drives, or drove when it was cut, then those that the runs beside it drive.

    Those are held by a program of this computer for a run of the same folder that is not closed. A recorder that hangs
    holds its vehicle too; a run that was cut a week ago states "recording" and holds none.
    """
    if run is None:
        return ()
    vehicles = dict.fromkeys(vehicles_of(run.header) if run.recording else ())
    locked = {*vehicles_locked()} - {resolved(uri) for uri in vehicles}
    for path in sorted(run.folder.resolve().parent.glob(f"*/{RECORDER_FILE}"), reverse=True) if locked else ():
        with suppress(DataError):  # it begins or ends just now: the next call tries again
            stated = vehicles_of(read_run(path.parent).header)
            vehicles.update(dict.fromkeys(uri for uri in stated if resolved(uri) in locked))
    return tuple(vehicles)


def _stopped_by(vehicle: list[str], where: list[str], failed: str) -> StopReport:
    """Run `cfid motors stop` with these options; `failed` begins the text of a failure that states no danger itself."""
    try:
        ended = subprocess.run(
            cfid_command("motors", "stop", "--by-button", *vehicle, *where),
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

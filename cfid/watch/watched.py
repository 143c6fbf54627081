"""The run that the page shows, read for all viewers at once: the one named, else the newest of a campaign."""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from cfid.errors import DataError
from cfid.watch.live_run import LiveRun, newest_run
from cfid.watch.signals import SCALE_MN
from cfid.watch.spectrum import LENGTH_S, RotorLines, spectrum_of

_READ_S = 0.05  # of each picture's tenth of a second, while the page catches up with a long file
_LOOK_S = 1.0  # from one look for a newer run to the next
_SPECTRUM_S = 0.5


class Watched:
    """Reads a run while anybody views it; `revision` grows with everything that is new.

    Without a named `folder` it turns to each new recording of `runs_folder`.
    """

    def __init__(self, *, folder: Path | None, runs_folder: Path | None) -> None:
        """Begin with the named run. Raises DataError when it is not one."""
        self.run: LiveRun | None = None if folder is None else LiveRun(folder)
        self.revision = self.viewers = 0
        self.lines: RotorLines | None = None
        self._runs_folder = None if folder is not None else runs_folder
        self._next_look_s = self._next_spectrum_s = 0.0
        self._computer = ThreadPoolExecutor(1)  # a spectrum takes longer than a picture may
        self._computing: Future[RotorLines | None] | None = None

    def read(self) -> None:
        """Read what was added since the last call, for half a picture's time at most."""
        if not self.viewers:
            return
        now_s = time.monotonic()
        if now_s >= self._next_look_s:
            self._next_look_s = now_s + _LOOK_S
            self.look_for_newer()
        if self.run is None:
            return
        self.revision += self.run.read(_READ_S)
        self._compute(now_s)

    def look_for_newer(self) -> None:
        """Turn to a newer run of the campaign, unless the shown run is being recorded."""
        found = None if self._runs_folder is None else newest_run(self._runs_folder)
        if found is None or (self.run is not None and (self.run.folder == found or self.run.recording_now)):
            return
        try:
            self.run, self.lines = LiveRun(found), None
        except DataError:  # the next call tries again
            return
        self.revision += 1

    def close(self) -> None:
        """End the thread that computes spectra."""
        self._computer.shutdown(cancel_futures=True)

    def _compute(self, now_s: float) -> None:
        """Take a spectrum that is ready, and begin the next one."""
        if self._computing is not None and self._computing.done():
            self.lines, self._computing = self._computing.result(), None
        device = None if self.run is None else self.run.loadcell
        if device is None or self._computing is not None or now_s < self._next_spectrum_s or not device.rate_hz:
            return
        self._next_spectrum_s = now_s + _SPECTRUM_S
        time_s, force = device.signals[0].extremes.newest(round(LENGTH_S * device.rate_hz))
        self._computing = self._computer.submit(spectrum_of, time_s.copy(), force.copy() / SCALE_MN)

"""Write to stderr without blocking the caller, whatever the terminal does."""

import atexit
import contextlib
import os
import sys
import time
from queue import Full, Queue
from threading import Thread

_MOST_TEXTS = 1000
_FINISH_WITHIN_S = 1.0
_LOOK_S = 0.002


class Screen:
    """Write to stderr from a separate thread.

    A stopped terminal (Ctrl-S), or a pipe whose reader is busy, may block for any length of time. Text that it has not
    accepted by the end of the program is lost.
    """

    def __init__(self) -> None:
        """Start with nothing to write."""
        self.file = _stderr()
        self._texts: Queue[str] = Queue(_MOST_TEXTS)
        self._thread: Thread | None = None

    @property
    def idle(self) -> bool:
        """Whether everything has been written."""
        return not self._texts.unfinished_tasks

    def write(self, text: str) -> None:
        """Write a text as soon as possible; drop it if too many texts are waiting."""
        if self.file is None:
            return
        if self._thread is None:
            self._thread = Thread(target=self._write_all, args=(self.file,), daemon=True)
            self._thread.start()
            atexit.register(self.finish)
        with contextlib.suppress(Full):
            self._texts.put_nowait(text)

    def finish(self) -> None:
        """Wait for a limited time until everything is written."""
        end_s = time.monotonic() + _FINISH_WITHIN_S
        while not self.idle and time.monotonic() < end_s:
            time.sleep(_LOOK_S)

    def _write_all(self, file: int) -> None:
        while True:
            left = self._texts.get().encode("utf-8", "replace")
            with contextlib.suppress(OSError):  # raised by a closed terminal
                while left:
                    left = left[os.write(file, left) :]
            self._texts.task_done()


def _stderr() -> int | None:
    """Return the file descriptor of stderr, None if it was closed, since another file may have its number by now."""
    try:
        return None if sys.stderr is None else sys.stderr.fileno()
    except (OSError, ValueError):
        return None

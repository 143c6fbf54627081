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
    """Writes to stderr in a thread of its own.

    A stopped terminal (Ctrl-S), or a pipe whose reader is busy, may block for any time. Text that it has not accepted
    when the program ends is lost.
    """

    def __init__(self) -> None:
        """Start with nothing to write."""
        self.file = _stderr()
        self._texts: Queue[str] = Queue(_MOST_TEXTS)
        self._thread: Thread | None = None

    @property
    def idle(self) -> bool:
        """Whether everything is written."""
        return not self._texts.unfinished_tasks

    def write(self, text: str) -> None:
        """Write as soon as possible; a text is dropped when very many are waiting."""
        if self.file is None:
            return
        if self._thread is None:
            self._thread = Thread(target=self._write_all, args=(self.file,), daemon=True)
            self._thread.start()
            atexit.register(self.finish)
        with contextlib.suppress(Full):
            self._texts.put_nowait(text)

    def finish(self) -> None:
        """Wait until everything is written, for a limited time."""
        end_s = time.monotonic() + _FINISH_WITHIN_S
        while not self.idle and time.monotonic() < end_s:
            time.sleep(_LOOK_S)

    def _write_all(self, file: int) -> None:
        while True:
            left = self._texts.get().encode("utf-8", "replace")
            with contextlib.suppress(OSError):  # a terminal that was closed
                while left:
                    left = left[os.write(file, left) :]
            self._texts.task_done()


def _stderr() -> int | None:
    """Return the file descriptor of stderr, None if it was closed: another file may have the number by now."""
    try:
        return None if sys.stderr is None else sys.stderr.fileno()
    except (OSError, ValueError):
        return None

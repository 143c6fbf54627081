"""A terminal for programs that print, whose screen a test reads."""

import fcntl
import os
import pty
import struct
import termios
import threading

COLUMNS = 80

_MARK = "\0"
_LONGEST_S = 30.0


class Terminal:
    """A terminal, usually 80 columns wide, which a thread reads, so that no program that prints has to wait."""

    def __init__(self, columns: int = COLUMNS) -> None:
        self._screen, end = pty.openpty()
        self.file = os.fdopen(end, "w", encoding="utf-8")
        self.resize(columns)
        self._text = ""
        self._marks = threading.Semaphore(0)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def resize(self, columns: int) -> None:
        fcntl.ioctl(self.file, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))

    def shown(self) -> str:
        """Return everything that was shown so far."""
        print(_MARK, end="", file=self.file, flush=True)
        assert self._marks.acquire(timeout=_LONGEST_S)
        return self._text

    def close(self) -> None:
        self.file.close()
        self._thread.join(_LONGEST_S)
        os.close(self._screen)

    def _read(self) -> None:
        rest = b""
        try:
            while data := rest + os.read(self._screen, 4096):
                whole = data.decode("utf-8", "ignore")
                rest = data[len(whole.encode()) :]
                self._text += whole.replace(_MARK, "")
                if _MARK in whole:
                    self._marks.release(whole.count(_MARK))
        except OSError:  # no program has it open any more
            return

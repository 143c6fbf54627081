"""Reads what the operator types, whole lines or single keys, in the loop while recording goes on."""

import contextlib
import os
import re
import sys
import termios
import tty
from collections.abc import Callable, Container, Iterator

from cfid.errors import ConfigError
from cfid.rig.hardware import Hardware

UP, DOWN, ESCAPE = "up", "down", "escape"

_ENTER = ("\n", "\r")
_BACKSPACE = ("\x7f", "\b")
_CTRL_D = "\x04"  # a terminal that passes single keys passes this one too
_ARROWS = {"A": UP, "B": DOWN}
_SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*([A-Za-z~])")  # of a key that is no letter
_REST = re.compile(r"^[\[O][0-9;]*([A-Za-z~])")  # the rest of such a sequence when the escape came alone


class Keyboard:
    """Standard input. With `keys` and on a terminal it is read key by key, else line by line.

    `handle` is called with a line (without its end) or, with `keys`, with a key: a letter, `up`, `down`,
    `escape`; with None when the input has ended.
    """

    def __init__(self, handle: Callable[[str | None], None], *, hardware: Hardware, keys: bool = False) -> None:
        """Take the handler of input; nothing is read yet. Raises ConfigError where there is no standard input."""
        if sys.stdin is None:
            raise ConfigError("there is no standard input to type into.")
        self._handle, self._hardware = handle, hardware
        self.keys = keys and sys.stdin.isatty()
        self._restore: Callable[[], None] = lambda: None
        self._rest = ""
        self._escaped = False  # the input ended with an escape, perhaps the beginning of an arrow
        self._open = False
        self.hung_up = False  # the terminal was closed, rather than Ctrl-D typed

    def open(self) -> None:
        """Begin to listen; a terminal that refuses the setting, as in a background job, counts as ended input."""
        self._open = True
        if self.keys:
            try:
                self._restore = _single_keys(sys.stdin.fileno())
            except termios.error:
                self._hardware.later(0, self._end)
                return
        self._hardware.add_reader(self)

    def close(self) -> None:
        """Stop listening, and restore the terminal."""
        if self._open:
            self._open = False
            self._hardware.remove_reader(self)
            self._restore()

    def fileno(self) -> int:
        """Return the file descriptor that the loop waits for."""
        return sys.stdin.fileno()

    def logPrefix(self) -> str:  # noqa: N802 - Twisted's name
        """Return a name for Twisted's log."""
        return "keyboard"

    def doRead(self) -> None:  # noqa: N802 - Twisted's name
        """Read what was typed; a terminal that hung up has ended."""
        try:
            typed = os.read(self.fileno(), 4096).decode(errors="replace")
        except OSError:
            typed = ""
        if not typed:
            self.hung_up = self.keys
            self._end()
            return
        if self.keys:
            typed, ended, _ = typed.partition(_CTRL_D)
            for key in self._keys_in(typed):
                self._handle(key)
            if ended:
                self._end()
            return
        *lines, self._rest = (self._rest + typed).split("\n")
        for line in lines:
            self._handle(line.strip())

    def _keys_in(self, typed: str) -> Iterator[str]:
        """Yield letters, arrows and escape; other keys that send a sequence are left out."""
        if self._escaped and (rest := _REST.match(typed)):
            typed = typed[rest.end() :]
        self._escaped = typed.endswith("\x1b")
        while typed:
            found = _SEQUENCE.match(typed)
            if found and found[1] in _ARROWS and ";" not in found[0]:
                yield _ARROWS[found[1]]
            elif not found:
                yield ESCAPE if typed[0] == "\x1b" else typed[0]
            typed = typed[found.end() if found else 1 :]

    def connectionLost(self, reason: object) -> None:  # noqa: N802 - Twisted's name
        """Take the terminal's end as the end of the input."""
        self.hung_up = self.keys
        self._end()

    def _end(self) -> None:
        if self._open:
            self.close()
            self._handle(None)


def edited(typed: str, key: str, *, allowed: Container[str] | None = None) -> tuple[str | None, str]:
    """Return the line that a key completes, None while it is incomplete, and the text typed so far of the next."""
    if key in _ENTER:
        return typed, ""
    if key in _BACKSPACE:
        return None, typed[:-1]
    good = len(key) == 1 and key.isprintable() and (allowed is None or key in allowed)
    return None, typed + key if good else typed


def _single_keys(handle: int) -> Callable[[], None]:
    """Let a terminal pass each key at once, and return a function that restores it."""
    before = termios.tcgetattr(handle)
    tty.setcbreak(handle)

    def restore() -> None:
        with contextlib.suppress(termios.error):  # it hung up
            termios.tcsetattr(handle, termios.TCSANOW, before)  # without waiting for a terminal that takes no output

    return restore

"""`cfid` inside the test, on simulated hardware and in virtual time.

A command runs in a thread that alternates with the test's: it runs until what the test waits for has happened, and
waits while the test acts. So nothing depends on how quick or busy the computer is.
"""

import contextlib
import os
import pty
import select
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

from cfid.cli.main import main
from cfid.console.screen import Screen
from cfid.rig.hardware import in_place
from cfid.sim.virtual import Virtual, VirtualClock

LONGEST_S = 3600.0  # of virtual time, for one command
LONGEST_WAIT_S = 600.0  # of virtual time, for what a test waits for
_STUCK_S = 120.0  # of the computer's time, after which a test fails

Holds = Callable[[], object]


class Abandoned(BaseException):
    """Raised inside a command that nobody lets go on, since its test has ended."""


class Keyboard:
    """What is typed into a command: through a pipe as a script does, or at a terminal."""

    def __init__(self, *, terminal: bool = False) -> None:
        self._end, commands_end = pty.openpty() if terminal else reversed(os.pipe())
        self.stdin = os.fdopen(commands_end, encoding="utf-8")
        self._shown = ""

    @property
    def shown(self) -> str:
        """What the terminal has shown so far; it takes a few thousand characters before it has to be read."""
        while self._end >= 0 and select.select([self._end], [], [], 0)[0]:
            self._shown += os.read(self._end, 1 << 16).decode(errors="replace")
        return self._shown

    def type(self, text: str) -> None:
        os.write(self._end, text.encode())

    def hang_up(self) -> None:
        """End the input: the script is over, or the terminal is closed."""
        if self._end >= 0:
            os.close(self._end)
        self._end = -1

    def close(self) -> None:
        self.hang_up()
        self.stdin.close()


class PausingClock(VirtualClock):
    """A clock that hands over to the test when what it waits for has happened."""

    def __init__(self) -> None:
        super().__init__()
        self.commands: list[Command] = []

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        for command in self.commands:
            command.look()


class Command:
    """A command of cfid. It starts when the test first waits for it."""

    def __init__(
        self,
        hardware: Virtual,
        folder: Path,
        words: tuple[object, ...],
        *,
        stdin: IO[Any] | None = None,
        stdout: IO[Any] | None = None,
        stderr: IO[Any] | None = None,
        screen: Keyboard | None = None,
        patience_s: float = _STUCK_S,
    ) -> None:
        self.code: int | None = None
        assert isinstance(hardware.time, PausingClock)
        self._clock = hardware.time
        self._hardware, self._folder = hardware, folder
        self._words = [str(word) for word in words]
        number = len(list(folder.glob(".out*")))
        self._files = [folder / f".{name}{number}" for name in ("out", "err")]
        for file in self._files:
            file.touch()
        self._stdin, self._stdout, self._stderr, self._screen = stdin, stdout, stderr, screen
        self._patience_s = patience_s
        self._awaited: Holds | None = None
        self._goes_on, self._handed_over = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._error: BaseException | None = None
        self._is_abandoned = False

    @property
    def out(self) -> str:
        return self._files[0].read_text()

    @property
    def err(self) -> str:
        return self._files[1].read_text() if self._screen is None else self._screen.shown

    def wait_until(self, holds: Holds, what: str = "") -> None:
        """Let the command run until something holds."""
        end_s = self._hardware.seconds() + LONGEST_WAIT_S
        self._awaited = lambda: holds() or self._hardware.seconds() > end_s
        self._go_on()
        assert self.code is None or holds(), f"ended before: {what}\n{self.out}{self.err}"
        assert holds(), f"waited in vain for {what}\n{self.out}{self.err}"

    def wait_until_said(self, text: str, *, times: int = 1) -> None:
        self.wait_until(lambda: self.err.count(text) >= times, text)

    def go_on_for(self, seconds: float) -> None:
        """Let the command run for some seconds."""
        end_s = self._hardware.seconds() + seconds
        self.wait_until(lambda: self._hardware.seconds() >= end_s or self.code is not None, "time")

    def request_end(self, name: str = "SIGINT") -> None:
        """Request its end as a signal does."""
        self._hardware.request_end(name)

    def run_to_end(self) -> int:
        """Let the command run to its end, and return its exit code."""
        end_s = self._hardware.seconds() + LONGEST_S
        self._awaited = lambda: self._hardware.seconds() > end_s
        self._go_on()
        assert self.code is not None, f"does not end\n{self.out}{self.err}"
        assert "Traceback" not in self.err
        assert "Unhandled" not in self.err
        return self.code

    def abandon(self) -> None:
        """End a command that is still waiting, after its test."""
        if self.code is None and self._thread.ident is not None:
            self._is_abandoned = True
            self._goes_on.set()
            self._thread.join(_STUCK_S)

    def look(self) -> None:
        """Hand over to the test, where this command's thread runs and what the test waits for has happened."""
        if threading.current_thread() is not self._thread:
            return
        if self._screen is not None:
            _ = self._screen.shown
        if self._awaited is not None and self._awaited():
            self._awaited = None
            self._goes_on.clear()
            self._handed_over.set()
            self._goes_on.wait()
            if self._is_abandoned:
                raise Abandoned

    def _go_on(self) -> None:
        if self.code is not None:
            return
        self._handed_over.clear()
        if self._thread.ident is None:
            self._clock.commands.append(self)
            self._thread.start()
        else:
            self._goes_on.set()
        assert self._handed_over.wait(self._patience_s), f"stuck\n{self.out}{self.err}"
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        code = 1
        try:
            code = self._main()
        except BaseException as error:
            self._error = error
        finally:
            self.code = code
            self._clock.commands.remove(self)
            self._handed_over.set()

    @contextlib.contextmanager
    def _opened_err(self, file: Path) -> Iterator[IO[str]]:
        end = file if self._screen is None else os.dup(self._screen.stdin.fileno())
        opened = open(end, "w", buffering=1, encoding="utf-8")  # noqa: PTH123, SIM115 - a path or a descriptor
        try:
            yield opened
        finally:
            with contextlib.suppress(OSError):  # raised by a closed terminal
                opened.close()

    def _main(self) -> int:
        out, err = self._files
        with (
            out.open("w", encoding="utf-8") as out_file,
            self._opened_err(err) as err_file,
            contextlib.chdir(self._folder),
            in_place(self._hardware),
            Path(os.devnull).open(encoding="utf-8") as nothing,
            _streams(self._stdin or nothing, self._stdout or out_file, self._stderr or err_file),
        ):
            try:
                main(self._words)
            except SystemExit as ended:
                return int(ended.code or 0)
            except KeyboardInterrupt:
                return 130
        return 0


@contextlib.contextmanager
def _streams(stdin: IO[Any], stdout: IO[Any], stderr: IO[Any]) -> Any:
    """Put other standard streams in place; what a live line says is written at once."""
    before, write = (sys.stdin, sys.stdout, sys.stderr), Screen.write
    sys.stdin, sys.stdout, sys.stderr = stdin, stdout, stderr

    def written(screen: Screen, text: str) -> None:
        with contextlib.suppress(OSError):  # raised by a closed terminal
            print(text, end="", file=sys.stderr, flush=True)

    Screen.write = written  # type: ignore[assignment, method-assign]
    try:
        yield
    finally:
        sys.stdin, sys.stdout, sys.stderr = before
        Screen.write = write  # type: ignore[method-assign]
